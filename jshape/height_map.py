"""The bed as heights on a square grid, seen from straight above; and from any camera's look to it.

A map's frame is right-handed: x along the image's u, y against its v, z up, along the normal of the
bed's plane towards the camera, 0 at the plane.  Heights are `[row, column]` with rows along y and
columns along x, metres, float32.  Where no camera saw the bed a height is NaN.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, ArrayLike, Bool, Float
from jshape.camera import STATIC, Camera
from jshape.errors import BadImage, quoted

HALVINGS = 6
"""Halvings of the range of heights before interpolation: 64 parts of 200 mm are 3 mm each."""
STEPS = 2
"""Newton's steps after them: 5 um on beds of 20 mm relief, seen from up to 45 degrees."""
STRIDE = 1e-3
"""Metres along which the image of a vertical is taken to be straight."""
LEAST_SLOPE = 0.05
"""Least growth of the gap per metre of height: less is a surface seen from its edge."""
STEEP = 8.0
"""Four pixels whose depths differ by more than so many times a pixel's width at that depth are no
surface but its edge: at 7 degrees against the surface no depth camera measures any more."""
OFF = 2e-3
"""Metres that a point found may be off the surface: more is an edge."""
ABOVE = 0.45
"""Metres over the plane from which a map's camera looks: the paper's, for the bundled banks."""
ROOM = 0.03
"""Metres that its range reaches beyond the lowest and the highest point, for strokes and heaps."""

Frame = tuple[tuple[float, ...], ...]


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
        """The camera that looks at the map from straight above, one pixel a node.

        Its rays are parallel, its rows run against y, and its range holds the heights of the
        `others` too, with `ROOM`.  Its pose is the map's frame.
        """
        rows, columns = np.shape(self.heights)
        known = np.concatenate([np.asarray(one.heights)[one.mask] for one in (self, *others)])
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        above = max(ABOVE, high + 2 * ROOM)
        per_metre = 1.0 / float(self.pitch)
        look = np.diag([1.0, -1.0, -1.0, 1.0])
        look[2, 3] = above
        pose = (np.eye(4) if self.frame is None else np.array(self.frame)) @ look
        return Camera(
            width=columns,
            height=rows,
            fx=per_metre,
            fy=per_metre,
            u0=-float(self.origin[0]) * per_metre,
            v0=rows - 1 + float(self.origin[1]) * per_metre,
            z_min=above - high - ROOM,
            z_max=above - low + ROOM,
            bits=bits,
            orthographic=True,
            pose=as_frame(pose),
        )

    def depth(self, camera: Camera) -> Float[np.ndarray, "R C"]:
        """What such a camera sees, metres; NaN where nothing is known (host)."""
        heights = np.where(self.mask, np.asarray(self.heights, np.float32), np.float32(np.nan))
        return np.float32(_above(camera, self.frame)) - heights[::-1]


def of_view(
    depth: Float[np.ndarray, "R C"], camera: Camera, seen: np.ndarray | None = None
) -> HeightMap:
    """The map that a camera from `HeightMap.camera` sees (metres): the inverse of `depth`."""
    if not camera.orthographic:
        raise BadImage("a height map is seen by an orthographic camera only")
    pitch = 1.0 / float(camera.fx)
    look = np.array(camera.pose) if camera.pose is not None else np.eye(4)
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    turn[2, 3] = ABOVE
    frame = look @ np.linalg.inv(turn)
    return HeightMap(
        heights=(np.float32(ABOVE) - np.asarray(depth, np.float32))[::-1],
        pitch=pitch,
        origin=(-float(camera.u0) * pitch, (float(camera.v0) - camera.height + 1) * pitch),
        seen=None if seen is None else np.asarray(seen)[::-1],
        frame=as_frame(frame),
    )


def as_frame(matrix: ArrayLike) -> Frame:
    """A (4, 4) matrix as nested tuples, which can be compared and hashed."""
    return tuple(tuple(float(x) for x in row) for row in np.asarray(matrix))


def _above(camera: Camera, frame: Frame | None) -> float:
    """How far over the map's plane its camera is, metres."""
    pose = np.eye(4) if camera.pose is None else np.array(camera.pose)
    return float((np.linalg.inv(np.eye(4) if frame is None else np.array(frame)) @ pose)[2, 3])


