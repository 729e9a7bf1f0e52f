"""A U-Net from one image to another, in Flax NNX.  Arrays are `(B, h, w, features)`."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jshape._typing import Array, Float
from jshape.models.convolution import Conv3x3, UpConv3x3, max_pool

LEVELS = 4
"""Poolings, so that the sides must be multiples of 16 inside."""


class Block(nnx.Module):
    """Two 3x3 convolutions, each followed by ReLU."""

    def __init__(self, first: Conv3x3, *, rngs: nnx.Rngs):
        features = first.out_features
        self.first = first
        self.second = Conv3x3(features, features, rngs=rngs)

    def __call__(self, *inputs: Float[Array, "B _ _ _"]) -> Float[Array, "B h w o"]:
        """Features of what the first layer takes, ReLU applied."""
        return nnx.relu(self.second(nnx.relu(self.first(*inputs))))


class UNet(nnx.Module):
    """Section IV of the paper: width, 2, 4 and 8 times as many features down, 16 at the bottom."""

    def __init__(self, width: int, *, rngs: nnx.Rngs):
        sizes = [width * 2**level for level in range(LEVELS + 1)]
        self.down = nnx.List(
            Block(Conv3x3(i, o, rngs=rngs), rngs=rngs)
            for i, o in zip([1, *sizes[:-2]], sizes[:-1], strict=True)
        )
        self.bottom = Block(Conv3x3(*sizes[-2:], rngs=rngs), rngs=rngs)
        self.up = nnx.List(
            Block(UpConv3x3(o, 2 * o, o, rngs=rngs), rngs=rngs) for o in reversed(sizes[:-1])
        )
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
        return jnp.tanh(self.output(x))[:, :h, :w, 0].reshape(image.shape)


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
