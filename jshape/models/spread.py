"""How far off a prediction may be: the law of its 80 % interval, per pixel.

An action is predicted well where it leaves the bed alone and worst where it moves most: at walls
and rims, which come to lie a few millimetres elsewhere each time.  So half of the interval is

    mm + share * (the largest change that is predicted within 20 mm of the pixel)

with two numbers per action, which `learn.intervals` fits to held-out pairs.  In mm along the
pixel's ray, as errors are, so that they stay true below another camera.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.ndimage import maximum_filter1d

from jshape._typing import Array, ArrayLike, Float
from jshape.camera import Camera, namespace, single

COVERED = 0.8
"""Share of the pixels whose true value lies in the interval."""
PER_STD = 1.2815516
"""Half of the 80 % interval of a normal law, standard deviations."""
AROUND_MM = 20.0
"""How far away a predicted change tells of a pixel's error: as far as hands miss their place, and
walls give way."""
LEAST_MM = 0.1
"""Half of the narrowest interval: what counts of 16 bits and filled gaps leave uncertain."""
UNLIKELY = 4.5
"""A look whose `surprise` is larger is none that the bank's action could leave.  Banks of another
hand and material come to 3.3 at most (400 material-point pairs), a bed that is 10 mm lower to 4.9
at least."""


def radii_px(camera: Camera) -> tuple[int, int]:
    """`AROUND_MM` along u and v in pixels of a camera, in the middle of its range."""
    depth = (float(camera.z_min) + float(camera.z_max)) / 2
    u, v = (max(1, round(1e-3 * AROUND_MM * float(scale))) for scale in camera.scale(depth))
    return u, v


def around(change: Float[ArrayLike, "*B h w"], radii: tuple[int, int]) -> Float[Any, "*B h w"]:
    """The largest |change| in the window around each pixel, so many pixels (u, v) to each side.

    What lies beyond the array is not predicted to change; NaN (no reading) says nothing.  Numbers
    that are known take 2 ms here, and each new size of ROI a quarter of a second to compile.
    """
    xp = namespace(change)
    size = xp.nan_to_num(xp.abs(single(change)))
    for axis, radius in zip((-1, -2), radii, strict=True):
        if xp is np:
            size = maximum_filter1d(size, 2 * radius + 1, axis, mode="constant")
            continue
        window = [1] * size.ndim
        window[axis] = 2 * radius + 1
        zero = jnp.zeros((), size.dtype)
        size = lax.reduce_window(size, zero, lax.max, window, [1] * size.ndim, "SAME")
    return size


def half_width_mm(
    spread: Float[ArrayLike, "*A 2"], around_mm: Float[ArrayLike, "*B h w"]
) -> Float[Any, "... h w"]:
    """Half of the 80 % interval of each pixel, mm.

    Args:
      spread: (mm, share) of the action, as `Bank.intervals`; NaN is not known, and gives NaN.
      around_mm: the largest predicted change `around` each pixel, mm.  Its first axes
        are those of `spread`.
    """
    xp = namespace(spread, around_mm)
    nearby, law = xp.asarray(single(around_mm)), xp.asarray(single(spread))
    law = law.reshape(*law.shape[:-1], *[1] * (nearby.ndim - law.ndim), 2)
    return xp.maximum(law[..., :1] + law[..., 1:] * nearby, np.float32(LEAST_MM))


def surprise(
    error_mm: Float[ArrayLike, "*B h w"], half_mm: Float[ArrayLike, "*B h w"]
) -> Float[Array, "*B"]:
    """The mean of |error| / half width over an observed ROI: 0.6 is as expected.

    Over the pixels with a reading; NaN without one.

    Args:
      error_mm: seen minus predicted, mm; NaN where there is no reading.
      half_mm: half widths as `half_width_mm` gives them.
    """
    ratio = jnp.abs(jnp.asarray(error_mm, jnp.float32)) / jnp.asarray(half_mm, jnp.float32)
    return jnp.nanmean(ratio, axis=(-2, -1))
