"""What a goal asks of a bed, in numbers and in words."""

import math
from typing import Any

import numpy as np

from jshape.goals.bedmap import BedMap
from jshape.goals.goal import Goal
from jshape.goals.slopes import steepness
from jshape.sim.material import Material

TOLD = 5e-4
"""Changes of less than this, metres, have no area: the noise of one frame is 0.45 mm."""
LEAST_CM3 = 0.05
"""Less than this is not told, cm³."""
EDGE = 0.02
"""Changes nearer to the view's edge than this, metres, are hardly met by any action."""
WHY = {
    "not seen": "lies where no camera saw the bed",
    "out of reach": "lies where the hand does not reach",
    "deeper than the material": "is deeper than the material",
    "beyond the camera's range": "is beyond the camera's depth range",
    "too steep": "is steeper than the material holds",
}
"""The reasons of `Goal.left`, for a sentence."""


def report(goal: Goal, material: Material | None = None) -> dict[str, Any]:
    """Volumes, heights and what was left out, as plain values for JSON.

    Args:
      goal: to report on.
      material: what the bed is made of, for what it can pack; None: not known.

    Returns:
      Volumes in cm³ (`raised`, `sunk`, `net` = raised - sunk), areas in cm², heights in mm,
      places as (u, v) in the frame; `left` has one entry per reason; `says` are the same in
      sentences and `warnings` what no action can do about it.
    """
    bed, change = goal.bed, goal.change
    up, down = np.maximum(change, 0.0), np.maximum(-change, 0.0)
    raised, sunk = bed.cm3(up), bed.cm3(down)
    moved = np.abs(change) > TOLD
    result: dict[str, Any] = {
        "raised_cm3": raised,
        "sunk_cm3": sunk,
        "net_cm3": raised - sunk,
        "changed_cm2": _cm2(bed, moved),
        "highest_mm": 1e3 * float(up.max()),
        "deepest_mm": 1e3 * float(down.max()),
        "steepest_deg": _steepest(goal, moved),
        "allowed_deg": math.degrees(math.atan(goal.limits.steepest)),
        "floor_mm": 1e3 * goal.limits.floor,
        "wanted_raised_cm3": bed.cm3(np.maximum(goal.wanted, 0.0)),
        "wanted_sunk_cm3": bed.cm3(np.maximum(-goal.wanted, 0.0)),
        "left": {reason: _lost(bed, field) for reason, field in goal.left.items()},
        "balance": None,
    }
    if goal.balance is not None:
        how, most, before = goal.balance
        result["balance"] = {"how": how, "most_mm": 1e3 * most, "net_before_cm3": before}
    result["says"] = _sentences(result)
    result["warnings"] = _warnings(goal, result, material)
    return result


def _cm2(bed: BedMap, where: np.ndarray) -> float:
    return 1e4 * bed.cell**2 * float(where.sum())


def _steepest(goal: Goal, moved: np.ndarray) -> float:
    """Steepest slope of what changes, degrees."""
    slopes = steepness(goal.height, goal.bed.cell)[moved]
    return math.degrees(math.atan(float(slopes.max()))) if slopes.size else 0.0


def _lost(bed: BedMap, field: np.ndarray) -> dict[str, Any]:
    """How much of a change is left out, and where the most."""
    told = np.abs(field) > TOLD
    u, v = bed.pixels()
    worst = np.unravel_index(np.argmax(np.abs(field)), field.shape)
    return {
        "volume_cm3": bed.cm3(np.abs(field)),
        "area_cm2": _cm2(bed, told),
        "most_mm": 1e3 * float(np.abs(field).max()),
        "place": [round(float(u[worst])), round(float(v[worst]))] if told.any() else None,
    }


def _sentences(found: dict[str, Any]) -> list[str]:
    says = [
        f"to move: {found['raised_cm3']:.1f} cm³ raised (at most {found['highest_mm']:.1f} mm), "
        f"{found['sunk_cm3']:.1f} cm³ sunk (at most {found['deepest_mm']:.1f} mm), "
        f"on {found['changed_cm2']:.0f} cm² of the bed"
    ]
    balance = found["balance"]
    if balance is not None:
        where = {
            "around": f"a rim of up to {balance['most_mm']:.1f} mm around the shape",
            "level": f"the whole bed moved by {balance['most_mm']:+.2f} mm",
        }[balance["how"]]
        says.append(
            f"balanced by {where}: net {found['net_cm3']:+.1f} cm³, "
            f"{balance['net_before_cm3']:+.1f} without it"
        )
    for reason, lost in found["left"].items():
        if lost["place"] is not None and lost["volume_cm3"] >= LEAST_CM3:
            u, v = lost["place"]
            limit = {
                "too steep": f" ({found['allowed_deg']:.0f}°)",
                "deeper than the material": f" ({found['floor_mm']:.0f} mm)",
            }.get(reason, "")
            says.append(
                f"left out: {lost['volume_cm3']:.1f} cm³ on {lost['area_cm2']:.0f} cm² "
                f"{WHY[reason]}{limit}; the most, {lost['most_mm']:.1f} mm, at ({u}, {v})"
            )
    return says


def _warnings(goal: Goal, found: dict[str, Any], material: Material | None) -> list[str]:
    warnings = []
    if not np.abs(goal.change).max() > TOLD:
        warnings.append("nothing is left of the goal: it is the bed as it is")
    net, moved = found["net_cm3"], found["raised_cm3"] + found["sunk_cm3"]
    if net > max(LEAST_CM3, 0.02 * moved):
        warnings.append(
            f"{net:.1f} cm³ more are raised than sunk: that is more material than there is, and no "
            "action brings any; --balance takes it from the bed"
        )
    elif goal.balance is not None and goal.balance.before > max(LEAST_CM3, 0.02 * moved):
        warnings.append(
            f"{found['raised_cm3']:.1f} cm³ are to be raised: actions push material down or "
            "aside and bring none, so hills keep most of their distance to the goal"
        )
    elif -net > max(LEAST_CM3, 0.02 * moved):
        warnings.append(_to_pack(goal, -net, material))
    near = _cm2(goal.bed, (np.abs(goal.change) > TOLD) & _near_edge(goal.bed))
    if near > 0.5:
        warnings.append(
            f"{near:.0f} cm² of it lie within {1e3 * EDGE:.0f} mm of the view's edge, "
            "where hardly any action can be placed"
        )
    return warnings


def _to_pack(goal: Goal, net: float, material: Material | None) -> str:
    """What becomes of material that is dug and not put anywhere."""
    says = f"{net:.1f} cm³ are sunk and raised nowhere: they have to be pressed together or go"
    if material is None:
        return f"{says}; --balance piles them up around"
    below = np.maximum(goal.bed.height + goal.limits.floor, 0.0) * (goal.change < -TOLD)
    share = float(material.compressibility) * (1.0 - 1.0 / float(material.packing_max))
    room = share * goal.bed.cm3(below)
    holds = "can" if net <= room else "cannot"
    return (
        f"{says}; {material.name} {holds} pack so much (up to {room:.1f} cm³ below the shape); "
        "--balance piles them up around"
    )


def _near_edge(bed: BedMap) -> np.ndarray:
    (low_x, low_y), (high_x, high_y) = bed.view()
    x, y = bed.axes()
    across = np.minimum(x - low_x, high_x - x)[None, :]
    along = np.minimum(y - low_y, high_y - y)[:, None]
    return np.minimum(across, along) < EDGE
