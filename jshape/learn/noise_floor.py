"""The noise floor: how far apart two repetitions of the same action are.

A predictor is told the bed and the action, so it can say one thing about all repetitions.  The best
it can say is their middle m, and its error is the mean of |X - m| over repetitions X.  Two of them
differ by the mean of |X1 - X2|, which for independent normal errors is sqrt(2) times as much: the
difference of two has twice the variance of one.  So the floor is the mean difference over sqrt(2).
"""

from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jshape import metric
from jshape._typing import Array
from jshape.data.missing import fill_nan
from jshape.data.pairs import Examples, Pairs
from jshape.models.orthographic import OrthographicGrid

SAME_BED_MM = 0.75
"""Two frames of one bed differ by less on average: 0.5 mm for a noisy D435, 0 without noise."""
FLAT_MM = 1.0
"""A ROI whose bed has a smaller standard deviation is flat."""
ENOUGH = 3
"""Least couples of pairs that a floor is taken from: fewer say nothing."""
AROUND = 2
"""Sides of the window in which beds are compared, in sides of the ROI."""
PITCH_PX = 2.0
"""Pitch of the grid on which flat beds are compared, in pixels."""


class Floor(NamedTuple):
    """What no predictor's mean error can be below, for one action of one agent."""

    mm: float
    how: str
    """From "repetitions" on one bed at one place; or "flat": from flat beds at any place, an upper
    estimate (6 % too high for a knock, half for a narrow poke): elsewhere other walls are hidden
    and other points of a wall are sampled."""
    count: int
    """Couples of pairs compared."""


def noise_floor(pairs: Pairs) -> dict[tuple[str, str], Floor]:
    """(action, agent) -> floor, for those whose pairs allow it; the others are not in it.

    Repetitions are pairs of one material, strength and place with equal beds before.  Without them,
    any two flat beds of one material serve, if most are flat: seen from straight above and measured
    from the bed's own level, the same action does the same to both.
    """
    found = {}
    for action, of_action in pairs.by_action():
        size = pairs.roi_size(action)
        for agent in dict.fromkeys(of_action.agent.tolist()):
            mine = of_action.of(agent=agent)
            rois = mine.rois(action, size)
            gaps, how = _repetitions(mine, rois), "repetitions"
            if len(gaps) < ENOUGH:
                gaps, how = _flat_beds(mine, rois), "flat"
            if len(gaps) >= ENOUGH:
                found[action, agent] = Floor(float(np.mean(gaps)) / 2**0.5, how, len(gaps))
    return found


def _repetitions(pairs: Pairs, rois: Examples) -> list[float]:
    """Mean differences (mm) between posteriors of all couples on one bed at one place."""
    to_mm = float(metric.to_mm(1.0, pairs.camera))
    (h, w), (rows, columns) = rois.prior.shape[1:], pairs.prior.shape[1:]
    gaps = []
    for one, other in _couples(pairs):
        if (rois.corner[one] != rois.corner[other]).any():
            continue
        u, v = rois.corner[one] + np.array([w, h]) // 2  # what is near decides too
        near = np.s_[
            max(0, v - AROUND * h // 2) : min(rows, v + AROUND * h // 2),
            max(0, u - AROUND * w // 2) : min(columns, u + AROUND * w // 2),
        ]
        looks = (pairs.prior[k][near] for k in (one, other))
        beds = [np.where(x > 0, x.astype(float), np.nan) for x in looks]
        after = np.abs(rois.posterior[one] - rois.posterior[other])
        before_mm = 1e3 * pairs.depth_unit * _mean(np.abs(beds[0] - beds[1]))
        if before_mm <= SAME_BED_MM and np.isfinite(after).any():
            gaps.append(_mean(after) * to_mm)
    return gaps


def _flat_beds(pairs: Pairs, rois: Examples) -> list[float]:
    """The same between flat beds at any place, on a grid seen from straight above."""
    camera = pairs.camera
    blank = OrthographicGrid.over(camera, rois.prior.shape[:0:-1])
    depths, levels, flat = [], [], []
    for before, after, corner in zip(*rois[:3], strict=True):
        per_metre = np.asarray(blank.per_metre(jnp.asarray(corner)))
        height = before / per_metre
        seen = np.isfinite(before).any() and np.isfinite(after).any()
        flat.append(bool(seen and np.nanstd(height) * 1e3 <= FLAT_MM))
        levels.append(float(camera.z_max) - float(np.nanmean(height)) if flat[-1] else np.nan)
        depths.append(float(camera.z_max) - after / per_metre)
    if sum(flat) <= len(flat) / 2:
        return []
    h, w = rois.prior.shape[1:]
    pitch = PITCH_PX / float(camera.scale(float(np.nanmedian(levels)))[0])
    rows = int(h * float(camera.fx) / float(camera.fy) / PITCH_PX)
    reliefs, gaps = {}, []
    for k in np.flatnonzero(flat).tolist():
        grid = OrthographicGrid(camera, levels[k], pitch, (rows, int(w / PITCH_PX)), (w, h))
        surface = _from_above(grid, jnp.asarray(fill_nan(depths[k])), jnp.asarray(rois.corner[k]))
        reliefs[k] = np.asarray(surface) - levels[k]
    along_ray = metric.ray_lengths(camera)
    for one, other in _couples(pairs):
        if one in reliefs and other in reliefs:
            at = [rois.corner[k] + np.array([w, h]) // 2 for k in (one, other)]
            ray = float(np.mean([along_ray[v, u] for u, v in at]))
            gaps.append(1e3 * ray * _mean(np.abs(reliefs[one] - reliefs[other])))
    return [gap for gap in gaps if np.isfinite(gap)]  # two may have no pixel in common


@jax.jit
def _from_above(grid: OrthographicGrid, depth: Array, corner: Array) -> Array:
    return grid.from_roi(depth, corner)


def _couples(pairs: Pairs) -> list[tuple[int, int]]:
    """All two pairs of one material and strength."""
    return [
        (one, other)
        for one, other in combinations(range(len(pairs)), 2)
        if pairs.material[one] == pairs.material[other]
        and pairs.strength[one] == pairs.strength[other]
    ]


def _mean(field: np.ndarray) -> float:
    """Over the pixels that both have; infinite if there are none."""
    seen = np.isfinite(field)
    return float(field[seen].mean()) if seen.any() else float("inf")
