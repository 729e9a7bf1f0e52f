"""What the predictors of each kind of bank are on disk: named arrays.

Parameters of networks are in the bank's one NPZ, with ΔI and B, not in Orbax's format: an Orbax
folder is a dozen files with names of its own, and hands a flipped bit on without noticing.  One
file with one checksum is checked before a byte of it is read.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jshape.camera import Camera
from jshape.errors import BadBank
from jshape.models.difference import Difference
from jshape.models.imprint import Imprint
from jshape.models.network import Network
from jshape.models.orthographic import OrthographicGrid
from jshape.models.refined import Refined
from jshape.models.sequential import Sequential

Arrays = Mapping[str, np.ndarray]
LARGEST_GRID = 4096
"""Most nodes of a ground's grid that are read, per side."""
_MAPS = ("reference", "tool", "give", "rest", "swell", "follow", "deep")
_NUMBERS = ("stroke",)
_HEAP_MAPS, _HEAP_NUMBERS = ("height", "rise", "flow"), ("share", "brought")
"""What an f_P with a heap holds too."""
_PATH = "path"
"""Length of an f_P's path, metres; not there for one without, as in banks of before paths."""
LONGEST_PATH = 10.0
"""Longest path of an action that is read, metres."""
WIDEST = 256
"""Largest width of a U-Net that is read: 0.5 billion parameters."""
_OF_NETWORKS = ("C", "CR", "DC", "DCR")
_INSTEAD = "instead"
"""The mean difference that a bank of networks holds for an action: it was better for it.  Never
named as in one of f_D, so that a manifest with another kind than the arrays' is refused."""


def pack(predictor: Any, kind: str) -> dict[str, np.ndarray]:
    """The arrays of a predictor in a bank of that kind, by name."""
    if isinstance(predictor, Difference):
        name = _INSTEAD if kind in _OF_NETWORKS else "delta"
        return {name: np.asarray(predictor.delta, np.float32)}
    if isinstance(predictor, Network):
        leaves, _ = jax.tree_util.tree_flatten_with_path(predictor.params)
        return {_network_name(path): np.asarray(leaf, np.float32) for path, leaf in leaves}
    if isinstance(predictor, Sequential):
        return pack(predictor.first, "D") | pack(predictor.second, kind)
    if isinstance(predictor, Refined):
        mask, offset = np.asarray(predictor.mask, np.uint8), np.asarray(predictor.offset)
        own = {"mask": mask, "offset": offset.astype(np.float32)}
        return pack(predictor.inside, kind) | pack(predictor.outside, "D") | own
    names = (*_MAPS, *_NUMBERS)
    if predictor.height is not None:
        names += (*_HEAP_MAPS, *_HEAP_NUMBERS)
    if predictor.path is not None:
        names += (_PATH,)
    ground = np.array([predictor.grid.depth, predictor.grid.pitch], np.float32)
    found = {name: np.asarray(getattr(predictor, name), np.float32) for name in names}
    return {"ground": ground, **found}


def unpack(kind: str, arrays: Arrays, roi: tuple[int, int], camera: Camera) -> Any:
    """The predictor of arrays by name, for ROIs of size (w, h) of a camera.

    Raises:
      KeyError: an array is missing.
      BadBank: one of another shape, or that is not finite.
    """
    if kind in _OF_NETWORKS and set(arrays) == {_INSTEAD}:
        arrays, kind = {"delta": arrays[_INSTEAD]}, "D"
    return KINDS[kind](arrays, roi, camera)


def checked(arrays: Arrays, name: str, shape: tuple[int, ...]) -> jax.Array:
    """A float32 array of that name and shape, all finite; else BadBank."""
    array = arrays[name]
    if array.shape != shape:
        raise BadBank(f"{name} has shape {array.shape}; expected {shape}")
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise BadBank(f"{name} holds NaN, infinity or something that is not a number")
    return jnp.asarray(array, jnp.float32)


def _difference(arrays: Arrays, roi: tuple[int, int], _: Camera) -> Difference:
    return Difference(checked(arrays, "delta", roi[::-1]))


def _network(arrays: Arrays, roi: tuple[int, int], _: Camera) -> Network:
    from jshape.models import unet

    output = arrays["network.output.kernel"]
    width = output.shape[-2] if output.ndim == 4 else 0
    if not 1 <= width <= WIDEST:
        raise BadBank(f"network.output.kernel has shape {output.shape}; expected (1, 1, width, 1)")
    leaves, structure = jax.tree_util.tree_flatten_with_path(unet.shapes(width))
    found = [checked(arrays, _network_name(path), leaf.shape) for path, leaf in leaves]
    return Network(jax.tree.unflatten(structure, found), roi)


def _network_name(path: tuple[Any, ...]) -> str:
    return ".".join(("network", *(str(entry.key) for entry in path)))


def _sequential(arrays: Arrays, roi: tuple[int, int], camera: Camera) -> Sequential:
    return Sequential(_difference(arrays, roi, camera), _network(arrays, roi, camera))


def _refined(
    inside: Callable[..., Any], arrays: Arrays, roi: tuple[int, int], camera: Camera
) -> Refined:
    found, mask = inside(arrays, roi, camera), checked(arrays, "mask", roi[::-1])
    if not np.isin(mask, (0, 1)).all():
        raise BadBank("mask holds something else than 0 and 1")
    outside, offset = _difference(arrays, roi, camera), checked(arrays, "offset", ())
    return Refined(found, outside, mask, offset)


def _imprint(arrays: Arrays, roi: tuple[int, int], camera: Camera) -> Imprint:
    depth, pitch = checked(arrays, "ground", (2,))
    shape = arrays[_MAPS[0]].shape
    if len(shape) != 2 or not 0 < max(shape) <= LARGEST_GRID or min(shape) == 0:
        raise BadBank(f"{_MAPS[0]} has shape {shape}; expected up to {LARGEST_GRID} a side")
    if not (depth > 0 and pitch > 0):
        raise BadBank(f"ground is at {depth} m with nodes {pitch} m apart; both must be positive")
    maps, numbers = _MAPS, _NUMBERS
    if _HEAP_MAPS[0] in arrays:
        maps, numbers = maps + _HEAP_MAPS, numbers + _HEAP_NUMBERS
    fitted = {name: checked(arrays, name, shape) for name in maps}
    fitted |= {name: checked(arrays, name, ()) for name in numbers}
    path = None
    if _PATH in arrays:
        path = round(float(checked(arrays, _PATH, ())), 6)
        if not 0 < path <= LONGEST_PATH:
            raise BadBank(f"{_PATH} is {path} m; expected above 0, up to {LONGEST_PATH} m")
    return Imprint(OrthographicGrid(camera, depth, pitch, shape, roi), path=path, **fitted)


KINDS: dict[str, Callable[[Arrays, tuple[int, int], Camera], Any]] = {
    "D": _difference,
    "C": _network,
    "CR": partial(_refined, _network),
    "DC": _sequential,
    "DCR": partial(_refined, _sequential),
    "P": _imprint,
}
"""What reads the arrays of each kind of bank.  Another kind is one more entry, and what it is in
`pack`."""
