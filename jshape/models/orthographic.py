"""The ground below a ROI, seen from straight above: depth pixels to a metric grid and back.

A camera sees a bed from the side wherever it does not stand right above it: a hole of 20 mm moves
by 8 pixels towards the middle at the edge of the paper's box, so the same action makes another ΔI
at another corner.  On a metric grid fixed to the corner it makes the same change everywhere
(Hypothesis 4).  Depths in metres, arrays `[v, u]`; the grid's columns run along u, rows along v.

Both ways look for where a line meets the surface: of `LEVELS` planes across the line, the first
one that is below the surface, and linearly between it and the one before.  On a plane the pixels
of a ROI are a regular grid again, so each plane costs one separable interpolation.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape import metric
from jshape._typing import Array, Float, Int
from jshape.camera import STATIC, Camera, namespace

LEVELS = 12
"""Planes across the range of depths: 5 mm apart in the deepest bed that the paper's camera sees."""
LEAST_RANGE = 1e-3
"""Least distance between the first and the last plane, metres: a flat bed has no range."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OrthographicGrid:
    """A metric grid around the point below a ROI's centre, at the depth where actions are placed.

    Its node (rows // 2, columns // 2) is where the ray through the ROI's centre pixel reaches
    `depth`.
    """

    camera: Camera
    """That sees the ROIs."""
    depth: float | Array | np.ndarray
    """Depth at which places are meant (Hypothesis 3: one for all), metres."""
    pitch: float | Array | np.ndarray
    """Distance between neighbouring nodes, metres."""
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of the grid."""
    roi: tuple[int, int] = field(metadata=STATIC)
    """ROI size (w, h), pixels."""

    @classmethod
    def over(cls, camera: Camera, roi: tuple[int, int]) -> "OrthographicGrid":
        """Of one node: a ROI of which neither depth nor pitch are known yet."""
        return cls(camera, 1.0, 1.0, (1, 1), roi)

    def from_roi(
        self, depth: Float[Any, "h w"], corner: Int[Any, "2"]
    ) -> Float[Any, "rows columns"]:
        """The surface below the grid's nodes, metres from the camera along its axis.

        Args:
          depth: of the ROI's pixels, metres, without gaps.
          corner: first pixel (u, v) of the ROI in the image.
        """
        x, y = self.nodes(corner)

        def look(z):
            u, v = self.camera.pixel(x, y, z)
            return _sample(depth, v - top, u - left)

        left, top = namespace(corner).asarray(corner, np.float32)
        return _first_below(look, depth.min(), depth.max())

    def to_roi(
        self, surface: Float[Any, "B rows columns"], corner: Int[Any, "2"]
    ) -> Float[Any, "B h w"]:
        """Depth of the ROI's pixels, metres, if the ground has these surfaces.

        All are looked at with the same planes, so that what is equal in them is seen equal.
        """
        x, y = self.nodes(corner)
        w, h = self.roi
        corner = namespace(corner).asarray(corner, np.float32)
        u, v = (
            corner[0] + np.arange(w, dtype=np.float32),
            corner[1] + np.arange(h, dtype=np.float32),
        )

        def look(z):
            across, along = self.camera.at(u, v, z)
            return _sample(surface, (along - y[0]) / self.pitch, (across - x[0]) / self.pitch)

        return _first_below(look, surface.min(), surface.max())

    def seen_by(self, camera: Camera, depth: float) -> "OrthographicGrid":
        """The same ground below another camera, with places `depth` metres from it."""
        ours, theirs = self.camera.scale(float(self.depth)), camera.scale(depth)
        w, h = (round(float(n * b / a)) for n, a, b in zip(self.roi, ours, theirs, strict=True))
        return replace(self, camera=camera, depth=jnp.float32(depth), roi=(max(w, 1), max(h, 1)))

    def per_metre(self, corner: Int[Any, "2"]) -> Float[Any, "h w"]:
        """How much I of a ROI's pixels falls per metre that the ground is lower.  Eq. newMat."""
        camera = self.camera
        weight = namespace(camera, corner).asarray(metric.roi_weight(camera, corner, self.roi))
        return weight / (camera.z_max - camera.z_min)

    def nodes(self, corner: Int[Any, "2"]) -> tuple[Float[Any, "columns"], Float[Any, "rows"]]:
        """X of the columns and y of the rows in the camera's frame, metres."""
        camera, (w, h), (rows, columns) = self.camera, self.roi, self.shape
        corner = namespace(corner).asarray(corner, np.float32)
        x, y = camera.at(corner[0] + w // 2, corner[1] + h // 2, self.depth)
        return (
            x + (np.arange(columns, dtype=np.float32) - columns // 2) * self.pitch,
            y + (np.arange(rows, dtype=np.float32) - rows // 2) * self.pitch,
        )


def _sample(
    surface: Float[Any, "*B n m"], rows: Float[Any, "h"], columns: Float[Any, "w"]
) -> Float[Any, "*B h w"]:
    """Linear interpolation on all crossings of rows and columns; beyond the edge, the edge.

    Rows are copied whole.  Columns are picked by NumPy; in compiled code they are a product with a
    matrix of hats, which runs at the speed of the vector units where picking would not.
    """
    xp = namespace(surface, rows, columns)
    n, m = surface.shape[-2:]
    rows = xp.clip(rows, 0.0, n - 1.0)
    low = xp.minimum(rows.astype(np.int32), max(n - 2, 0))
    share = (rows - low.astype(rows.dtype)).reshape(*[1] * (surface.ndim - 2), -1, 1)
    high = xp.minimum(low + 1, n - 1)
    between = (1.0 - share) * surface[..., low, :] + share * surface[..., high, :]
    columns = xp.clip(columns, 0.0, m - 1.0)
    if xp is np:
        left = np.minimum(columns.astype(np.int32), max(m - 2, 0))
        right = np.minimum(left + 1, m - 1)
        share = (columns - left.astype(np.float32)).reshape(*[1] * (surface.ndim - 1), -1)
        return (1.0 - share) * between[..., left] + share * between[..., right]
    node = np.arange(m, dtype=np.float32)[:, None]
    hats = xp.maximum(1.0 - xp.abs(node - columns[None, :]), 0.0)
    return between @ hats


def _first_below(look: Callable, nearest: Any, farthest: Any) -> Any:
    """Depth at which each line first meets the surface.

    Args:
      look: depth of a plane -> the surface's depth where each line crosses that plane.
      nearest: least depth of the surface, metres.
      farthest: greatest.
    """
    start = nearest - LEAST_RANGE / 2
    step = (farthest - nearest + LEAST_RANGE) / (LEVELS - 1)
    gap = look(start) - start
    xp = namespace(gap)

    def descend(level, state):
        gap, met, found = state
        z = start + xp.asarray(level, np.float32) * step
        gap_here = look(z) - z  # positive: the line is still above the surface
        share = gap / xp.maximum(gap - gap_here, 1e-9)
        through = (gap_here <= 0) & ~met
        found = xp.where(through, z - step + share * step, found)
        return gap_here, met | through, found

    state = gap, gap <= 0, xp.full(gap.shape, start)
    if xp is np:
        for level in range(1, LEVELS):
            state = descend(level, state)
    else:
        state = lax.fori_loop(jnp.int32(1), jnp.int32(LEVELS), descend, state)
    _, met, found = state
    return xp.where(met, found, farthest)
