"""How near to a goal any plan can come: distances that it must leave, and where and why (host).

A plan that leaves 40 % may be a poor one, or the best there is.  Each `Bound` is a share of the
distance that no plan can go below as long as what it says holds; the largest counts.  A limit of 0
says only that nothing was proven.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from jshape import metric
from jshape._typing import ArrayLike, Bool, Float, Int
from jshape.camera import Camera
from jshape.data.view import View
from jshape.height_map import HeightMap
from jshape.models.bank import Bank
from jshape.planning import problem as tasks
from jshape.planning.ascent import climbed
from jshape.planning.certificate import certified
from jshape.planning.coarse import Allowance, LevelChange, fft
from jshape.planning.inputs import (
    as_bank,
    check_records,
    images_of,
    search_inputs,
    weighed,
)
from jshape.planning.options import Constraints, SearchSpace, StopCriteria, hinted
from jshape.planning.relaxation import level_changes, solved
from jshape.planning.search.base import SearchLimits
from jshape.planning.state import SearchState

CAUSES = ("needs material", "too few actions", "too steep", "too narrow", "out of reach")
"""Why something remains, by the numbers 1 to 5 of `Limit.causes`."""
LEAST_MM = 0.5
"""Less than this remains nowhere: the noise of one frame is 0.45 mm."""
ROUNDING = 0.01
"""Share of the distance that is not counted as proven on height maps: goal and bed are read there
between pixels.  A knock's own image, 28 pixels wide, leaves 0.016 of itself by the best node."""
WALL = 0.01
"""Around what is too steep all that remains is told so, metres."""


@dataclass(frozen=True)
class Bound:
    """A distance that every plan leaves."""

    name: str
    """"window", "material" or "shape"."""
    left: float
    """Share of the distance between bed and goal, 0 to 1; 0: nothing is proven."""
    holds: str
    """When it holds, in a sentence."""


@dataclass(frozen=True, eq=False)
class Limit:
    """How near to the goal plans of a bank can come, and what remains where."""

    camera: Camera
    """Of the images."""
    bounds: tuple[Bound, ...]
    """All that were computed."""
    max_steps: int
    """Actions of the plans that it is for."""
    distance_mm: float
    """From the bed to the goal, before any action, as the search measures it."""
    fractions: float
    """Share left by a plan that could do fractions of actions, all on the bed as if it were level:
    the bound "shape" cannot be above it."""
    wanted_mm: Float[np.ndarray, "H W"]
    """The bed now less the goal at each pixel, mm; positive: it is too high."""
    remains_mm: Float[np.ndarray, "H W"]
    """What is left of that by the plan of fractions."""
    causes: Int[np.ndarray, "H W"]
    """Number of the cause in `CAUSES`, from 1, where more than `LEAST_MM` remains; else 0.  An
    explanation, not proven pixel by pixel."""
    seen: Bool[np.ndarray, "H W"] | None = None
    """Pixels that count; None: all."""

    @property
    def strongest(self) -> Bound:
        """The bound that leaves most."""
        return max(self.bounds, key=lambda one: one.left)

    @property
    def left(self) -> float:
        """Share of the distance, 0 to 1, that no plan can go below; 0: nothing is proven."""
        return self.strongest.left

    @property
    def by(self) -> str:
        """Name of the bound that says so."""
        return self.strongest.name

    @property
    def proves(self) -> bool:
        """Whether more than 1 % and 2 µm must stay: less may be rounding to the nodes."""
        return self.left > 0.01 and self.left_mm > 0.002

    @property
    def left_mm(self) -> float:
        """The same in mm."""
        return self.left * self.distance_mm

    @property
    def words(self) -> str:
        """What is proven, in a sentence."""
        plan = f"plan of {self.max_steps} action{'' if self.max_steps == 1 else 's'}"
        if not self.proves:
            return f"nothing is proven: no bound keeps a {plan} from the goal"
        least = f"{self.left:.1%} ({self.left_mm:.3f} mm)"
        return f"no {plan} leaves less than {least}, by the bound {self.by!r}"

    @property
    def mask(self) -> Bool[np.ndarray, "H W"]:
        """Where something remains."""
        return self.causes > 0

    @property
    def shares(self) -> dict[str, float]:
        """Of what remains, the share by each cause, largest first; none below half a percent."""
        whole = float(np.abs(self.remains_mm[self.mask]).sum()) or 1.0
        each = {
            cause: float(np.abs(self.remains_mm[self.causes == k]).sum()) / whole
            for k, cause in enumerate(CAUSES, 1)
        }
        return {k: v for k, v in sorted(each.items(), key=lambda one: -one[1]) if v >= 0.005}

    def efficiency(self, left: float) -> float:
        """Share that a plan which leaves `left` covers of what can be covered at most.

        NaN where nothing can be.
        """
        return efficiency(left, self.left if self.distance_mm else 1.0)


