"""The options of a search as numbers and arrays: checked, with one clear error each (host)."""

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np

from jshape import actions as rectangles
from jshape import metric
from jshape._typing import Bool, Float
from jshape.data.noise import noise_of_sums
from jshape.errors import BadBank, JShapeError, UnknownName, quoted
from jshape.models.bank import Bank
from jshape.models.imprint import LONGEST
from jshape.models.turn import square
from jshape.planning.kernels import Move
from jshape.planning.options import (
    ERROR_MARGIN,
    FEIGNED,
    YAWS,
    Constraints,
    SearchBudget,
    StopCriteria,
)
from jshape.planning.plan import Plan
from jshape.planning.search.base import UNLIMITED, Budget, SearchLimits, SearchResult, room_for
from jshape.planning.state import SearchState

CARRIES = {"scoop": "pour"}
"""Actions that are tried in pairs where nothing else is said."""
PRICE = 0.7
"""Of material, at most (see `price`).  Left of measured sand and a dumpling's relief after 16
actions, %: 48 and 56 at 0, 43 and 48 at 0.4, 40 and 49 at 0.7, 38 and 51 at 1."""
DEEPEST = 100
"""Greatest strength that is tried."""
MAX_STEPS = 1000
"""Most actions of a plan: the predicted ROI of each has its place in memory from the start."""


def carries(bank: Bank, pairs: Mapping[str, str] | None) -> tuple[tuple[int, int], ...]:
    """Numbers of the actions that are tried in pairs: (takes material out, brings it)."""
    if pairs is None:
        pairs = {k: v for k, v in CARRIES.items() if k in bank.actions and v in bank.actions}
    if not isinstance(pairs, Mapping):
        raise JShapeError(f"carries is {quoted(pairs)}; it must be a mapping of action to action")
    for name in (*pairs, *pairs.values()):
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
    both = sorted(set(pairs) & set(pairs.values()))
    if both:
        raise JShapeError(f"carries: {quoted(both[0])} both takes material out and brings it")
    return tuple((bank.actions.index(k), bank.actions.index(v)) for k, v in pairs.items())


def names(bank: Bank, carries: Sequence[tuple[int, int]]) -> list[str]:
    """Of all actions that are tried in pairs."""
    return [bank.actions[number] for pair in carries for number in pair]


def directions(
    bank: Bank,
    yaws: int | Mapping[str, int] | None,
    lengths: Sequence[float] = (1.0,),
    pairs: Sequence[tuple[int, int]] = (),
) -> list[tuple[int, float, float]]:
    """(action number, yaw, length) of every move, the trained direction first.

    Over half a turn; over a whole one where the predictor is `directed`.  What brings the material
    of a carry is a round heap, and not turned, unless it is `directed` or `yaws` name it.
    """
    heaps = {bring for _, bring in pairs if not bank.predictors[bring].directed}
    upright = set() if isinstance(yaws, Mapping) else heaps
    if yaws is None:
        yaws = YAWS if bank.turns else 1
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
    moves, tried = [], lengths_to_try(lengths)
    for number, name in enumerate(bank.actions):
        hand = bank.predictors[number]
        for length in tried if hand.path_mm else [1.0]:
            count = 1 if number in upright else yaws.get(name, 1)
            roi = bank.placed(number, None, length).roi
            if max(square(roi)) > min(bank.camera.shape):
                count = 1  # a turned hand's square does not fit into the image
            if length != 1 and (roi[0] > bank.camera.width or roi[1] > bank.camera.height):
                continue
            turn = 2 * math.pi if hand.directed else math.pi
            angles = [turn * k / count for k in range(count)]
            moves += [(number, a if a <= turn / 2 else a - turn, length) for a in angles]
    return moves


