"""The paper's distance between depth images (section III-B).

Images are float32 in [0, 1], indexed `[v, u]`.  `weigh` turns a luminance image L into I = R∘L;
every other function takes such I.  Distances are unitless in [0, 1] unless the name ends in `_mm`.
Every function takes NumPy or JAX arrays, works under `jit` and returns JAX arrays of float32.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from scipy.linalg.blas import sasum  # pyright: ignore[reportAttributeAccessIssue]

from jshape._typing import Array, ArrayLike, Bool, Float, Int
from jshape.camera import Camera, namespace, single, unmasked
from jshape.errors import BadImage

# Pixels compared at once: two inputs and a buffer of 60k floats are 720 kB, which stay in a core's
# second-level cache while each takes only a few of Python's steps.
_HOST_BLOCK = 60_000


def ray_lengths(camera: Camera) -> Float[Array, "H W"]:
    """R_uv: length of each pixel's ray per metre of depth; 1 on the axis.  Eq. distPix."""
    return jnp.asarray(_ray_lengths(camera))


def _ray_lengths(camera: Camera) -> Float[Any, "H W"]:
    return slant(camera, *camera.rays())


def slant(camera: Camera, x: Any, y: Any) -> Any:
    """Length of a ray through (x, y, 1) per metre of depth; parallel rays are as long as deep."""
    xp = namespace(camera, x, y)
    whole = xp.sqrt(1.0 + x**2 + y**2)
    return xp.ones_like(whole) if camera.orthographic else whole


def max_ray_length(camera: Camera) -> Float[Array, ""]:
    """R̄, the largest R_uv.  R is convex over the image, so a corner has it: 4 pixels, not H·W."""
    return jnp.asarray(_longest(camera))


def _longest(camera: Camera) -> Float[Any, ""]:
    u, v = (np.array([0.0, n - 1.0], np.float32) for n in (camera.width, camera.height))
    return namespace(camera).max(slant(camera, *camera.at(u[None, :], v[:, None], 1.0)))


def r_matrix(camera: Camera) -> Float[Array, "H W"]:
    """R, the weight of each luminance: R_uv / ((2^b - 1) R̄).  Eq. radMatrix."""
    return jnp.asarray(_r_matrix(camera))


def _r_matrix(camera: Camera) -> Float[Any, "H W"]:
    return _ray_lengths(camera) / (camera.top * _longest(camera))


def roi_weight(camera: Camera, corner: Int[Any, "2"], size: tuple[int, int]) -> Float[Array, "h w"]:
    """R_uv / R̄ of the ROI of `size` (w, h) whose first pixel is `corner` (u, v): R of L in [0, 1].

    I of a ROI divided by it is the share of the depth range above Zmax.  From the ROI's own rays,
    so nothing of image size is made.
    """
    corner = single(corner)
    u, v = (corner[k] + np.arange(size[k], dtype=np.float32) for k in (0, 1))
    x, y = camera.at(u[None, :], v[:, None], 1.0)
    return jnp.asarray(slant(camera, x, y) / _longest(camera))


def weigh(luminance: ArrayLike, camera: Camera) -> Float[Array, "*B H W"]:
    """I = R∘L in [0, 1] of luminance images (any leading batch axes).  Eq. newMat.

    NaN (no reading) stays NaN.

    Raises:
      BadImage: the last two axes are not the camera's (H, W).
    """
    if np.shape(luminance)[-2:] != camera.shape:
        raise BadImage(
            f"luminance has shape {np.shape(luminance)}; this camera makes {camera.shape} "
            "(rows, columns)"
        )
    return jnp.asarray(single(unmasked(luminance)) * _r_matrix(camera))


def unweigh(image: ArrayLike, camera: Camera) -> Float[Array, "*B H W"]:
    """L of weighed images I: the inverse of `weigh`, without rounding.

    Raises:
      BadImage: the last two axes are not the camera's (H, W).
    """
    if np.shape(image)[-2:] != camera.shape:
        raise BadImage(
            f"image has shape {np.shape(image)}; this camera makes {camera.shape} (rows, columns)"
        )
    return single(unmasked(image)) / r_matrix(camera)