def efficiency(left: float, limit: float) -> float:
    """`Limit.efficiency` of a plan that leaves `left`, where no plan can go below `limit`."""
    return (1.0 - left) / (1.0 - limit) if limit < 1 else float("nan")


@hinted
def limit(
    now: ArrayLike | HeightMap,
    wanted: ArrayLike | HeightMap,
    *,
    bank: Bank | str | Path | None = None,
    max_steps: int | None = None,
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
) -> Limit:
    """How near to an image any plan can come, as the bank predicts it, and why not nearer.

    Args:
      now: (H, W) weighed image I of the bed now, or its height map, as for `jshape.plan`.
      wanted: of the goal.
      bank: as for `jshape.plan`.
      max_steps: most actions; None: that of `stop`.
      space: what plans may try; they may place actions anywhere between the positions.
      constraints: what they must keep to.
      stop: `max_steps` alone counts: a limit is for plans that gain as little as they like.

    Raises:
      JShapeError: as for `jshape.plan`.
    """
    bank, first, goal, seen = images_of(as_bank(bank), now, wanted, ("now", "wanted"))
    if max_steps is not None:
        stop = replace(stop, max_steps=max_steps)
    return limit_images(bank, first, goal, seen, space=space, constraints=constraints, stop=stop)


def limit_views(
    bank: Bank,
    frames: Sequence[ArrayLike],
    views: Sequence[View | None],
    names: Sequence[str],
    *,
    depth_unit: float = 0.001,
    constraints: Constraints = Constraints(),
    **more: Any,
) -> Limit:
    """`limit` of two raw depth frames whose views (see `over_beds`) are known."""
    now, wanted, seen = weighed(bank, frames, views, names, depth_unit, constraints.max_missing)
    constraints = constraints.of_images()
    return limit_images(bank, now.image, wanted.image, seen, constraints=constraints, **more)


