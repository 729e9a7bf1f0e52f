"""The bed as heights on a square grid, seen from straight above.

A map's frame is right-handed: x along the image's u, y against its v, z up, along the normal of the
bed's plane towards the camera, 0 at the plane.  Heights are `[row, column]` with rows along y and
columns along x, metres, float32.  Where no camera saw the bed a height is NaN.

A map is what a camera with parallel rays sees (`HeightMap.camera`): so whatever takes depth images
takes maps.
"""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jshape._typing import Array, ArrayLike, Bool, Float
from jshape.camera import STATIC, Camera, matrix
from jshape.errors import BadCamera, BadImage, quoted

ABOVE = 0.45
"""Metres over the plane from which a map's camera looks: the paper's, for the bundled banks."""
REACH = 0.3
"""Metres above and below the plane that it sees, and as much more as a map needs."""
HIGHEST = 2.0
"""Most relief of a map, metres; more were millimetres."""

Frame = tuple[tuple[float, ...], ...]
"""(4, 4) as nested tuples, which can be compared and hashed."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False, repr=False)
class HeightMap:
    """A bed's heights above a plane, on a square grid."""

    heights: Float[Any, "R C"]
    """Metres; NaN where nothing is known.  Rows along y, columns along x."""
    pitch: float | Array
    """Metres between neighbouring nodes."""
    origin: tuple[float, float] = (0.0, 0.0)
    """x and y of the first node, metres."""
    seen: Bool[Any, "R C"] | None = None
    """Which heights were seen; None: all that are numbers."""
    frame: Frame | None = field(default=None, metadata=STATIC)
    """(4, 4) from the map's frame to the one that the cameras share; None: they are the same."""

    def __repr__(self) -> str:
        rows, columns = np.shape(self.heights)
        known = np.asarray(self.heights)[self.mask]
        span = f"{1e3 * known.min():.1f} to {1e3 * known.max():.1f} mm" if known.size else "nothing"
        return (
            f"HeightMap({columns}x{rows} nodes of {1e3 * float(self.pitch):.3g} mm, {span}, "
            f"{self.mask.mean():.1%} seen)"
        )

    @property
    def mask(self) -> Bool[np.ndarray, "R C"]:
        """Where a height is known (host)."""
        known = np.isfinite(np.asarray(self.heights))
        return known if self.seen is None else known & np.asarray(self.seen, bool)

    @property
    def x(self) -> Float[np.ndarray, "C"]:
        """Of the columns, metres (host)."""
        columns = np.shape(self.heights)[1]
        return (float(self.origin[0]) + float(self.pitch) * np.arange(columns)).astype(np.float32)

    @property
    def y(self) -> Float[np.ndarray, "R"]:
        """Of the rows, metres (host)."""
        rows = np.shape(self.heights)[0]
        return (float(self.origin[1]) + float(self.pitch) * np.arange(rows)).astype(np.float32)

    def camera(self, *others: "HeightMap", bits: int = 16) -> Camera:
        """The camera that looks at the map from straight above, one pixel a node (host).

        Its rays are parallel, its rows run against y, and its range holds the heights of the
        `others` too.  Its pose is in the frame that the cameras share.
        """
        known = np.concatenate([np.asarray(one.heights)[one.mask] for one in (self, *others)])
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        rows, columns = np.shape(self.heights)
        frame = matrix(self.frame)
        size, origin = (columns, rows), (float(self.origin[0]), float(self.origin[1]))
        return camera_above(frame, size, float(self.pitch), origin, (low, high), bits=bits)

    def depth(self, camera: Camera) -> Float[np.ndarray, "R C"]:
        """What such a camera sees, metres; NaN where nothing is known (host)."""
        heights = np.where(self.mask, np.asarray(self.heights, np.float32), np.float32(np.nan))
        return np.float32(_above(camera, self.frame)) - heights[::-1]


