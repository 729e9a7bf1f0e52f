"""The ground below a ROI, seen from straight above: depth pixels to a metric grid and back.

A camera sees a bed from the side wherever it does not stand right above it: a hole of 20 mm moves
by 8 pixels towards the middle at the edge of the paper's box, so the same action makes another ΔI
at another place.  On a metric grid fixed to the place it makes the same change everywhere
(Hypothesis 4).  Depths in metres, arrays `[v, u]`; the grid's columns run along u, rows along v.

Both ways look for where a line meets the surface: of `LEVELS` planes across the line, the first
one that is below the surface, and linearly between it and the one before.  On a plane the pixels
of a ROI are a regular grid again, so each plane costs one separable interpolation.
"""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
from jax import lax

from jshape import metric
from jshape._typing import Array, Float, Int
from jshape.camera import STATIC, Camera

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
    depth: float | Array
    """Depth at which places are meant (Hypothesis 3: one for all), metres."""
    pitch: float | Array
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
        self, depth: Float[Array, "h w"], corner: Int[Array, "2"]
    ) -> Float[Array, "rows columns"]:
        """The surface below the grid's nodes, metres from the camera along its axis.

        Args:
          depth: of the ROI's pixels, metres, without gaps.
          corner: first pixel (u, v) of the ROI in the image.
        """
        camera, (x, y) = self.camera, self.nodes(corner)
        corner = jnp.asarray(corner, jnp.float32)

        def look(z):
            u = camera.fx * x / z + camera.u0 - corner[0]
            v = camera.fy * y / z + camera.v0 - corner[1]
            return _sample(depth, v, u)

        return _first_below(look, depth.min(), depth.max())

    def to_roi(
        self, surface: Float[Array, "B rows columns"], corner: Int[Array, "2"]
    ) -> Float[Array, "B h w"]:
        """Depth of the ROI's pixels, metres, if the ground has these surfaces.

        All are looked at with the same planes, so that what is equal in them is seen equal.
        """
        camera, (x, y) = self.camera, self.nodes(corner)
        w, h = self.roi
        corner = jnp.asarray(corner, jnp.float32)
        across = (corner[0] + jnp.arange(w, dtype=jnp.float32) - camera.u0) / camera.fx
        along = (corner[1] + jnp.arange(h, dtype=jnp.float32) - camera.v0) / camera.fy

        def look(z):
            columns, rows = (across * z - x[0]) / self.pitch, (along * z - y[0]) / self.pitch
            return jax.vmap(lambda one: _sample(one, rows, columns))(surface)

        return _first_below(look, surface.min(), surface.max())

    def seen_by(self, camera: Camera, depth: float) -> "OrthographicGrid":
        """The same ground below another camera, with places `depth` metres from it."""
        closer = float(self.depth) / depth
        size = zip(self.roi, ("fx", "fy"), strict=True)
        w, h = (
            round(n * float(getattr(camera, f)) / float(getattr(self.camera, f)) * closer)
            for n, f in size
        )
        return replace(self, camera=camera, depth=jnp.float32(depth), roi=(max(w, 1), max(h, 1)))

    def per_metre(self, corner: Int[Array, "2"]) -> Float[Array, "h w"]:
        """How much I of a ROI's pixels falls per metre that the ground is lower.  Eq. newMat."""
        camera = self.camera
        return metric.roi_weight(camera, corner, self.roi) / (camera.z_max - camera.z_min)

    def nodes(
        self, corner: Int[Array, "2"]
    ) -> tuple[Float[Array, "columns"], Float[Array, "rows"]]:
        """X of the columns and y of the rows in the camera's frame, metres."""
        camera, (w, h), (rows, columns) = self.camera, self.roi, self.shape
        corner = jnp.asarray(corner, jnp.float32)
        x = (corner[0] + w // 2 - camera.u0) / camera.fx * self.depth
        y = (corner[1] + h // 2 - camera.v0) / camera.fy * self.depth
        return (
            x + (jnp.arange(columns, dtype=jnp.float32) - columns // 2) * self.pitch,
            y + (jnp.arange(rows, dtype=jnp.float32) - rows // 2) * self.pitch,
        )


def _sample(
    surface: Float[Array, "n m"], rows: Float[Array, "h"], columns: Float[Array, "w"]
) -> Float[Array, "h w"]:
    """Linear interpolation on all crossings of rows and columns; beyond the edge, the edge.

    Rows are copied whole, columns are a product with a matrix of hats: on a CPU both run at the
    speed of the vector units, where picking four neighbours a pixel would not.
    """
    n, m = surface.shape
    rows = jnp.clip(rows, 0.0, n - 1.0)
    low = jnp.minimum(rows.astype(jnp.int32), max(n - 2, 0))
    share = (rows - low.astype(rows.dtype))[:, None]
    between = (1.0 - share) * surface[low] + share * surface[jnp.minimum(low + 1, n - 1)]
    columns = jnp.clip(columns, 0.0, m - 1.0)
    node = jnp.arange(m, dtype=columns.dtype)[:, None]
    hats = jnp.maximum(1.0 - jnp.abs(node - columns[None, :]), 0.0)
    return between @ hats


def _first_below(look, nearest: Array, farthest: Array) -> Array:
    """Depth at which each line first meets the surface.

    Args:
      look: depth of a plane -> the surface's depth where each line crosses that plane.
      nearest: least depth of the surface, metres.
      farthest: greatest.
    """
    start = nearest - LEAST_RANGE / 2
    step = (farthest - nearest + LEAST_RANGE) / (LEVELS - 1)

    def descend(level, state):
        gap, met, found = state
        z = start + jnp.asarray(level, jnp.float32) * step
        gap_here = look(z) - z  # positive: the line is still above the surface
        share = gap / jnp.maximum(gap - gap_here, 1e-9)
        through = (gap_here <= 0) & ~met
        found = jnp.where(through, z - step + share * step, found)
        return gap_here, met | through, found

    gap = look(start) - start
    first = (gap, gap <= 0, jnp.full(gap.shape, start))
    _, met, found = lax.fori_loop(jnp.int32(1), jnp.int32(LEVELS), descend, first)
    return jnp.where(met, found, farthest)
