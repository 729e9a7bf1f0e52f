"""Raw depth: counts or metres in, metres out with NaN for "no reading", and can it be real."""

from collections import Counter
from typing import Any

import numpy as np

from jshape._typing import ArrayLike, Float
from jshape.camera import Camera
from jshape.data.intrinsics import REACH
from jshape.data.missing import missing, readings
from jshape.errors import BadCamera, BadImage, JShapeError, one_line, quoted

_HEIGHT_HINT = "; say which camera took it (camera=, --camera-file), and it is seen from above"

MANY = 20_000
"""Pixels that tell a unit as well as all do, in a tenth of the time."""


def to_metres(
    raw: ArrayLike, depth_unit: float, where: str, left_out: Counter[str] | None = None
) -> Float[np.ndarray, "... H W"]:
    """Depth in metres (NaN = no reading) of counts (uint16) or metres (floating point).

    A NumPy mask is honoured; `left_out` adds up why pixels are no readings, see
    `data.missing.readings`.

    Raises:
      BadImage: another type of number, or rows of different lengths.
      BadCamera: the unit is not a positive number.
    """
    check_depth_unit(depth_unit, where)
    try:
        raw = np.ma.asarray(raw) if np.ma.isMaskedArray(raw) else np.asarray(raw)
    except ValueError as problem:  # rows of different lengths
        raise BadImage(f"{where}: is no array of numbers: {one_line(problem, 100)}") from None
    if raw.dtype == object and raw.ndim == 0:
        raise BadImage(f"{where}: is {one_line(raw.item(), 40)}; was the file read?")
    if raw.dtype.kind != "f" and raw.dtype.newbyteorder("=") != np.uint16:
        raise BadImage(
            f"{where}: holds {raw.dtype}; raw depth is uint16 (counts: .astype(np.uint16)) or "
            "floating point (metres)"
        )
    found = readings(raw)
    if left_out is not None:
        left_out.update(found.left_out)
    with np.errstate(over="ignore"):
        depth = np.ma.getdata(raw).astype(np.float32)
    if raw.dtype.kind == "u":
        depth *= np.float32(depth_unit)
    return np.where(found.there, depth, np.float32(np.nan))


