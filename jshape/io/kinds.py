"""What the predictors of each kind of bank are on disk: named arrays.

Parameters of networks are in the bank's one NPZ, with ΔI and B, not in Orbax's format: an Orbax
folder is a dozen files with names of its own, and hands a flipped bit on without noticing.  One
file with one checksum is checked before a byte of it is read.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

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


class Kind(NamedTuple):
    """How the predictors of one kind become arrays and come back."""

    pack: Callable[[Any], dict[str, np.ndarray]]
    """Predictor -> its arrays by name."""
    unpack: Callable[[Arrays, tuple[int, int], Camera], Any]
    """Arrays by name, ROI size (w, h) and camera -> predictor.  A missing array is a KeyError."""


def checked(arrays: Arrays, name: str, shape: tuple[int, ...]) -> jax.Array:
    """A float32 array of that name and shape, all finite.

    Raises:
      BadBank: it is not.
    """
    array = arrays[name]
    if array.shape != shape:
        raise BadBank(f"{name} has shape {array.shape}; expected {shape}")
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise BadBank(f"{name} holds NaN, infinity or something that is not a number")
    return jnp.asarray(array, jnp.float32)


def _pack_difference(predictor: Any) -> dict[str, np.ndarray]:
    return {"delta": np.asarray(predictor.delta, np.float32)}


def _difference(arrays: Arrays, roi: tuple[int, int], _: Any = None) -> Difference:
    return Difference(checked(arrays, "delta", roi[::-1]))


def _pack_network(predictor: Any) -> dict[str, np.ndarray]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(predictor.params)
    return {_network_name(path): np.asarray(leaf, np.float32) for path, leaf in leaves}


def _network(arrays: Arrays, roi: tuple[int, int], _: Any = None) -> Network:
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


def _pack_sequential(predictor: Any) -> dict[str, np.ndarray]:
    return _pack_difference(predictor.first) | _pack_network(predictor.second)


def _sequential(arrays: Arrays, roi: tuple[int, int], _: Any = None) -> Sequential:
    return Sequential(_difference(arrays, roi), _network(arrays, roi))


def _pack_refined(predictor: Any) -> dict[str, np.ndarray]:
    inside = predictor.inside
    network = inside.second if isinstance(inside, Sequential) else inside
    own = {
        "mask": np.asarray(predictor.mask, np.uint8),
        "offset": np.asarray(predictor.offset, np.float32),
    }
    return _pack_difference(predictor.outside) | own | _pack_network(network)


def _refined(inside: Callable[..., Any]) -> Callable[..., Refined]:
    def unpack(arrays: Arrays, roi: tuple[int, int], _: Any = None) -> Refined:
        found = inside(arrays, roi)
        mask = checked(arrays, "mask", roi[::-1])
        if not np.isin(mask, (0, 1)).all():
            raise BadBank("mask holds something else than 0 and 1")
        offset = checked(arrays, "offset", ())
        return Refined(found, _difference(arrays, roi), mask, offset)

    return unpack


def _pack_imprint(predictor: Any) -> dict[str, np.ndarray]:
    ground = np.array([predictor.grid.depth, predictor.grid.pitch], np.float32)
    names = (*_MAPS, *_NUMBERS)
    if predictor.height is not None:
        names += (*_HEAP_MAPS, *_HEAP_NUMBERS)
    fitted = {name: np.asarray(getattr(predictor, name), np.float32) for name in names}
    path = {} if predictor.path is None else {_PATH: np.asarray(predictor.path, np.float32)}
    return {"ground": ground, **fitted, **path}


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


_INSTEAD = "instead"
"""The mean difference that a bank of networks holds for an action: never named as in one of f_D, so
that a manifest with another kind than the arrays' is refused."""


def _or_difference(pack: Callable[..., Any], unpack: Callable[..., Any]) -> Kind:
    """A kind of which some actions hold the mean difference: it was better for them."""

    def pack_either(one: Any) -> dict[str, np.ndarray]:
        return {_INSTEAD: np.asarray(one.delta)} if isinstance(one, Difference) else pack(one)

    def unpack_either(arrays: Arrays, roi: tuple[int, int], camera: Camera) -> Any:
        if set(arrays) == {_INSTEAD}:
            return Difference(checked(arrays, _INSTEAD, roi[::-1]))
        return unpack(arrays, roi)

    return Kind(pack_either, unpack_either)


KINDS: dict[str, Kind] = {
    "D": Kind(_pack_difference, _difference),
    "C": _or_difference(_pack_network, _network),
    "CR": _or_difference(_pack_refined, _refined(_network)),
    "DC": _or_difference(_pack_sequential, _sequential),
    "DCR": _or_difference(_pack_refined, _refined(_sequential)),
    "P": Kind(_pack_imprint, _imprint),
}
"""The kinds of bank that can be saved and loaded.  Another kind is one more entry."""
