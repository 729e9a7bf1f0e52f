"""What people ask of a search, as numbers and arrays: checked, with one clear error each (host)."""

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np

from jshape import actions as rectangles
from jshape.errors import BadBank, JShapeError, UnknownName, quoted
from jshape.models.bank import Bank
from jshape.planning.plan import Plan
from jshape.planning.search.base import EVER, Budget, Found, Limits, room_for
from jshape.planning.state import Terrain

DEEPEST = 100
"""Greatest strength that is tried."""


def directions(bank: Bank, yaws: int | Mapping[str, int]) -> list[tuple[int, float]]:
    """(action number, yaw) of every move, the trained direction first."""
    if not isinstance(yaws, Mapping):
        yaws = dict.fromkeys(bank.actions, yaws)
    for name, count in yaws.items():
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
        whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not whole or not 1 <= count <= 64:
            raise JShapeError(f"yaws is {quoted(count)}; it must be a whole number from 1 to 64")
        if count > 1 and not bank.turns:
            raise BadBank(
                f"a bank of kind {quoted(bank.kind)} cannot turn the hand; yaws must be 1"
            )
    moves = []
    for number, name in enumerate(bank.actions):
        count = yaws.get(name, 1)
        if max(bank.turned_roi(name)) > min(bank.camera.shape):
            count = 1  # a turned hand's square does not fit into the image
        angles = [math.pi * k / count for k in range(count)]
        moves += [(number, a if a <= math.pi / 2 else a - math.pi) for a in angles]
    return moves


def at_nodes(
    terrain: Terrain, bank: Bank, where: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Places moved to the nearest nodes, if their ROIs stay inside."""
    found = {}
    for name, at in where.items():
        moved = np.rint(terrain.pixel(terrain.node(at[:, ::-1]))).astype(np.int32)[:, ::-1]
        inside = rectangles.fits(bank.camera, moved, bank.roi(name))
        found[name] = np.where(inside[:, None], moved, at)
    return found


def rounds(terrain: Terrain, stride: int | None) -> int:
    """Rounds of polishing that lead from a stride of pixels down to one node."""
    if stride is None:
        return 0
    return max(math.ceil(math.log2(max(stride / float(min(terrain.pitch)), 1.0))), 0)


def strengths(strengths: Sequence[float | int]) -> list[float]:
    """Strengths to try, each once, weakest first."""
    try:
        values = np.asarray(strengths)
    except ValueError:
        values = np.zeros((0, 0))
    if values.ndim != 1 or not values.size or values.dtype.kind not in "iuf":
        raise JShapeError(
            f"strengths is {quoted(strengths)}; it must be numbers above 0, at least one"
        )
    if not (np.isfinite(values).all() and (values > 0).all() and (values <= DEEPEST).all()):
        raise JShapeError(
            f"strengths is {quoted(strengths)}; each must be above 0, at most {DEEPEST}"
        )
    if values.size > 64:
        raise JShapeError(f"{values.size} strengths; at most 64 are tried")
    return sorted({float(value) for value in values})


def limits(
    bank: Bank, min_gain: float, tolerance: float, caution: float, most: Mapping[str, int] | None
) -> Limits:
    """What a search must gain and may use, `caution` times the bank's own errors among it."""
    if caution and bank.errors_mm is None:
        raise BadBank(
            f"caution is {quoted(caution)}, but the bank does not know how wrong it is; 0 is "
            "allowed (jshape train measures it)"
        )
    if most is not None and not isinstance(most, Mapping):
        raise JShapeError(f"most is {quoted(most)}; it must be a mapping of action to count")
    allowed = np.full(len(bank.actions), EVER, np.int32)
    for name, count in (most or {}).items():
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 0:
            raise JShapeError(
                f"most of {name} is {quoted(count)}; it must be a whole number from 0"
            )
        allowed[bank.actions.index(name)] = min(count, EVER)
    return Limits(
        min_gain=float(min_gain),
        tolerance=float(tolerance),
        # On the host: sent with the search, not each with a transfer of its own.
        errors=np.asarray(caution * bank.error_of_d()) if caution else np.zeros(len(allowed), "f4"),
        most=allowed,
    )


def budget(seconds: float | None, evaluations: int | None) -> Budget:
    """A budget that starts now."""
    for name, value in (("seconds", seconds), ("evaluations", evaluations)):
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < np.inf):
            raise JShapeError(f"{name} is {quoted(value)}; it must be a number above 0")
    whole = None if evaluations is None else math.ceil(evaluations)
    return Budget(seconds, whole, time.monotonic)


def as_found(plan: Plan, terrain: Terrain, bank: Bank, max_steps: int) -> Found | None:
    """An earlier plan as a sequence on this terrain; None if it has nothing to begin with."""
    steps = min(len(plan), max_steps)
    if not steps or any(name not in bank.actions for name in plan.actions):
        return None
    room = room_for(max_steps)
    move, node = np.full(room, -1, np.int32), np.zeros((room, 2), np.float32)
    strength = np.zeros(room, np.float32)
    for k in range(steps):
        action, yaw = bank.actions.index(plan.actions[k]), float(plan.yaws[k])
        mine = [m for m, one in enumerate(terrain.moves) if one.action == action]
        if not mine:
            return None
        move[k] = min(mine, key=lambda m: abs(float(terrain.moves[m].yaw) - yaw))
        exact = plan.positions[k] + plan.offsets[k]
        node[k] = (exact[::-1] - np.asarray(terrain.origin)) / np.asarray(terrain.pitch)
        strength[k] = plan.strengths[k]
    return Found(
        steps=np.int32(steps), move=move, node=node, strength=strength,
        distance=np.float32(np.inf), status=np.int32(-1), evaluations=np.int32(0),
    )  # fmt: skip
