"""A U-Net from one image to another, in Flax NNX.  Arrays are `(B, h, w, features)`."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jshape._typing import Array, Float
from jshape.models.convolution import conv3x3, conv3x3_upsampled, max_pool

LEVELS = 4
"""Poolings, so that the sides must be multiples of 16 inside."""


def _bias(layer: nnx.Conv) -> Array:
    assert layer.bias is not None  # every layer here has one
    return layer.bias[...]


class Block(nnx.Module):
    """Two 3x3 convolutions, each followed by ReLU."""

    def __init__(self, features_in: int, features: int, *, rngs: nnx.Rngs):
        self.first = nnx.Conv(features_in, features, (3, 3), rngs=rngs)
        self.second = nnx.Conv(features, features, (3, 3), rngs=rngs)

    def __call__(
        self, x: Float[Array, "B h w i"], below: Float[Array, "B h//2 w//2 j"] | None = None
    ) -> Float[Array, "B h w o"]:
        """Features, ReLU applied.

        Args:
          x: features of this level.
          below: of the level below, to be upsampled and stacked after `x`.  Their part of the
            kernel is applied to them before they are upsampled, so the stack is never made.
        """
        kernel = self.first.kernel[...]
        mixed = conv3x3(x, kernel[:, :, : x.shape[-1]])
        if below is not None:
            mixed += conv3x3_upsampled(below, kernel[:, :, x.shape[-1] :])
        x = nnx.relu(mixed + _bias(self.first))
        return nnx.relu(conv3x3(x, self.second.kernel[...]) + _bias(self.second))


class UNet(nnx.Module):
    """Section IV of the paper: width, 2, 4 and 8 times as many features down, 16 at the bottom."""

    def __init__(self, width: int, *, rngs: nnx.Rngs):
        sizes = [width * 2**level for level in range(LEVELS + 1)]
        self.down = nnx.List(
            Block(i, o, rngs=rngs) for i, o in zip([1, *sizes], sizes[:-1], strict=False)
        )
        self.bottom = Block(sizes[-2], sizes[-1], rngs=rngs)
        self.up = nnx.List(Block(3 * o, o, rngs=rngs) for o in reversed(sizes[:-1]))
        self.output = nnx.Conv(width, 1, (1, 1), rngs=rngs)

    def __call__(self, image: Float[Array, "*B h w"]) -> Float[Array, "*B h w"]:
        """Images in [-1, 1] of any size; inside, sides are padded to multiples of 16."""
        h, w = image.shape[-2:]
        x = image.reshape(-1, h, w)
        unit = 2**LEVELS
        x = jnp.pad(x, ((0, 0), (0, -h % unit), (0, -w % unit)), mode="edge")[..., None]
        skips = []
        for block in self.down:
            x = block(x)
            skips.append(x)
            x = max_pool(x)
        x = self.bottom(x)
        for block, skip in zip(self.up, reversed(skips), strict=True):
            x = block(skip, x)
        x = jnp.tanh(x @ self.output.kernel[0, 0, :, 0] + _bias(self.output)[0])
        return x[:, :h, :w].reshape(image.shape)


def init(key: Array, width: int) -> dict[str, Any]:
    """Parameters of a fresh U-Net, as nested dicts of arrays.

    Kernels are normal with variance 2 / fan-in, as the U-Net's authors advise (He), biases 0.  All
    are cut from one draw: Flax compiles one per shape, which took 20 s for 20 ms of work.
    """
    leaves, structure = jax.tree.flatten(shapes(width))
    ends = np.cumsum([leaf.size for leaf in leaves])
    draw = np.asarray(jax.random.normal(key, (int(ends[-1]),), jnp.float32))
    found = []
    for leaf, end in zip(leaves, ends, strict=True):
        scale = np.sqrt(2.0 / np.prod(leaf.shape[:-1])) if len(leaf.shape) > 1 else 0.0
        part = draw[end - leaf.size : end].reshape(leaf.shape)
        found.append(jnp.asarray(part * np.float32(scale), jnp.float32))
    return jax.tree.unflatten(structure, found)


@cache
def _definition(width: int) -> Any:
    """What a U-Net of this width is without its numbers: (graph, abstract parameters)."""
    return nnx.split(nnx.eval_shape(lambda: UNet(width, rngs=nnx.Rngs(0))), nnx.Param, ...)


def shapes(width: int) -> dict[str, Any]:
    """The parameters' shapes and types, nested as those of `init`."""
    return nnx.to_pure_dict(_definition(width)[1])


def apply(params: dict[str, Any], image: Float[Array, "*B h w"]) -> Float[Array, "*B h w"]:
    """The U-Net with these parameters."""
    graph, abstract, rest = _definition(params["output"]["kernel"].shape[-2])
    state = jax.tree.map(lambda x: x, abstract)
    nnx.replace_by_pure_dict(state, params)
    return nnx.merge(graph, state, rest)(image)