def camera_above(
    frame: np.ndarray,
    size: tuple[int, int],
    pitch: float,
    origin: tuple[float, float],
    span: tuple[float, float] = (0.0, 0.0),
    *,
    bits: int = 16,
) -> Camera:
    """The camera that sees a map of `size` (columns, rows) whose heights lie within `span`."""
    (columns, rows), low, high = size, min(-REACH, span[0]), max(REACH, span[1])
    above = max(ABOVE, high + ABOVE - REACH)
    return Camera(
        width=columns,
        height=rows,
        fx=1.0 / pitch,
        fy=1.0 / pitch,
        u0=-origin[0] / pitch,
        v0=rows - 1 + origin[1] / pitch,
        z_min=above - high,
        z_max=above - low,
        bits=bits,
        orthographic=True,
        pose=as_frame(frame @ looking_down(above)),
    )


def map_of(depth: Float[Any, "R C"], camera: Camera, frame: Frame | None = None) -> HeightMap:
    """The map that a camera of `camera_above` sees (metres, NaN: nothing): of its plane's `frame`.

    Without a frame the heights are above the plane `ABOVE` metres below the camera.

    Raises:
      BadCamera: it does not look from straight above with parallel rays.
    """
    if not camera.orthographic:
        raise BadCamera("a height map is what an orthographic camera sees")
    pitch, above = 1.0 / float(camera.fx), ABOVE if frame is None else _above(camera, frame)
    if frame is None and camera.pose is not None:
        frame = as_frame(np.array(camera.pose) @ np.linalg.inv(looking_down(above)))
    heights = (np.float32(above) - np.asarray(depth, np.float32))[::-1]
    origin = -float(camera.u0) * pitch, (float(camera.v0) - camera.height + 1) * pitch
    return HeightMap(heights, pitch, origin, np.isfinite(heights), frame)


def places_on(camera: Camera, positions: ArrayLike) -> Float[np.ndarray, "K 2"]:
    """X and y on its map, metres, of pixels (K, 2) of (u, v) of a camera of `camera_above`."""
    u, v = np.asarray(positions, float).reshape(-1, 2).T
    x, y = (u - float(camera.u0)) / float(camera.fx), (float(camera.v0) - v) / float(camera.fy)
    return np.stack([x, y], -1)


def as_frame(matrix: ArrayLike) -> Frame:
    """A (4, 4) matrix as nested tuples."""
    return tuple(tuple(float(x) for x in row) for row in np.asarray(matrix))


def looking_down(above: float) -> np.ndarray:
    """(4, 4) from the frame of a camera over a map's origin, which looks down, to the map's."""
    look = np.diag([1.0, -1.0, -1.0, 1.0])
    look[2, 3] = above
    return look


def _above(camera: Camera, frame: Frame | None) -> float:
    """How far over the map's plane its camera is, metres."""
    return float((np.linalg.inv(matrix(frame)) @ matrix(camera.pose))[2, 3])


def check_map(found: HeightMap, where: str = "height map") -> HeightMap:
    """The map itself, if it can be one (host).

    Raises:
      BadImage: no (R, C) array of numbers, a pitch that is none, nothing seen, or seen where no
        height is.
    """
    heights = np.asarray(found.heights)
    if heights.ndim != 2 or min(heights.shape) < 2 or heights.dtype.kind != "f":
        raise BadImage(
            f"{where}: heights have shape {heights.shape} and type {heights.dtype}; expected (rows,"
            " columns) of metres as floats"
        )
    try:
        pitch = float(found.pitch)
    except (TypeError, ValueError):
        pitch = 0.0
    if not 1e-5 <= pitch <= 0.1:
        raise BadImage(
            f"{where}: pitch is {quoted(found.pitch)}; expected 0.00001 to 0.1 metres between nodes"
        )
    if found.seen is not None and np.shape(found.seen) != heights.shape:
        raise BadImage(
            f"{where}: seen has shape {np.shape(found.seen)}; the heights have {heights.shape}"
        )
    if found.seen is not None:
        unknown = int(np.sum(np.asarray(found.seen, bool) & ~np.isfinite(heights)))
        if unknown:
            raise BadImage(
                f"{where}: seen is true at {unknown} nodes without a height; there it must be false"
            )
    if not found.mask.any():
        raise BadImage(f"{where}: no height is known")
    relief = float(np.ptp(heights[found.mask]))
    if relief > HIGHEST:
        raise BadImage(
            f"{where}: heights span {relief:g}; they are in metres, at most {HIGHEST:g} (in "
            f"millimetres it would be {relief / 1e3:g} m)"
        )
    return found
