"""The paper's U-Net as its text reads, in plain `lax` calls: what `jshape.models` must equal."""

import jax
import jax.numpy as jnp
from jax import lax, nn


def convolution(layer, x):
    """3x3 with zeros around, or 1x1."""
    out = lax.conv_general_dilated(
        x, layer["kernel"], (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"),
        precision=lax.Precision.HIGHEST,
    )  # fmt: skip
    return out + jnp.reshape(layer["bias"], (1, 1, 1, -1))


def _block(layers, x):
    return nn.relu(convolution(layers["second"], nn.relu(convolution(layers["first"], x))))


@jax.jit
def apply(params, image):
    """(B, h, w) -> (B, h, w); sides padded to multiples of 16 with their edge, and cropped back."""
    h, w = image.shape[1:]
    x = jnp.pad(image, ((0, 0), (0, -h % 16), (0, -w % 16)), mode="edge")[..., None]
    skips = []
    for level in range(4):
        x = _block(params["down"][level], x)
        skips.append(x)
        x = lax.reduce_window(x, -jnp.inf, lax.max, (1, 2, 2, 1), (1, 2, 2, 1), "VALID")
    x = _block(params["bottom"], x)
    for level in range(4):
        x = jnp.repeat(jnp.repeat(x, 2, 1), 2, 2)
        x = _block(params["up"][level], jnp.concatenate([skips.pop(), x], -1))
    return jnp.tanh(convolution(params["output"], x))[:, :h, :w, 0]