def limit_images(
    bank: Bank,
    first: np.ndarray,
    goal: np.ndarray,
    seen: np.ndarray | None,
    *,
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    check: Callable[[], object] = lambda: None,
) -> Limit:
    """`limit` of images (H, W) that are checked, of which only pixels that were `seen` count.

    `check` is called some times a second: what it raises ends the work.
    """
    check_records(space, constraints, stop)
    records = space, constraints, stop
    state, candidates, limits, _ = search_inputs(bank, first, goal, seen, "greedy", *records)
    tried = tasks.strengths(space.strengths)
    between = [(a + b) / 2 for a, b in zip(tried[:-1], tried[1:], strict=True)]
    changes = level_changes(state, candidates, sorted({*tried, *between}))
    uses = _allowance(state, limits, int(stop.max_steps))
    changes = [one for one in changes if one.places.any() and uses.most[one.action] > 0]
    r = np.asarray(state.goal, np.float64) - np.asarray(state.now, np.float64)
    weight = np.full(r.shape, 1.0 / r.size)
    if state.weight is not None:
        weight = np.asarray(state.weight, np.float64)
    distance = float((weight * np.abs(r)).sum())
    apart = max(distance, 1e-30)
    window, within = _window(changes, weight * np.abs(r), uses)
    bounds = [
        Bound("window", window / apart, "always: an action changes nothing outside its window")
    ]
    if state.node_m is not None:
        material = _material(state, changes, weight, uses)
        bounds.append(Bound("material", material / apart, _HOLDS["material"]))
    shape, rest, left, short = 0.0, r, np.abs(r), uses.steps == 0
    if changes and uses.steps and distance:
        few = {tried[0], tried[len(tried) // 2], tried[-1]}
        these = [one for one in changes if one.strength in few]
        found = solved(r, weight, these, uses, check)
        multipliers = (found.plain, found.beyond), climbed(r, weight, these, uses, found, check)
        best = max(multipliers, key=lambda both: certified(r, weight, these, uses, *both, check))
        shape = certified(r, weight, changes, uses, *best, check)
        if state.node_m is not None:
            shape -= ROUNDING * distance
        short = found.short
        if (weight * found.left).sum() < distance:  # else nothing better than none was found
            rest, left = found.rest, found.left
    elif distance:
        shape = distance
    bounds.append(Bound("shape", shape / apart, _HOLDS["shape"]))
    causes = _causes(state, changes, r, rest, uses.lower, short)
    causes[(causes > 0) & ~within] = 1 + CAUSES.index("out of reach")
    unit = 1e3 if state.node_m is not None else float(metric.to_mm(1.0, bank.camera))
    v, u = np.indices(bank.camera.shape)
    at = state.node(np.stack([v, u], -1).reshape(-1, 2))
    row, column = np.clip(at, 0, np.array(r.shape) - 1).T

    def on_pixels(field: np.ndarray) -> np.ndarray:
        return field[row, column].reshape(bank.camera.shape)

    return Limit(
        camera=bank.camera,
        bounds=tuple(replace(one, left=float(np.clip(one.left, 0.0, 1.0))) for one in bounds),
        max_steps=uses.steps,
        distance_mm=float(metric.to_mm(distance, bank.camera)),
        fractions=float((weight * left).sum() / apart),
        wanted_mm=on_pixels(unit * uses.lower * r).astype(np.float32),
        remains_mm=on_pixels(unit * uses.lower * rest).astype(np.float32),
        causes=on_pixels(causes),
        seen=seen,
    )


_HOLDS = {
    "material": "if no action raises the bed as a whole by more than it does to a level one, "
    "nothing is cut off at the far end of the camera's range, and no material comes from beyond "
    "the view",
    "shape": "if each action changes the bed as it would change a level one, nothing of it is cut "
    "off at the far end of the camera's range, in a direction and length that is tried, with a "
    "strength that is tried or in the middle between two",
}


def _allowance(state: SearchState, limits: SearchLimits, steps: int) -> Allowance:
    carried = frozenset(action for pair in state.carries for action in pair)
    most = np.array(limits.max_uses, np.float64)
    for action in carried:
        most[action] = np.asarray(limits.carry_uses)[action]
    stock = float(np.nan_to_num(float(limits.stock)))
    return Allowance(steps, most, carried, stock, state.lower)


def _window(
    changes: Sequence[LevelChange], apart: np.ndarray, uses: Allowance
) -> tuple[float, Bool[np.ndarray, "R C"]]:
    """What stays where no window reaches, or K windows do not altogether; and what one reaches."""
    size = [fft.next_fast_len(n, real=True) for n in apart.shape]
    spectrum = fft.rfft2(apart, size)
    covered, most = np.zeros(apart.shape, bool), dict.fromkeys((c.action for c in changes), 0.0)
    kinds = {(c.action, c.change.shape, c.low, c.places.tobytes()): c for c in changes}
    for one in kinds.values():
        window = fft.rfft2(np.ones(one.change.shape), size)
        (v, u), (p, q) = one.low, one.places.shape
        sums = fft.irfft2(spectrum * window.conj(), size)[v : v + p, u : u + q]
        most[one.action] = max(most[one.action], float(sums[one.places].max(initial=0.0)))
        places = np.zeros(size)
        places[v : v + p, u : u + q] = one.places
        reached = fft.irfft2(fft.rfft2(places) * window, size)[: apart.shape[0], : apart.shape[1]]
        covered |= reached > 0.5
    beyond, steps = float(apart.sum()), float(uses.steps)
    for action in sorted(most, key=lambda action: -most[action]):  # the largest as often as allowed
        count = min(steps, float(uses.most[action]))
        beyond, steps = beyond - count * most[action], steps - count
    return max(float(apart[~covered].sum()), beyond), covered


def _material(
    state: SearchState, changes: Sequence[LevelChange], weight: np.ndarray, uses: Allowance
) -> float:
    """What stays since material is missing: it lies where it counts least, as deep as is seen.

    The least of Σ weight·e with Σ e = what is missing and 0 <= e <= what the camera sees below the
    goal: a fractional knapsack.
    """
    now, goal = np.asarray(state.now, np.float64), np.asarray(state.goal, np.float64)
    rises = [-one.change.sum() for one in changes if one.action not in uses.carried]
    inside = weight > 0
    missing = (
        (now - goal)[inside].sum() - uses.stock - uses.steps * max(max(rises, default=0.0), 0.0)
    )
    order = np.argsort(weight[inside])
    room = (float(state.limits[1]) - goal[inside])[order]
    ahead = np.cumsum(room) - room
    return float((weight[inside][order] * np.clip(missing - ahead, 0.0, room)).sum())


def _causes(
    state: SearchState,
    changes: Sequence[LevelChange],
    r: np.ndarray,
    rest: np.ndarray,
    lower: float,
    short: bool,
) -> Int[np.ndarray, "R C"]:
    """Why something remains at each node, as a number of `CAUSES`; 0: nothing does."""
    unit = 1e3 if state.node_m is not None else 1.0
    least = LEAST_MM / unit if state.node_m is not None else 0.05 * float(np.abs(r).max())
    remains = np.abs(rest) > max(least, 1e-12)
    steepest = max((_slope(one.change).max() for one in changes), default=0.0)
    walls = _slope(ndimage.gaussian_filter(np.asarray(state.goal, np.float64), 1.0)) > steepest
    around = WALL / float(state.node_m) if state.node_m is not None else 5.0
    far = np.asarray(ndimage.distance_transform_edt(~walls))
    near = (far <= around) & walls.any()
    found = np.where(near, 3, 4)
    found[(rest * np.sign(r) > np.abs(r) / 4) & short] = 2
    found[(lower * rest < 0) & (lower * r < 0)] = 1
    return np.where(remains, found, 0).astype(np.int8)


def _slope(field: np.ndarray) -> np.ndarray:
    """Steepness at each node, per node."""
    if min(field.shape) < 2:
        return np.zeros(field.shape)
    return np.hypot(*np.gradient(field))
