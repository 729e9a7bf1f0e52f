"""The bed seen from straight above: a depth frame laid on a metric grid, and back.

Arrays of the image are `[v, u]`, arrays of the map `[y, x]`; x runs along u, y along v, in the
camera's frame.  Heights are metres above the bed's level, up.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Bool, Float
from jshape.camera import Camera, check_camera
from jshape.data.depth import check_shape, to_metres
from jshape.data.missing import LIMIT, fill_missing, missing
from jshape.data.view import LEAST_SEEN, above
from jshape.models.orthographic import OrthographicGrid

SPAN = 0.06
"""What is farther than this from the bed's level, metres, is no bed: table, wall or hand.  It is
clipped, so that the planes of `OrthographicGrid` stand close enough."""
MOST_NODES = 640
"""Most nodes along a side of the map: larger images are seen a little coarser than their pixels."""

Pixel = tuple[float | int, float | int]
"""(u, v), which need not be whole."""


@dataclass(frozen=True, eq=False)
class BedMap:
    """The bed of a depth frame, seen from above."""

    camera: Camera
    """Of the part of the frame that is looked at."""
    frame: Float[np.ndarray, "H W"]
    """The whole frame, gaps filled, metres."""
    corner: tuple[int, int]
    """(u, v) of the part's first pixel in the frame."""
    level: float
    """Depth of height 0: the median in the middle of the part, metres."""
    grid: OrthographicGrid
    """The grid."""
    height: Float[np.ndarray, "Y X"]
    """Of the surface above the level, metres."""
    inside: Bool[np.ndarray, "Y X"]
    """Where the camera looks."""
    seen: Bool[np.ndarray, "Y X"]
    """Where of it the bed counts: from above, what nobody saw is unknown and stays as it is."""
    filled: int
    """Pixels of the frame that had no reading and count."""

    @property
    def cell(self) -> float:
        """Side of a cell, metres."""
        return float(self.grid.pitch)

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """X of the columns and y of the rows in the camera's frame, metres."""
        x, y = self.grid.nodes(jnp.zeros(2, jnp.int32))
        return np.asarray(x), np.asarray(y)

    def pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """U and v (Y, X) in the frame of every node of the surface."""
        x, y = self.axes()
        u, v = self.camera.pixel(x[None, :], y[:, None], self.level - self.height)
        u, v = np.broadcast_arrays(u, v)  # of parallel rays a row and a column
        return u + self.corner[0], v + self.corner[1]

    def at_nodes(self, pixels: np.ndarray) -> np.ndarray:
        """What a field on the frame (H, W) is at the nodes (Y, X)."""
        u, v = (np.rint(k).astype(int) for k in self.pixels())
        rows, columns = pixels.shape
        return pixels[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]

    def point(self, at: Pixel) -> tuple[float, float]:
        """(x, y) on the level below pixel (u, v) of the frame, metres."""
        x, y = self.camera.at(at[0] - self.corner[0], at[1] - self.corner[1], self.level)
        return float(x), float(y)

    def middle(self) -> tuple[float, float]:
        """Pixel (u, v) in the middle of the part that is looked at."""
        return (
            self.corner[0] + (self.camera.width - 1) / 2,
            self.corner[1] + (self.camera.height - 1) / 2,
        )

    def view(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest (x, y) of the level that the camera sees, metres."""
        (u, v), size = self.corner, (self.camera.width, self.camera.height)
        low = np.array(self.point((u - 0.5, v - 0.5)))
        return low, np.array(self.point((u + size[0] - 0.5, v + size[1] - 0.5)))

    def heights_of(self, frame: np.ndarray) -> Float[np.ndarray, "Y X"]:
        """Heights on this map of another frame (H, W) of the same camera, metres, without gaps."""
        part = _part(frame, self.corner, self.camera)
        return self.level - np.asarray(_from_above(self.grid, _near(part, self.level)))

    def frame_with(self, height: np.ndarray, like: np.ndarray | None = None) -> np.ndarray:
        """The frame (H, W) in metres that the camera would take if the surface were `height`.

        Only what differs is looked at again; all else keeps every bit.

        Args:
          height: (Y, X) wanted, metres.
          like: (H, W) the frame of the surface that differs least; None is the bed's own.
        """
        frame = self.frame if like is None else like
        before = self.height if like is None else self.heights_of(like)
        surfaces = (self.level - np.stack([before, height])).astype(np.float32)
        old, new = np.asarray(_from_camera(self.grid, surfaces))
        result = np.array(frame, np.float32)
        _part(result, self.corner, self.camera)[:] += new - old
        return result

    def cm3(self, change: np.ndarray) -> float:
        """Volume of a change of height (Y, X), cm³."""
        return 1e6 * self.cell**2 * float(change.sum(dtype=np.float64))


def bed_map(
    frame: np.ndarray,
    camera: Camera,
    *,
    window: tuple[int, int, int, int] | None = None,
    max_missing: float = LIMIT,
    where: str = "bed",
) -> BedMap:
    """The bed of a frame, seen from above.

    Args:
      frame: (H, W) metres; 0 and NaN mean "no reading".
      camera: that took it, from straight above.
      window: (left, top, width, height) of the part to look at, pixels; None is all.
      max_missing: largest share of the pixels without a reading that is filled; from above, what
        nobody saw is no gap.
      where: what to call the frame in errors.

    Raises:
      BadImage: another size than the camera's, or no reading.
      MissingDepth: too many pixels without a reading.
      BadCamera: a camera that makes no sense, or a window that leaves its image.
    """
    check_camera(camera)
    check_shape(frame, camera, where)
    depth = to_metres(frame, 1.0, where)
    known = ~(missing(depth) & above(camera))
    limit = max_missing if known.all() else 1.0 - LEAST_SEEN
    whole, filled = fill_missing(depth, limit=limit, where=where)
    left, top, width, height = window or (0, 0, camera.width, camera.height)
    camera = camera.crop(left, top, width, height)
    part = _part(whole, (left, top), camera)
    quarter = np.s_[height // 4 : height - height // 4, width // 4 : width - width // 4]
    level = float(np.median(part[quarter]))
    pixel = [1 / float(scale) for scale in camera.scale(level)]
    sides = width * pixel[0], height * pixel[1]
    cell = max(*pixel, max(sides) / MOST_NODES)
    # Lower places are seen wider: 5 % are 23 mm at 0.45 m.
    columns, rows = (int(1.05 * side / cell) + 2 for side in sides)
    grid = OrthographicGrid(
        camera, jnp.float32(level), jnp.float32(cell), (rows, columns), (width, height)
    )
    surface = level - np.asarray(_from_above(grid, _near(part, level)))
    everywhere = np.ones(surface.shape, bool)
    bed = BedMap(
        camera=camera,
        frame=whole,
        corner=(left, top),
        level=level,
        grid=grid,
        height=surface,
        inside=everywhere,
        seen=everywhere,
        filled=filled if known.all() else 0,
    )
    u, v = bed.pixels()
    inside = (np.abs(u - left - (width - 1) / 2) <= width / 2) & (
        np.abs(v - top - (height - 1) / 2) <= height / 2
    )
    return replace(bed, inside=inside, seen=inside & bed.at_nodes(known))


def _part(frame: np.ndarray, corner: tuple[int, int], camera: Camera) -> np.ndarray:
    """The part of a frame that a window's camera sees; a view, not a copy."""
    left, top = corner
    return frame[top : top + camera.height, left : left + camera.width]


def _near(depth: np.ndarray, level: float) -> np.ndarray:
    return np.clip(depth, level - SPAN, level + SPAN).astype(np.float32)


@jax.jit
def _from_above(grid: OrthographicGrid, depth: Array) -> Array:
    return grid.from_roi(jnp.asarray(depth), jnp.zeros(2, jnp.int32))


@jax.jit
def _from_camera(grid: OrthographicGrid, surfaces: Array) -> Array:
    return grid.to_roi(jnp.asarray(surfaces), jnp.zeros(2, jnp.int32))