def at_nodes(
    state: SearchState, bank: Bank, where: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Places moved to the nearest nodes, if their ROIs stay inside."""
    found = {}
    for name, at in where.items():
        moved = np.rint(state.pixel(state.node(at[:, ::-1]))).astype(np.int32)[:, ::-1]
        inside = rectangles.fits(bank.camera, moved, bank.roi(name))
        found[name] = np.where(inside[:, None], moved, at)
    return found


def rounds(state: SearchState, stride: int) -> int:
    """Rounds of local search that lead from a stride of pixels down to one node."""
    return max(math.ceil(math.log2(max(stride / float(np.min(state.pitch)), 1.0))), 0)


def lengths_to_try(lengths: Sequence[float | int]) -> list[float]:
    """Lengths to try of paths, each once, shortest first."""
    return strengths(lengths, "lengths", LONGEST)


def strengths(
    strengths: Sequence[float | int], name: str = "strengths", most: float = DEEPEST
) -> list[float]:
    """Strengths (or other multiples, up to `most`) to try, each once, weakest first."""
    try:
        values = np.asarray(strengths)
    except ValueError:
        values = np.zeros((0, 0))
    if values.ndim != 1 or not values.size or values.dtype.kind not in "iuf":
        raise JShapeError(
            f"{name} is {quoted(strengths)}; it must be numbers above 0, at least one"
        )
    if not (np.isfinite(values).all() and (values > 0).all() and (values <= most).all()):
        raise JShapeError(f"{name} is {quoted(strengths)}; each must be above 0, at most {most:g}")
    if values.size > 64:
        raise JShapeError(f"{values.size} {name}; at most 64 are tried")
    return sorted({float(value) for value in values})


def limits(
    bank: Bank,
    stop: StopCriteria,
    max_uses: Mapping[str, int] | None,
    carries: Sequence[tuple[int, int]] = (),
    feigned: float = 0.0,
) -> SearchLimits:
    """What a search must gain and may use, the bank's own errors times the margin among it.

    Actions that are tried in pairs may be used in pairs alone.  Where `stop` does not say it, the
    least gain is what is `feigned`.
    """
    if not isinstance(stop.max_steps, int | np.integer) or not 0 <= stop.max_steps <= MAX_STEPS:
        raise JShapeError(
            f"max_steps is {quoted(stop.max_steps)}; "
            f"it must be a whole number from 0 to {MAX_STEPS}"
        )
    margin = stop.error_margin
    if margin is None:
        margin = 0.0 if bank.errors_mm is None else ERROR_MARGIN
    for name in ("min_gain_mm", "tolerance_mm", "error_margin"):
        value = margin if name == "error_margin" else getattr(stop, name)
        if value is None and name == "min_gain_mm":
            continue
        if not isinstance(value, int | float | np.number) or not 0 <= value < np.inf:
            raise JShapeError(f"{name} is {quoted(value)}; it must be a number from 0")
    if margin and bank.errors_mm is None:
        raise BadBank(
            f"error_margin is {quoted(margin)}, but the bank does not know how wrong it is; 0 is "
            "allowed (jshape train measures it)"
        )
    if max_uses is not None and not isinstance(max_uses, Mapping):
        raise JShapeError(
            f"max_uses is {quoted(max_uses)}; it must be a mapping of action to count"
        )
    allowed = np.full(len(bank.actions), UNLIMITED, np.int32)
    for name, count in (max_uses or {}).items():
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 0:
            raise JShapeError(
                f"max_uses of {name} is {quoted(count)}; it must be a whole number from 0"
            )
        allowed[bank.actions.index(name)] = min(count, UNLIMITED)
    in_carries = allowed.copy()
    allowed[[number for pair in carries for number in pair]] = 0
    per_mm = 1.0 / float(metric.to_mm(1.0, bank.camera))
    return SearchLimits(
        min_gain=feigned if stop.min_gain_mm is None else float(stop.min_gain_mm) * per_mm,
        tolerance=float(stop.tolerance_mm) * per_mm,
        # On the host: sent with the search, not each with a transfer of its own.
        errors=np.asarray(margin * bank.error_of_d()) if margin else np.zeros(len(allowed), "f4"),
        max_uses=allowed,
        carry_uses=in_carries,
    )


def feigned(
    bank: Bank,
    now: Float[np.ndarray, "H W"],
    goal: Float[np.ndarray, "H W"],
    seen: Bool[np.ndarray, "H W"] | None,
) -> float:
    """What an action may seem to gain by the noise of bed and goal, in units of d.

    Where the goal is farther than the action reaches, it gains what it changes, whatever the noise;
    elsewhere at most the noise of its window's pixels is added, signs and all.  Of the largest ROI:
    the action that is chosen has to be better than what noise feigns for any other.
    """
    counted = now.size if seen is None else max(int(seen.sum()), 1)
    pixels = max((w * h for w, h in bank.rois.values()), default=0)
    return FEIGNED * noise_of_sums(now - goal, seen) * math.sqrt(pixels) / counted


def stock(state: SearchState, constraints: Constraints) -> float:
    """What a stock holds, in units of Σ now of the map; NaN where there is none.

    Raises:
      JShapeError: no number from 0; a search on images, or without actions that use it.
    """
    value = constraints.stock_cm3
    if value is None:
        return math.nan
    if not isinstance(value, int | float | np.number) or not 0 <= value < np.inf:
        raise JShapeError(f"stock_cm3 is {quoted(value)}; it must be a number from 0")
    if not state.carries:
        raise JShapeError("stock_cm3 has no effect: the bank has no actions that take and bring")
    if state.node_m is None:
        raise BadBank("stock_cm3 is for banks that work in metres, of kind 'P'")
    return float(value) * 1e-6 / float(state.node_m) ** 2


def price(state: SearchState) -> np.floating:
    """What a search pays for a unit of Σ weight·now that is packed away, in units of d.

    Where as much is missing as there is too much of, what is packed away is missing in the end: a
    price of 1 would count what can never be filled any more.  Below 1 what lies too high counts
    too.  Where there is more than twice as much too much as is missing, it may be packed away.
    """
    apart = state.lower * (np.asarray(state.now) - np.asarray(state.goal))
    apart = apart if state.weight is None else apart * np.asarray(state.weight)
    missing, surplus = np.maximum(apart, 0).sum(), np.maximum(-apart, 0).sum()
    return np.float32(state.lower * PRICE * np.clip(2 * missing / max(surplus, 1e-9) - 1, 0, 1))


def budget(spent: SearchBudget) -> Budget:
    """A budget that starts now."""
    seconds, evaluations = spent.seconds, spent.evaluations
    for name, value in (("seconds", seconds), ("evaluations", evaluations)):
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < np.inf):
            raise JShapeError(f"{name} is {quoted(value)}; it must be a number above 0")
    whole = None if evaluations is None else math.ceil(evaluations)
    return Budget(seconds, whole, time.monotonic)


def as_found(plan: Plan, state: SearchState, bank: Bank, max_steps: int) -> SearchResult | None:
    """An earlier plan as a sequence of these moves; None if it has nothing to begin with."""
    steps = min(len(plan), max_steps)
    if not steps or any(name not in bank.actions for name in plan.actions):
        return None
    room = room_for(max_steps)
    move, node = np.full(room, -1, np.int32), np.zeros((room, 2), np.float32)
    strength, turn, stretch = (np.full(room, no, np.float32) for no in (0.0, 0.0, 1.0))
    for k in range(steps):
        act = plan[k]
        number = bank.actions.index(act.action)
        mine = [m for m, one in enumerate(state.moves) if one.action == number]
        if not mine:
            return None
        move[k] = nearest = min(mine, key=lambda m: _apart(state.moves[m], act.yaw, act.length))
        turn[k] = half_turn(act.yaw - float(state.moves[nearest].yaw))
        stretch[k] = act.length / float(state.moves[nearest].length)
        exact = np.array(act.position)
        node[k] = (exact[::-1] - np.asarray(state.origin)) / np.asarray(state.pitch)
        strength[k] = act.strength
    return SearchResult(
        steps=np.int32(steps), move=move, node=node, strength=strength, turn=turn,
        stretch=stretch, distance=np.float32(np.inf), status=np.int32(-1), evaluations=np.int32(0),
    )  # fmt: skip


def half_turn(angle: float) -> float:
    """The same angle from -pi up to pi, radians."""
    return -((math.pi - angle) % (2 * math.pi) - math.pi) if abs(angle) > math.pi else angle


def _apart(move: Move, yaw: float, length: float) -> tuple[float, float]:
    """How far a move's length and yaw are from others."""
    return abs(float(move.length) - length), abs(half_turn(yaw - float(move.yaw)))
