"""The depth camera: luminance <-> depth, pixel <-> point (the paper's section II).

Arrays are `[v, u]` (row, column), 0-based, float32; a pixel given to or by a person is `(u, v)`.
The camera frame has X along the columns, Y along the rows and Z along the optical axis, metres.
A depth of 0, NaN or infinity means "no reading" and becomes a luminance of NaN, never a number.
"""

from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jshape._typing import Array, ArrayLike, Float
from jshape.errors import LENS_WAY, BadCamera, BadImage, quoted

STATIC = {"static": True}

Number = float | Array | np.ndarray
"""Of a camera: known, or traced."""

GEOMETRY = ("width", "height", "fx", "fy", "u0", "v0", "z_min", "z_max", "orthographic")
"""The fields of a camera that decide what its frames mean to a bank: neither bits nor pose."""

FARTHEST = 50.0
"""Depths beyond it are no bed's: they were meant in millimetres."""
LENS_OFF = 0.05
"""Pixels by which straightening a lens may be off at the image's edge."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Camera:
    """A depth camera: a pinhole, or parallel rays.  A pytree: sizes static, numbers traced."""

    width: int = field(metadata=STATIC)
    """Columns, pixels."""
    height: int = field(metadata=STATIC)
    """Rows, pixels."""
    fx: Number
    """Focal length along u, pixels."""
    fy: Number
    """Focal length along v, pixels."""
    u0: Number
    """Column of the principal point, pixels (may lie outside a cropped window)."""
    v0: Number
    """Row of the principal point, pixels."""
    z_min: Number
    """Depth that becomes white (2^bits - 1), metres."""
    z_max: Number
    """Depth that becomes black (0), metres."""
    bits: int = field(default=8, metadata=STATIC)
    """Bits of a luminance."""
    orthographic: bool = field(default=False, metadata=STATIC)
    """Whether rays are parallel, as in a map of heights: fx and fy are then pixels per metre."""
    lens: tuple[Any, ...] | None = None
    """k1, k2, p1, p2, k3, k4, k5, k6 of the rational Brown-Conrady model; None: straight rays."""
    pose: tuple[Any, ...] | None = None
    """(4, 4) from the camera's frame to one that several cameras share, such as the robot's base,
    metres; None: its own is that frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    @property
    def top(self) -> int:
        """The largest luminance, 2^b - 1."""
        return 2**self.bits - 1

    def depth(self, luminance: ArrayLike) -> Float[Array, "..."]:
        """Depth in metres of a luminance.  Eq. depth."""
        scale = single((self.z_min - self.z_max) / self.top)
        return jnp.asarray(scale * single(unmasked(luminance)) + single(self.z_max))

    def luminance(self, depth: ArrayLike, *, quantize: bool = True) -> Float[Array, "..."]:
        """Luminance of a depth in metres, clipped to [0, 2^b - 1].  Inverse of Eq. depth.

        Args:
          depth: any shape, metres; 0, NaN and infinity mean "no reading".
          quantize: round to whole levels as the paper's camera does; False keeps fractions.

        Returns:
          float32 of the same shape; NaN where there was no reading.
        """
        metres = single(unmasked(depth))
        xp = namespace(self, metres)
        level = self.top * (single(self.z_max) - metres) / single(self.z_max - self.z_min)
        level = xp.clip(level, 0.0, float(self.top))
        if quantize:
            level = xp.round(level)
        return jnp.asarray(xp.where(xp.isfinite(metres) & (metres > 0), level, np.nan), jnp.float32)

    def pixel(self, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
        """The pixel (u, v) that shows a point of the camera's frame, metres.  Eq. pinhole."""
        if not self.orthographic:
            x, y = x / z, y / z
            if self.lens is not None:
                x, y = _bent(x, y, self.lens)
        return single(self.fx) * x + single(self.u0), single(self.fy) * y + single(self.v0)

    def at(self, u: Any, v: Any, z: Any) -> tuple[Any, Any]:
        """The x and y, metres, of the point at depth z that pixel (u, v) shows.  Eq. camCoord."""
        x, y = (u - single(self.u0)) / single(self.fx), (v - single(self.v0)) / single(self.fy)
        if self.orthographic:
            return x, y
        if self.lens is not None:
            x, y = _straight(x, y, self.lens)
        return x * z, y * z

    def scale(self, z: Any) -> tuple[Any, Any]:
        """Pixels per metre along u and v at depth z."""
        away = 1.0 if self.orthographic else z
        return single(self.fx) / away, single(self.fy) / away

    def rays(self, z: Any = 1.0) -> tuple[Float[Any, "*H W"], Float[Any, "H *W"]]:
        """The x (1, W) and y (H, 1) of all pixels at depth z; (H, W) if z is, or the lens bends."""
        u, v = (np.arange(n, dtype=np.float32) for n in (self.width, self.height))
        return self.at(u[None, :], v[:, None], z)

    def lines(self, to: Any = None) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Where the ray of each pixel begins, and how far it goes per metre of depth: x, y and z.

        In the frame that the matrix `to` (at least (3, 4)) leads to; None is the camera's own.
        """
        (x, y), zero, one = self.rays(), np.float32(0.0), np.float32(1.0)
        begin, along = ((zero, zero, zero), (x, y, one))
        if self.orthographic:
            begin, along = ((x, y, zero), (zero, zero, one))
        if to is None:
            return begin, along
        turned = [
            tuple(sum(to[k, j] * a[j] for j in range(3)) for k in range(3)) for a in (begin, along)
        ]
        return tuple(b + to[k, 3] for k, b in enumerate(turned[0])), turned[1]

    def points(self, luminance: ArrayLike) -> Float[Array, "H W 3"]:
        """The visible point cloud of a luminance image, metres: the mapping m.  Eq. pinhole2."""
        if np.shape(luminance) != self.shape:
            raise BadImage(_wrong("luminance", luminance, f"{self.shape} (rows, columns)"))
        z = self.depth(luminance)
        return jnp.stack(jnp.broadcast_arrays(*self.rays(z), z), axis=-1)

    def project(self, points: ArrayLike, *, quantize: bool = True) -> Float[Array, "H W"]:
        """Luminance image (H, W) of a point cloud (P, 3) in metres: m inverse.  Eq. PtoI.

        The nearest point wins a pixel.  Pixels that no point reaches are 0 (black, as far as the
        camera sees); points behind the camera or outside the image are dropped.
        """
        if len(np.shape(points)) != 2 or np.shape(points)[1] != 3:
            raise BadImage(_wrong("a point cloud", points, "(P, 3)"))
        px, py, z = jnp.asarray(unmasked(points), jnp.float32).T
        ahead = jnp.isfinite(px) & jnp.isfinite(py) & jnp.isfinite(z) & (z > 0)
        safe_z = jnp.where(ahead, z, 1.0)
        u, v = self.pixel(jnp.where(ahead, px, 0.0), jnp.where(ahead, py, 0.0), safe_z)
        u, v = jnp.round(u), jnp.round(v)
        seen = ahead & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        # Scatter drops an index past the end, but wraps a negative one: send all unseen to row H.
        row = jnp.where(seen, v, self.height).astype(jnp.int32)
        level = jnp.nan_to_num(self.luminance(safe_z, quantize=quantize))
        image = jnp.zeros(self.shape, jnp.float32)
        return image.at[row, u.astype(jnp.int32)].max(level, mode="drop")

    def crop(self, left: int, top: int, width: int, height: int) -> "Camera":
        """The camera of a window of this one's image: the principal point moves with it.

        Raises:
          BadCamera: the window is empty or leaves the image.
        """
        inside = 0 <= left and 0 <= top and left + width <= self.width
        if not (inside and top + height <= self.height and width > 0 and height > 0):
            raise BadCamera(
                f"crop window left {left}, top {top}, {width}x{height} leaves the "
                f"{self.width}x{self.height} image"
            )
        return replace(self, width=width, height=height, u0=self.u0 - left, v0=self.v0 - top)


def _bent(x: Any, y: Any, lens: tuple[Any, ...]) -> tuple[Any, Any]:
    """Where a lens shows normalised coordinates: the model of OpenCV and of ROS's CameraInfo."""
    k1, k2, p1, p2, k3, k4, k5, k6 = lens
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = 2.0 * x * y
    return (
        x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x),
        y * radial + p2 * xy + p1 * (r2 + 2.0 * y * y),
    )


