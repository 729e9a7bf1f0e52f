"""What a goal asks of a bed, in numbers and in words."""

import math
from typing import Any

import numpy as np

from jshape.goals.bedmap import BedMap
from jshape.goals.goal import Goal
from jshape.goals.slopes import steepness
from jshape.goals.transport import LEAST_CM3, TOLD, Region, Transport
from jshape.sim.material import Material

MOST_TOLD = 3
"""Regions and carries in one sentence; all of them are in the report."""
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
      places as (u, v) in the frame; `transport` has the regions to take from and to bring to, what
      is carried between them along the least way, and what a stock would have to give (`stock_cm3`,
      below 0: take); `left` has one entry per reason; `says` are the same in sentences and
      `warnings` what no press can do about it.
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
        "transport": _transport(goal.transport),
        "left": {reason: _lost(bed, field) for reason, field in goal.left.items()},
        "balance": None,
    }
    if goal.balance is not None:
        how, most, before = goal.balance
        result["balance"] = {"how": how, "most_mm": 1e3 * most, "net_before_cm3": before}
    result["says"] = _sentences(result)
    result["warnings"] = _warnings(goal, result, material)
    return result


def _transport(found: Transport) -> dict[str, Any]:
    """What is taken, brought and carried, with the places of regions."""

    def said(region: Region) -> dict[str, Any]:
        return {
            "volume_cm3": region.volume_cm3,
            "area_cm2": region.area_cm2,
            "most_mm": region.most_mm,
            "place": list(region.place),
        }

    carries = [
        {
            "volume_cm3": one.volume_cm3,
            "from": list(one.take.place),
            "to": list(one.bring.place),
            "way_mm": one.way_mm,
        }
        for one in found.carries
    ]
    result = {
        "take_cm3": found.take_cm3,
        "bring_cm3": found.bring_cm3,
        "stock_cm3": found.stock_cm3,
        "way_mm": found.way_mm,
        "take": [said(region) for region in found.take],
        "bring": [said(region) for region in found.bring],
        "carries": carries,
    }
    return result | {"says": _transport_sentences(result)}


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


def _transport_sentences(found: dict[str, Any]) -> list[str]:
    """The largest regions, the largest carries, and what is left for a stock."""

    def listed(parts: list[str]) -> str:
        more = len(parts) - MOST_TOLD
        return "; ".join(parts[:MOST_TOLD]) + (f"; and {more} more" if more > 0 else "")

    says = []
    for name, side in (("too much", "take"), ("too little", "bring")):
        parts = [
            f"{one['volume_cm3']:.1f} cm³ around ({one['place'][0]}, {one['place'][1]})"
            for one in found[side]
        ]
        if parts:
            says.append(f"{name}: {listed(parts)}")
    parts = [
        f"{one['volume_cm3']:.1f} cm³ from ({one['from'][0]}, {one['from'][1]}) to "
        f"({one['to'][0]}, {one['to'][1]}), {one['way_mm']:.0f} mm"
        for one in found["carries"]
    ]
    if parts:
        carried = sum(one["volume_cm3"] for one in found["carries"])
        says.append(
            f"to carry: {carried:.1f} cm³ by {found['way_mm']:.0f} mm on average: {listed(parts)}"
        )
    stock = found["stock_cm3"]
    if abs(stock) > max(LEAST_CM3, 0.01 * (found["take_cm3"] + found["bring_cm3"])):
        says.append(
            f"a stock beside the bed would have to give {stock:.1f} cm³"
            if stock > 0
            else f"a stock would have to take {-stock:.1f} cm³, as far as presses do not pack it"
        )
    return says


def _warnings(goal: Goal, found: dict[str, Any], material: Material | None) -> list[str]:
    warnings = []
    if not np.abs(goal.change).max() > TOLD:
        warnings.append("nothing is left of the goal: it is the bed as it is")
    net, moved = found["net_cm3"], found["raised_cm3"] + found["sunk_cm3"]
    if net > max(LEAST_CM3, 0.02 * moved):
        warnings.append(
            f"{net:.1f} cm³ more are raised than sunk: that is more material than there is, and "
            "only a pour from a stock brings any; --balance takes it from the bed"
        )
    elif goal.balance is not None and goal.balance.before > max(LEAST_CM3, 0.02 * moved):
        warnings.append(
            f"{found['raised_cm3']:.1f} cm³ are to be raised: hills keep most of their distance to "
            "the goal unless a bank carries material (moving-flour-robot)"
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
