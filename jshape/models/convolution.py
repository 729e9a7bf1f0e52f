"""Layers of 3x3 convolutions, in the forms that a CPU runs fastest.

Arrays are `(B, h, w, features)`.

XLA leaves a convolution on a CPU to Eigen, at about 60 % of oneDNN's speed, and none of its options
changed that.  So the forms here save work: the same sums in another order, equal to `nnx.Conv` to
rounding.  Against it the U-Net trains 1.6 to 2.6 times as fast and predicts 1.3 to 2.8 times.
"""

import jax
import jax.numpy as jnp
from flax import nnx
from jax import lax

from jshape._typing import Array, Float

_FEW = 256
"""Pixels (over the batch) up to which a convolution is one matrix product: with as few, reading the
kernel takes longest, and Eigen's convolution does that up to a third slower."""
_BLOCK = 2048
"""Pixels whose products a kernel's slope adds up at a time, or those of one image: they stay in
the cache."""


class Conv3x3(nnx.Conv):
    """`nnx.Conv` of 3x3, with zeros around the image."""

    bias: nnx.Param

    def __init__(self, features_in: int, features: int, *, rngs: nnx.Rngs):
        super().__init__(features_in, features, (3, 3), rngs=rngs)

    def __call__(self, inputs: Float[Array, "B h w i"]) -> Float[Array, "B h w o"]:
        """The layer, its kernel and bias applied."""
        return conv3x3(inputs, self.kernel[...]) + self.bias[None, None, None]


class UpConv3x3(Conv3x3):
    """The same of two images stacked, the second with every pixel repeated in both directions."""

    def __init__(self, features_in: int, features_below: int, features: int, *, rngs: nnx.Rngs):
        super().__init__(features_in + features_below, features, rngs=rngs)

    def __call__(
        self, inputs: Float[Array, "B h w i"], below: Float[Array, "B h//2 w//2 j"]
    ) -> Float[Array, "B h w o"]:
        """Their parts of the kernel are applied apart, so that the stack is never made."""
        kernel, split = self.kernel[...], inputs.shape[-1]
        found = conv3x3(inputs, kernel[:, :, :split])
        return found + conv3x3_upsampled(below, kernel[:, :, split:]) + self.bias[None, None, None]


def conv3x3(x: Float[Array, "B h w i"], kernel: Float[Array, "3 3 i o"]) -> Float[Array, "B h w o"]:
    """The convolution with zeros around the image."""
    b, h, w, features = x.shape
    if b * h * w > _FEW:
        return _convolved(x, kernel)
    around = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    taps = [around[:, dy : dy + h, dx : dx + w] for dy in range(3) for dx in range(3)]
    columns = jnp.concatenate(taps, -1).reshape(b * h * w, 9 * features)
    return (columns @ kernel.reshape(9 * features, -1)).reshape(b, h, w, -1)


@jax.custom_vjp
def _convolved(x: Array, kernel: Array) -> Array:
    return lax.conv_general_dilated(
        x, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC")
    )


def _forward(x: Array, kernel: Array) -> tuple[Array, tuple[Array, Array]]:
    return _convolved(x, kernel), (x, kernel)


def _backward(kept: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    x, kernel = kept
    turned = kernel[::-1, ::-1].swapaxes(2, 3)
    return _convolved(slope, turned), _kernel_slope(x, slope)


_convolved.defvjp(_forward, _backward)


def _kernel_slope(
    x: Float[Array, "B h w i"], slope: Float[Array, "B h w o"]
) -> Float[Array, "3 3 i o"]:
    """The slope of a loss by the kernel, from its slope by the convolution's output.

    A tap's slope is the sum over pixels of x, shifted by the tap, times the output's slope.  With
    `x` shifted sideways and `slope` up and down, three of each, one product of matrices holds all
    nine.  XLA, which makes a convolution of it whose kernel is as large as the image, takes 1.3 to
    2.4 times as long on batches of 8 images of the U-Net's sizes and widths.
    """
    b, h, w, features = x.shape
    together = next(n for n in range(max(1, min(b, _BLOCK // (h * w))), 0, -1) if b % n == 0)

    def add(total: Array, some: tuple[Array, Array]) -> tuple[Array, None]:
        beside = jnp.pad(some[0], ((0, 0), (0, 0), (1, 1), (0, 0)))
        above = jnp.pad(some[1], ((0, 0), (1, 1), (0, 0), (0, 0)))
        left = jnp.concatenate([beside[:, :, dx : dx + w] for dx in range(3)], -1)
        right = jnp.concatenate([above[:, 2 - dy : 2 - dy + h] for dy in range(3)], -1)
        pixels = together * h * w
        return total + left.reshape(pixels, -1).T @ right.reshape(pixels, -1), None

    images, slopes = (y.reshape(-1, together, h, w, y.shape[-1]) for y in (x, slope))
    zeros = jnp.zeros((3 * features, 3 * slope.shape[-1]), x.dtype)
    total, _ = lax.scan(add, zeros, (images, slopes))
    return total.reshape(3, features, 3, -1).transpose(2, 0, 1, 3)


def conv3x3_upsampled(
    x: Float[Array, "B h w i"], kernel: Float[Array, "3 3 i o"]
) -> Float[Array, "B 2*h 2*w o"]:
    """`conv3x3` of `x` with every pixel repeated in both directions.

    Each tap's product is the same for the four pixels that repeat one, so it is made once per
    pixel of `x` and then added where it belongs: a quarter of the products.
    """
    b, h, w, features = x.shape
    flat = x.reshape(b * h * w, features)
    taps = [[(flat @ kernel[dy, dx]).reshape(b, h, w, -1) for dx in range(3)] for dy in range(3)]
    left, right = zip(*(_repeated(*row, axis=2) for row in taps), strict=True)
    upper_left, lower_left = _repeated(*left, axis=1)
    upper_right, lower_right = _repeated(*right, axis=1)
    upper = jnp.stack([upper_left, upper_right], 3).reshape(b, h, 2 * w, -1)
    lower = jnp.stack([lower_left, lower_right], 3).reshape(b, h, 2 * w, -1)
    return jnp.stack([upper, lower], 2).reshape(b, 2 * h, 2 * w, -1)


def _repeated(one: Array, two: Array, three: Array, axis: int) -> tuple[Array, Array]:
    """Sums of three taps' products at the first and the second of each repeated pixel.

    The first sees the pixel before, and its own twice; the second its own twice, and the one after.
    """
    zeros = [(0, 0)] * one.ndim
    zeros[axis] = (1, 1)
    count = one.shape[axis]
    before = lax.slice_in_dim(jnp.pad(one, zeros), 0, count, axis=axis)
    after = lax.slice_in_dim(jnp.pad(three, zeros), 2, count + 2, axis=axis)
    return before + two + three, one + two + after


def max_pool(x: Float[Array, "B h w i"]) -> Float[Array, "B h//2 w//2 i"]:
    """The largest of each 2x2 pixels; sides are even."""
    b, h, w, features = x.shape
    return x.reshape(b, h // 2, 2, w // 2, 2, features).max((2, 4))