def _straight(x: Any, y: Any, lens: tuple[Any, ...]) -> tuple[Any, Any]:
    """The inverse of `_bent` by fixed-point steps; `check_camera` refuses what they cannot do."""
    straight = x, y
    for _ in range(20):
        bent = _bent(*straight, lens)
        straight = straight[0] + x - bent[0], straight[1] + y - bent[1]
    return straight


def matrix(pose: Any) -> Float[np.ndarray, "4 4"]:
    """A pose, or a map's frame, as an array (host); None is the identity."""
    return np.eye(4) if pose is None else np.array(pose)


def namespace(*trees: Any) -> ModuleType:
    """NumPy for numbers that are known, `jax.numpy` for those that are traced.

    What is computed once per plan or step takes NumPy milliseconds, and a compiler seconds.
    """
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))
    return jnp if traced else np


def single(value: Any) -> Any:
    """As float32, whatever JAX's default is: NumPy's float64 would promote what it meets."""
    return namespace(value).asarray(value, np.float32)


def in_memory(tree: Any) -> Any:
    """A pytree of numbers as float32 arrays of NumPy."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), tree)


def unmasked(values: ArrayLike) -> ArrayLike:
    """Values as they are, a NumPy masked array with NaN where it is masked.

    NumPy's and JAX's `asarray` drop the mask, and take what it hides for numbers.
    """
    if not isinstance(values, np.ma.MaskedArray):
        return values
    numbers = values.data.astype(np.promote_types(values.dtype, np.float32))
    return np.where(np.ma.getmaskarray(values), np.nan, numbers)


def _wrong(what: str, came: ArrayLike, expected: str) -> str:
    return f"{what} has shape {np.shape(came)}; expected {expected}"


def check_camera(camera: Camera, where: str = "camera") -> Camera:
    """The camera itself if its fields make sense (a host check, before any jit).

    Raises:
      BadCamera: a field that is not a finite number or out of its range, named with its value.
    """
    for name in ("width", "height", "bits"):
        value = getattr(camera, name)
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value <= 0:
            raise BadCamera(
                f"{where}: {name} is {quoted(value)}; it must be a positive whole number"
            )
    if camera.bits > 24:
        raise BadCamera(f"{where}: bits is {camera.bits}; float32 holds at most 24")
    for name in ("fx", "fy", "u0", "v0", "z_min", "z_max"):
        value = getattr(camera, name)
        try:
            finite = np.ndim(value) == 0 and np.isfinite(float(value))
        except (TypeError, ValueError):
            finite = False
        if not finite or isinstance(value, bool | str):
            raise BadCamera(f"{where}: {name} is {quoted(value)}; it must be a finite number")
        if name in ("fx", "fy", "z_min", "z_max") and not 1e-3 <= float(value) <= 1e6:
            raise BadCamera(
                f"{where}: {name} is {quoted(value)}; it must be positive, 0.001 to 1000000"
            )
        if name in ("z_min", "z_max") and float(value) > FARTHEST:
            raise BadCamera(
                f"{where}: {name} is {float(value):g}; it is in metres, at most {FARTHEST:g} (in "
                f"millimetres it would be {float(value) / 1e3:g} m)"
            )
        if name in ("u0", "v0") and abs(float(value)) > 1e6:
            raise BadCamera(f"{where}: {name} is {quoted(value)}; it must be within ±1000000")
    if float(camera.z_min) >= float(camera.z_max):
        raise BadCamera(
            f"{where}: z_min {camera.z_min} must be less than z_max {camera.z_max} (metres)"
        )
    if camera.lens is not None:
        _check_lens(camera, where)
    if camera.pose is not None:
        check_pose(camera.pose, where)
    return camera


def _check_lens(camera: Camera, where: str) -> None:
    try:
        lens = np.asarray(camera.lens, np.float64)
    except (TypeError, ValueError):
        lens = np.zeros(0)
    if lens.shape != (8,) or not np.isfinite(lens).all() or camera.orthographic:
        raise BadCamera(
            f"{where}: lens is {quoted(camera.lens)}; it must be 8 numbers (k1, k2, p1, p2, k3, "
            "k4, k5, k6) of a camera that is not orthographic"
        )
    # All around the image's edge: between there and the middle a lens bends less.
    ends = np.linspace(0.0, 1.0, 9)
    u = np.concatenate([ends, ends, 0 * ends, 0 * ends + 1]) * (camera.width - 1)
    v = np.concatenate([0 * ends, 0 * ends + 1, ends, ends]) * (camera.height - 1)
    with np.errstate(all="ignore"):
        back = camera.pixel(*camera.at(u, v, 1.0), 1.0)
        off = np.abs(np.subtract(back, [u, v])).max()
    if not off < LENS_OFF:
        raise BadCamera(
            f"{where}: lens is {quoted(camera.lens)}; no straight rays belong to the image's edge "
            f"(off by {off:.3g} pixels): are the coefficients in the order k1, k2, p1, p2, k3, k4, "
            "k5, k6?"
        )


def check_pose(pose: Any, where: str, name: str = "pose") -> None:
    """Refuse (BadCamera) what is no (4, 4) of a rotation and a translation in metres."""
    try:
        matrix = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    turn = matrix[:3, :3] if matrix.shape == (4, 4) else np.zeros((3, 3))
    rigid = np.isfinite(matrix).all() and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3
    rigid = rigid and np.linalg.det(turn) > 0 and np.allclose(matrix[3], (0, 0, 0, 1))
    if not rigid:
        raise BadCamera(
            f"{where}: {name} is {quoted(pose)}; it must be the 4x4 matrix of a rotation and a "
            "translation (metres), from its own frame to the common one"
        )
    if (far := float(np.abs(matrix[:3, 3]).max())) > FARTHEST:
        raise BadCamera(
            f"{where}: {name} moves by {far:g}; it is in metres, at most {FARTHEST:g} (in "
            f"millimetres it would be {far / 1e3:g} m)"
        )


def check_same_camera(ours: Camera, theirs: Camera, whose: str) -> None:
    """Refuse frames of another camera than a bank's (bits may differ, see `window_of`).

    Raises:
      BadCamera: naming the first field that differs.
    """
    for name in GEOMETRY:
        mine, other = float(getattr(ours, name)), float(getattr(theirs, name))
        if not np.isclose(mine, other, rtol=1e-4):
            raise BadCamera(
                f"the bank is for another camera: its {name} is {mine:g}, {whose} {other:g}"
            )


def differing(one: Camera, other: Camera, whose: str) -> str:
    """The fields in which a camera differs from another one, both numbers named."""
    numbers = [(n, float(getattr(one, n)), float(getattr(other, n))) for n in GEOMETRY]
    said = [f"{n} {a:g} ({whose}: {b:g})" for n, a, b in numbers if a != b]
    return ", ".join([*said, *([f"the lens ({LENS_WAY})"] if one.lens != other.lens else [])])


def window_of(inner: Camera, outer: Camera) -> tuple[int, int] | None:
    """(left, top) if `inner` is a crop of `outer` with the same optics and depth range, else None.

    Bits may differ: I = R∘L is normalised, so they do not matter to prediction.
    """
    same = inner.orthographic == outer.orthographic and inner.lens == outer.lens
    same = same and all(
        np.isclose(float(getattr(inner, n)), float(getattr(outer, n)), rtol=1e-4)
        for n in ("fx", "fy", "z_min", "z_max")
    )
    left = float(outer.u0) - float(inner.u0)
    top = float(outer.v0) - float(inner.v0)
    whole = abs(left - round(left)) < 0.01 and abs(top - round(top)) < 0.01
    left, top = round(left), round(top)
    fits = left >= 0 and top >= 0
    fits = fits and left + inner.width <= outer.width and top + inner.height <= outer.height
    return (left, top) if same and whole and fits else None


D435_NOMINAL = Camera(848, 480, 415.0, 373.0, 424.0, 240.0, 0.3, 3.0, bits=16)
"""Intel RealSense D435 with its nominal numbers and ideal range; R̄ = 1.568."""

D435_BAZAR = Camera(848, 480, 433.0, 433.0, 421.0, 243.0, 0.42, 0.47)
"""The paper's calibrated D435, looking at the bed from 0.45 m."""

PAPER_BOX = D435_BAZAR.crop(181, 46, 480, 395)
"""The window of `D435_BAZAR` that holds the paper's box."""

PRESETS = {"d435_nominal": D435_NOMINAL, "d435_bazar": D435_BAZAR, "paper_box": PAPER_BOX}
