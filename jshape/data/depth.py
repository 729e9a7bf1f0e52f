"""Raw depth: counts or metres in, metres out with NaN for "no reading", and can it be real."""

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.missing import missing
from jshape.errors import BadCamera, BadImage, quoted

_HEIGHT_HINT = "; a bed at another distance is seen from the right one with reproject (--reproject)"


def to_metres(raw: np.ndarray, depth_unit: float, where: str) -> Float[np.ndarray, "H W"]:
    """Depth in metres (NaN = no reading) of counts (uint16) or metres (floating point).

    Raises:
      BadImage: another type of number.
      BadCamera: the unit is not a positive number.
    """
    number = isinstance(depth_unit, int | float | np.number) and not isinstance(depth_unit, bool)
    if not number or not 0 < float(depth_unit) < np.inf:
        raise BadCamera(
            f"{where}: depth_unit is {quoted(depth_unit)}; it must be a positive number"
        )
    if raw.dtype == np.uint16:
        depth = raw.astype(np.float32) * np.float32(depth_unit)
    elif raw.dtype in (np.float16, np.float32, np.float64):
        with np.errstate(over="ignore"):
            depth = raw.astype(np.float32)
    else:
        raise BadImage(
            f"{where}: holds {raw.dtype}; raw depth is uint16 (counts) or floating point (metres)"
        )
    return np.where(missing(depth), np.float32(np.nan), depth)


def outside_range(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Where depths in metres lie beyond the camera's range, by more than rounding."""
    low, high = float(camera.z_min), float(camera.z_max)
    slack = 1e-4 * (high - low)
    return (depth < low - slack) | (depth > high + slack)


def check_depth(
    depth: np.ndarray,
    camera: Camera,
    where: str = "image",
    depth_unit: float | None = None,
    *,
    least_inside: float = 1e-3,
    hint: str | None = None,
) -> np.ndarray:
    """The depth image itself, if it can be one of this camera's.

    Args:
      depth: (H, W), metres; 0, NaN and infinity mean "no reading".
      camera: whose size and range it must have.
      where: what the image is called in errors.
      depth_unit: the metres per count that it was read with, for the hint in the error.
      least_inside: share of the readings that must lie in the camera's range.  The default asks
        for little, since a whole frame shows the surroundings too; a wrong unit still fails it.
      hint: how to mend it, for the end of the error; None guesses.

    Raises:
      BadImage: another shape, no reading, or too few readings inside the camera's range.
    """
    if depth.shape != camera.shape:
        raise BadImage(wrong_shape(where, depth.shape, camera))
    found = depth[~missing(depth)]
    if found.size == 0:
        raise BadImage(f"{where}: no pixel has a reading")
    low, high = float(camera.z_min), float(camera.z_max)
    inside = 1.0 - float(np.mean(outside_range(found, camera)))
    if inside < least_inside:
        if hint is None:
            hint = _unit_hint(float(np.median(found)), low, high, depth_unit) or _HEIGHT_HINT
        raise BadImage(
            f"{where}: depths are {found.min():.4g} to {found.max():.4g} m; the camera sees "
            f"{low:g} to {high:g} m, and {inside:.1%} of the readings are in it{hint}"
        )
    return depth


def wrong_shape(where: str, shape: tuple[int, ...], camera: Camera) -> str:
    """The sentence for an image of another size."""
    size = f"{shape[1]}x{shape[0]} pixels" if len(shape) == 2 else f"shape {shape}"
    return f"{where}: has {size}; the camera makes {camera.width}x{camera.height}"


def _unit_hint(median: float, low: float, high: float, depth_unit: float | None) -> str:
    """What the unit may have been, if a power of ten brings the median into the range."""
    for power in (-3, 3, -1, 1, -2, 2, -4, 4):
        factor = 10.0**power
        if low <= median * factor <= high:
            if depth_unit is not None:
                return (
                    f"; depth_unit {depth_unit * factor:g} instead of {depth_unit:g} would fit it"
                )
            unit = {-3: " (are they millimetres?)"}.get(power, "")
            return f"; {factor:g} times those numbers would fit it{unit}"
    return ""
