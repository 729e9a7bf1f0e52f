"""Multipliers of the convex relaxation that prove more: straight up what they prove (host).

`relaxation.solved` finds fractions; its multipliers are a by-product that proves little.  What any
proves is concave in them (see `certificate`): the change wanted, as they weigh it, less K times the
best gain of one action.  The best is rounded to an average over all that gain nearly as much.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.planning.coarse import Allowance, CoarseMap, LevelChange
from jshape.planning.relaxation import Solution, multipliers


class Climb(NamedTuple):
    """Steps on one map."""

    squares: int
    """Along its longer side."""
    steps: int
    rates: tuple[float, float]
    """Of Adam, at first and in the end."""
    near: tuple[float, float]
    """Over which share of the best gain it is rounded, at first and in the end."""


CLIMBS = Climb(80, 150, (0.05, 0.004), (0.1, 0.03)), Climb(160, 60, (0.02, 0.002), (0.05, 0.02))
"""Places between squares gain more than those on them: without the second a letter in 4 actions
proves 30 % instead of 34, a trench 0 instead of 4.  A third on all nodes adds 1 to 8 and 10 s."""
KINDS = 60
"""Of actions, for which so many steps are made; fewer for more."""
WHOLE = 5
"""Steps between two looks at all kinds; else at those within 8 times `near` of the best."""
SHIFTS = 0.0, 0.02, 0.05, 0.1, 0.2, 0.4
"""Shares by which t and q are moved towards t = -1 before the first step (see `certificate`)."""


def climbed(
    wanted: Float[np.ndarray, "R C"],
    weight: Float[np.ndarray, "R C"],
    changes: Sequence[LevelChange],
    uses: Allowance,
    found: Solution,
    check: Callable[[], object] = lambda: None,
) -> tuple[Float[np.ndarray, "R C"], Float[np.ndarray, "R C"]]:
    """The multipliers (t, q) on all nodes, from those of a solution."""
    t, q = found.plain, found.beyond
    for climb in CLIMBS:
        coarse = CoarseMap.of(wanted, weight, changes, uses, climb.squares)
        t, q = coarse.of_nodes(t, weight), coarse.of_nodes(q, weight)
        shifts = SHIFTS if climb is CLIMBS[0] else (0.0,)
        t, q = _up(coarse, climb, found.prices, uses, t, q, shifts, check)
        t, q = coarse.on_nodes(t), coarse.on_nodes(q)
    return t, q


def _up(
    coarse: CoarseMap,
    climb: Climb,
    prices: Float[np.ndarray, "G"],
    uses: Allowance,
    t: Float[np.ndarray, "R C"],
    q: Float[np.ndarray, "R C"],
    shifts: Sequence[float],
    check: Callable[[], object],
) -> tuple[Float[np.ndarray, "R C"], Float[np.ndarray, "R C"]]:
    w, r, truncated = coarse.weight, coarse.wanted, coarse.truncated
    sign, size_of_r, counted = np.sign(r), np.abs(r), w > 0
    norms, prices = (a[:, None, None].astype("f4") for a in (coarse.norms, prices))
    every = np.flatnonzero(coarse.free.any((1, 2)))
    if not every.size:
        return t, q
    steps = max(int(climb.steps * min(1.0, KINDS / len(norms))), 1)

    def proven(t: np.ndarray, q: np.ndarray, kinds: np.ndarray) -> tuple[float, np.ndarray, float]:
        """What is proven, each place's gain, and the best."""
        gains = coarse.felt(w * (t - q * sign), 2 * w * q, kinds) * norms[kinds] - prices[kinds]
        gains = np.where(coarse.free[kinds], gains, -np.inf)
        best = max(float(gains.max()), 0.0)
        return float((w * (t * r + q * size_of_r)).sum()) - uses.steps * best, gains, best

    starts = [((1 - k) * t - k * uses.lower, (1 - k) * q) for k in shifts]
    t, q = max(starts, key=lambda one: proven(*one, every)[0])
    most, kept, near = -np.inf, (t, q), every
    slopes = squares = np.zeros((2, *t.shape), "f4")
    for n in range(steps + 1):
        check()
        whole = n % WHOLE == 0 or n == steps
        value, gains, best = proven(t, q, every if whole else near)
        over = np.float32(climb.near[0] * (climb.near[1] / climb.near[0]) ** (n / steps) * best)
        if whole:
            close = gains.max((1, 2)) >= best - 8 * over
            near, gains = every[close], gains[close]
            if value > most:
                most, kept = value, (t, q)
        if best <= 0 or n == steps:  # all is proven, or nothing more is asked
            break
        share = np.exp((gains - np.float32(best)) / over)
        share *= np.float32(uses.steps) / share.sum()
        v, u = coarse.changed(share * norms[near], near)
        slope = np.stack([r - v, (size_of_r - 2 * u + sign * v) * truncated]) * counted
        slopes, squares = 0.9 * slopes + 0.1 * slope, 0.99 * squares + 0.01 * slope**2
        rate = climb.rates[0] * (climb.rates[1] / climb.rates[0]) ** (n / steps)
        mean = slopes / (1 - 0.9 ** (n + 1)), np.sqrt(squares / (1 - 0.99 ** (n + 1)))
        step = (rate * mean[0] / (mean[1] + 1e-12)).astype("f4")
        t, q = multipliers(t + step[0], (q + step[1]) * truncated)
    return kept