@partial(jax.jit, static_argnames=("halvings", "steps"))
def look_down(
    depth: Float[Any, "H W"],
    camera: Camera,
    to_camera: Float[Any, "4 4"],
    x: Float[Any, "C"],
    y: Float[Any, "R"],
    span: Float[Any, "2"],
    *,
    halvings: int = HALVINGS,
    steps: int = STEPS,
) -> Float[Array, "R C"]:
    """Heights below the nodes of a grid, from one look of a camera that stands anywhere.

    Along the vertical through a node a point is in front of what the camera saw until it reaches
    the surface, or the shadow of what hides it; below it stays behind, since a bed has no
    overhangs.  So halving finds the one change, and Newton's method its height.  Where the depths
    around it differ by more than a surface's would, it is the edge of what hides the node.

    Args:
      depth: metres along the camera's axis, NaN: no reading.
      camera: that took it; of any lens.
      to_camera: from the map's frame to the camera's.
      x: of the columns, metres.
      y: of the rows.
      span: least and greatest height that there can be, metres.

    Returns:
      Heights in metres, NaN where the node was not seen.
    """
    depth, flat = jnp.asarray(depth, jnp.float32), jnp.asarray(depth, jnp.float32).reshape(-1)
    height, width = depth.shape
    m = jnp.asarray(to_camera, jnp.float32)
    base = [m[k, 0] * x[None, :] + m[k, 1] * y[:, None] + m[k, 3] for k in range(3)]

    def seen_at(h):
        px, py, pz = (b + h * m[k, 2] for k, b in enumerate(base))
        u, v = camera.pixel(px, py, pz)
        return u, v, pz

    def inner(u, v, most):
        """Pixel numbers of what lies left of and above places."""
        return jnp.clip(u, 0, width - most), jnp.clip(v, 0, height - most)

    def nearest(h):
        u, v, z = seen_at(h)
        u, v = inner(jnp.round(u), jnp.round(v), 1)
        return flat[v.astype(jnp.int32) * width + u.astype(jnp.int32)] - z

    def corners(u, v):
        left, top = inner(jnp.floor(u), jnp.floor(v), 2)
        at = top.astype(jnp.int32) * width + left.astype(jnp.int32)
        right, down = jnp.clip(u - left, 0.0, 1.0), jnp.clip(v - top, 0.0, 1.0)
        return [flat[at + off] for off in (0, 1, width, width + 1)], right, down

    def newton(h):
        """The gap to the surface, by how much it grows with height, and the four pixels' depths."""
        u, v, z = seen_at(h)
        (a, b, c, d), right, down = corners(u, v)
        along = (1 - down) * (b - a) + down * (d - c)
        across = (1 - right) * (c - a) + right * (d - b)
        between = (1 - down) * (a + right * (b - a)) + down * (c + right * (d - c))
        further_u, further_v, _ = seen_at(h + STRIDE)
        slope = (along * (further_u - u) + across * (further_v - v)) / STRIDE - m[2, 2]
        return between - z, slope, (a, b, c, d)

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        behind = nearest(middle) <= 0  # NaN is not
        return jnp.where(behind, middle, low), jnp.where(behind, high, middle)

    def closer(_, h):
        gap, slope, _ = newton(h)
        # Where the surface lies along the look there is no telling: no step.
        step = gap / jnp.where(slope > LEAST_SLOPE, slope, jnp.inf)
        return jnp.clip(h - step, h - part, h + part)

    shape = (len(y), len(x))
    span = jnp.asarray(span, jnp.float32)
    part = (span[1] - span[0]) / 2.0**halvings
    ends = jnp.full(shape, span[0]), jnp.full(shape, span[1])
    low, high = lax.fori_loop(jnp.int32(0), jnp.int32(halvings), halve, ends)
    h = lax.fori_loop(jnp.int32(0), jnp.int32(steps), closer, 0.5 * (low + high))
    u, v, z = seen_at(h)
    gap, _, around = newton(h)
    least, most = _ends(around)
    inside = (jnp.abs(u - (width - 1) / 2) <= width / 2) & (
        jnp.abs(v - (height - 1) / 2) <= height / 2
    )
    seen = inside & (most - least <= STEEP / camera.scale(z)[0]) & (jnp.abs(gap) <= OFF)
    return jnp.where(seen, h, jnp.nan)


def _ends(values):
    least = most = values[0]
    for one in values[1:]:
        least, most = jnp.minimum(least, one), jnp.maximum(most, one)
    return least, most


def check_map(found: HeightMap, where: str = "height map") -> HeightMap:
    """The map itself, if it can be one (host).

    Raises:
      BadImage: no (R, C) array of numbers, a pitch that is none, or nothing seen.
    """
    heights = np.asarray(found.heights)
    if heights.ndim != 2 or min(heights.shape) < 2 or heights.dtype.kind != "f":
        raise BadImage(
            f"{where}: heights have shape {heights.shape} and type {heights.dtype}; expected (rows, "
            "columns) of metres as floats"
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
    if not found.mask.any():
        raise BadImage(f"{where}: no height is known")
    relief = float(np.ptp(heights[found.mask]))
    if relief > HIGHEST:
        raise BadImage(
            f"{where}: heights span {relief:g}; they are in metres, at most {HIGHEST:g} (in "
            f"millimetres it would be {relief / 1e3:g} m)"
        )
    return found


HIGHEST = 2.0
"""Metres of relief; more were millimetres."""