def check_depth_unit(value: Any, where: str) -> float:
    """The depth unit (metres per count) itself, if it is a positive number; else BadCamera."""
    number = value.item() if isinstance(value, np.number) else value
    if type(number) not in (int, float) or not 0 < number < 1e300:
        raise BadCamera(
            f"{where}: depth_unit is {quoted(value)}; it must be a positive number (metres per "
            "count)"
        )
    return float(number)


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
      depth_unit: metres per count that it was read with, for the hint in the error.
      least_inside: least share of the readings in the camera's range.  Little by default: a whole
        frame shows the surroundings too, and a wrong unit still fails it.
      hint: how to mend it, for the end of the error, if no other unit would; None guesses.

    Raises:
      BadImage: another shape, no reading, or too few readings inside the camera's range.
    """
    check_shape(depth, camera, where)
    found = depth[~missing(depth)]
    if found.size == 0:
        raise BadImage(f"{where}: no pixel has a reading")
    low, high = float(camera.z_min), float(camera.z_max)
    inside = 1.0 - float(np.mean(outside_range(found, camera)))
    if inside < least_inside:
        unit = _unit_hint(float(np.median(found)), low, high, depth_unit)
        hint = unit or (_HEIGHT_HINT if hint is None else hint)
        raise BadImage(
            f"{where}: depths are {found.min():.4g} to {found.max():.4g} m; the camera sees "
            f"{low:g} to {high:g} m, and {inside:.1%} of the readings are in it{hint}"
        )
    return depth


def check_unit(
    depth: np.ndarray, camera: Camera, where: str, depth_unit: float | None = None
) -> np.ndarray:
    """The depth image itself, unless its unit is surely wrong; much of it may be out of range.

    Refused is a median reading beyond 3 times the camera's range (a factor of ten is 3.2 each
    way) that a power of ten brings into the range, or within half of it beside.

    Raises BadImage: with the unit that would fit.
    """
    step = max(1, int((depth.size / MANY) ** 0.5))
    some = depth[::step, ::step]
    some = some[~missing(some)]
    median = float(np.median(some)) if some.size else float(camera.z_min)
    low, high = float(camera.z_min), float(camera.z_max)
    hint = _unit_hint(median, low / 1.5, 1.5 * high, depth_unit)
    if hint and not low / 3 <= median <= 3 * high:
        found = depth[~missing(depth)]
        raise BadImage(
            f"{where}: depths are {found.min():.4g} to {found.max():.4g} m, half of them beyond "
            f"{median:.4g}; the camera sees {low:g} to {high:g} m{hint}"
        )
    return depth


def check_numbers(raw: np.ndarray, unit: float, camera: Camera, where: str) -> bool:
    """Refuse the numbers of a frame that make sense in another unit than they are taken for.

    The unit is not always the one that a format promises: some write millimetres where metres are
    due, all of which lie beyond what counts hold.

    A thousandth of the readings (`raw` times `unit` metres) must reach the camera's range if their
    median would lie in it in another unit.  False: there is no reading to tell by.

    Raises BadImage: so it is, or the median is out of `REACH`.
    """
    depth = np.ma.getdata(raw)[readings(raw).there].astype(np.float64) * unit
    if not depth.size:
        return False
    low, high = float(camera.z_min), float(camera.z_max)
    median = float(np.median(depth))
    if np.mean((depth >= low) & (depth <= high)) >= 1e-3:
        return True
    factor = _factor(median, low, high)
    if factor is None and REACH[0] <= median <= REACH[1]:
        return True  # a camera at another height
    factor = factor or _factor(median, *REACH)
    what = "metres" if unit == 1 else f"counts of {unit:g} m"
    fits = f"{unit * (factor or 1):g}"
    hint = f"; {fits} would fit: --depth-unit {fits} says so" if factor else ""
    raise BadImage(
        f"{where}: values around {median / unit:g} are not {what}, seen from {low:g} to {high:g} m"
        f"{hint}; --depth-range NEAR,FAR if the bed is elsewhere"
    )


def unit_that_fits(counts: np.ndarray, camera: Camera) -> str:
    """The power of ten that brings counts into a camera's range, as the end of an error."""
    found = counts[counts > 0].astype(np.float64)
    low, high = float(camera.z_min), float(camera.z_max)
    factor = _factor(float(np.median(found)), low, high) if found.size else None
    if factor is None:
        return ""
    near, far = factor * np.percentile(found, (2, 98))
    return (
        f"; {factor:g} would fit: the frames then lie at {near:.3g} to {far:.3g} m, within the "
        f"camera's {low:g} to {high:g}"
    )


def check_shape(
    image: np.ndarray, camera: Camera, where: str, error: type[JShapeError] = BadImage
) -> None:
    """Refuse an image of another size than the camera makes; raises as `error`."""
    if image.shape != camera.shape:
        plain = image.ndim == 2
        size = "{1}x{0} pixels".format(*image.shape) if plain else f"shape {image.shape}"
        raise error(f"{where}: has {size}; the camera makes {camera.width}x{camera.height}")


def _factor(median: float, low: float, high: float) -> float | None:
    """The power of ten that brings the median into the range, the likeliest first."""
    for power in (-3, 3, -1, 1, -2, 2, -4, 4, -5, 5):
        if low <= median * 10.0**power <= high:
            return 10.0**power
    return None


def _unit_hint(median: float, low: float, high: float, depth_unit: float | None) -> str:
    """What the unit may have been, if a power of ten brings the median into the range."""
    factor = _factor(median, low, high)
    if factor is None:
        return ""
    if depth_unit is not None:
        return f"; depth_unit {depth_unit * factor:g} instead of {depth_unit:g} would fit it"
    unit = "are they millimetres? " * (factor == 1e-3)
    return (
        f"; {factor:g} times those numbers would fit it ({unit}floating point is read as metres, "
        "whatever depth_unit says)"
    )
