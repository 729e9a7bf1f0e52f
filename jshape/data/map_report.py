"""What each camera gave to a height map: where it stands, how much it sees, how it errs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jshape.camera import Camera, matrix
from jshape.data.fusion import Look, noise_of
from jshape.height_map import HeightMap


class Stand(NamedTuple):
    """A camera over a bed, and what it saw of the bed's map."""

    tilt_deg: float
    """Of its axis against the plane's normal."""
    distance: float
    """To the plane along its axis, metres."""
    seen: float
    """Share of the map's nodes that it saw."""
    noise_mm: float
    """Expected standard deviation of a height from all of its frames, the median over its nodes."""
    frames: int


class MapReport(NamedTuple):
    """What is to be said of a map."""

    cameras: tuple[Stand, ...]
    seen: float
    """Share of the nodes that are known, narrow gaps filled."""
    noise_mm: float
    """Expected standard deviation of a height, the median over the nodes."""
    low_mm: float
    high_mm: float
    """Heights that all but one node in 100 lie above, and below."""


def map_report(
    looks: Sequence[Look],
    frames: Sequence[int],
    found: HeightMap,
    target: Camera,
    each: Sequence[np.ndarray],
) -> MapReport:
    """The report on a map.

    The mean of n frames is taken to have a noise of 1/sqrt(n): what comes anew with each.  What a
    camera errs by in all of them, as its own waviness, stays.

    Args:
      looks: that the map was made of.
      frames: how many each is the mean of.
      found: the map.
      target: its camera.
      each: what that sees of each look: see `together`.
    """
    frame = matrix(found.frame)
    stands, precision = [], np.zeros(target.shape)
    for look, count, depth in zip(looks, frames, each, strict=True):
        there = np.isfinite(depth)
        noise = noise_of(look, target, np.nan_to_num(depth, nan=1.0)) / np.sqrt(count)
        precision += np.where(there, noise.astype(float) ** -2, 0.0)
        to_map = np.linalg.inv(frame) @ look.to_common
        down = float(-to_map[2, 2])
        stands.append(
            Stand(
                float(np.degrees(np.arccos(np.clip(down, -1.0, 1.0)))),
                float(to_map[2, 3]) / down,
                float(there.mean()),
                1e3 * float(np.median(noise[there])) if there.any() else float("nan"),
                int(count),
            )
        )
    known = np.asarray(found.heights)[found.mask]
    low, high = np.percentile(1e3 * known, (1, 99))
    noise = 1e3 * float(np.median(precision[precision > 0] ** -0.5))
    return MapReport(tuple(stands), float(found.mask.mean()), noise, float(low), float(high))