def distance(
    a: ArrayLike, b: ArrayLike, seen: Bool[ArrayLike, "H W"] | None = None
) -> Float[Array, "*B"]:
    """Mean |a - b| over the last two axes, batched over the leading ones: d.  Eq. distNewImg.

    A metric on weighed images, in [0, 1].  The leading axes broadcast, so that many images can be
    compared with one goal.  Works under jit, vmap and grad.  Only pixels that were `seen` count.

    Raises:
      BadImage: fewer than two axes, images of different size or of complex numbers, leading axes
        that do not broadcast, or no pixel that was seen (under jit NaN).
    """
    a, b = unmasked(a), unmasked(b)
    shape_a, shape_b = np.shape(a), np.shape(b)
    try:
        np.broadcast_shapes(shape_a[:-2], shape_b[:-2])
    except ValueError:
        raise BadImage(
            f"distance of shapes {shape_a} and {shape_b}: the leading axes do not broadcast"
        ) from None
    if min(len(shape_a), len(shape_b)) < 2 or shape_a[-2:] != shape_b[-2:] or 0 in shape_a[-2:]:
        raise BadImage(
            f"distance of shapes {shape_a} and {shape_b}: the last two axes must be one (H, W)"
        )
    if np.iscomplexobj(a) or np.iscomplexobj(b):
        raise BadImage("distance of complex numbers: images are real")
    share = 1.0
    if seen is not None:  # what was not seen is the same in both, whatever it is
        to: Any = np if all(map(_in_memory, (a, b, seen))) else jnp
        seen = to.asarray(seen, bool)
        a, b = (to.where(seen, x, 0.0) for x in (a, b))
        share = to.mean(seen)
        if to is np and not share:
            raise BadImage("distance of images of which no pixel was seen")
    if _in_memory(a) and _in_memory(b):
        # At once: what JAX computes later, it would read from arrays that their owner may change.
        d = _distance_in_memory(np.asarray(a), np.asarray(b)) / np.float32(share)
        return jnp.asarray(d, jnp.float32)
    apart = jnp.abs(jnp.asarray(a, jnp.float32) - jnp.asarray(b, jnp.float32))
    return apart.mean((-2, -1)) / jnp.asarray(share, jnp.float32)


def _in_memory(x: ArrayLike) -> bool:
    """Whether an array's numbers are known and in this computer's memory."""
    if isinstance(x, Tracer):
        return False
    return not isinstance(x, jax.Array) or all(d.platform == "cpu" for d in x.devices())


def _distance_in_memory(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Block by block: half the time of a compiled kernel, which also copies NumPy arrays first."""
    size = a.shape[-2] * a.shape[-1]
    lead = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    a, b = (np.broadcast_to(x, lead + x.shape[-2:]) for x in (a, b))
    buffer = _aligned(min(_HOST_BLOCK, size))
    result = np.empty(lead, np.float32)
    for index in np.ndindex(lead):
        one, other = (np.ascontiguousarray(x[index], np.float32).reshape(-1) for x in (a, b))
        total = 0.0
        for start in range(0, size, _HOST_BLOCK):
            block = one[start : start + _HOST_BLOCK]
            change = buffer[: block.size]
            np.subtract(block, other[start : start + _HOST_BLOCK], out=change)
            total += float(sasum(change))
        result[index] = total / size
    return result


def _aligned(count: int) -> np.ndarray:
    """Float32 storage from a multiple of 64 bytes on.

    BLAS adds in an order that depends on where its input begins: the same two images would give
    distances that differ in the last digit.
    """
    raw = np.empty(count + 16, np.float32)
    start = -raw.ctypes.data % 64 // 4
    return raw[start : start + count]


def to_mm(d: ArrayLike, camera: Camera) -> Float[Array, "..."]:
    """The mean 3-D distance of matched points, in mm, of a distance d.  Eq. meanDist, distPix.

    Exact where no pixel is clipped: d * R̄ * (Zmax - Zmin), in mm.
    """
    span_mm = single(1e3 * (camera.z_max - camera.z_min))
    return jnp.asarray(single(d) * _longest(camera) * span_mm)
