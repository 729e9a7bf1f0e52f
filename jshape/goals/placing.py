"""Reliefs laid on a bed: where, how large, how turned."""

import cv2
import numpy as np
from scipy import ndimage

from jshape._typing import Float
from jshape.errors import BadImage, BadPosition
from jshape.goals.bedmap import BedMap, Pixel
from jshape.goals.reliefs import Relief


def placed(
    relief: Relief, bed: BedMap, at: Pixel | None = None, turn: float = 0.0
) -> Float[np.ndarray, "Y X"]:
    """The change of a bed's height that a relief asks for, metres.

    Args:
      relief: in its size.
      bed: seen from above.
      at: pixel (u, v) of its middle in the frame; None is the middle of the view.
      turn: from u towards v (clockwise, as the camera sees it), radians.

    Raises:
      BadPosition: the place is outside the view, or part of the relief would be.
    """
    largest = largest_size(relief, bed, at, turn)
    if max(relief.size) > largest * (1 + 1e-6):
        w, h = (1e3 * side for side in relief.size)
        low, high = bed.view()
        view = " x ".join(f"{1e3 * side:.0f}" for side in high - low)
        raise BadPosition(
            f"{relief.name} is {w:.0f} x {h:.0f} mm and leaves the view of {view} mm there; "
            f"--size-mm {np.floor(1e3 * largest):.0f} is the largest that fits"
        )
    a, b = _along(bed, at, turn)
    (w, h), heights = relief.size, relief.heights
    known = np.isfinite(heights).astype(np.float32)
    heights = np.nan_to_num(heights)
    rows, columns = heights.shape
    shrunk = max(round(w / bed.cell), 2), max(round(h / bed.cell), 2)
    if shrunk[0] < columns and shrunk[1] < rows:  # each cell of the bed takes the mean of many
        known, heights = (
            cv2.resize(k, shrunk, interpolation=cv2.INTER_AREA) for k in (known, heights)
        )
        columns, rows = shrunk
    where = [(b / h + 0.5) * rows - 0.5, (a / w + 0.5) * columns - 0.5]
    inside = (np.abs(a) <= w / 2) & (np.abs(b) <= h / 2)
    share = ndimage.map_coordinates(known, where, order=1, mode="nearest") * inside
    height = ndimage.map_coordinates(heights, where, order=1, mode="nearest")
    # `heights` is 0 where nothing is known: the mean over what is known needs the share of it.
    return np.where(share > 0.5, height / np.maximum(share, 0.5), 0.0).astype(np.float32)


def largest_size(relief: Relief, bed: BedMap, at: Pixel | None = None, turn: float = 0.0) -> float:
    """Longest side with which a relief stays in the camera's view, metres.

    Raises:
      BadPosition: the place is outside the view.
    """
    at = at or bed.middle()
    middle, (low, high) = np.array(bed.point(at)), bed.view()
    if not ((low < middle) & (middle < high)).all():
        (u, v), camera = bed.corner, bed.camera
        raise BadPosition(
            f"the place ({at[0]:g}, {at[1]:g}) is outside the view: u {u} to "
            f"{u + camera.width - 1}, v {v} to {v + camera.height - 1}"
        )
    half = np.array(relief.size) / max(relief.size) / 2
    cos, sin = abs(np.cos(turn)), abs(np.sin(turn))
    reach = np.array([cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]])
    return float((np.minimum(middle - low, high - middle) / reach).min())


def drawn_on_image(
    image: Float[np.ndarray, "H W"], bed: BedMap, name: str = "drawing"
) -> Float[np.ndarray, "Y X"]:
    """A change (metres, up; NaN: none) drawn pixel by pixel on the frame, on the bed's map.

    Raises:
      BadImage: another size than the frame's.
    """
    if image.shape != bed.frame.shape:
        rows, columns = bed.frame.shape
        raise BadImage(
            f"{name}: has {image.shape[1]}x{image.shape[0]} pixels and the bed {columns}x{rows}; "
            "say how large it is on the bed with --size-mm"
        )
    u, v = bed.pixels()
    drawn = ndimage.map_coordinates(np.nan_to_num(image), [v, u], order=1, mode="nearest")
    return np.where(bed.inside, drawn, 0.0).astype(np.float32)


def _along(bed: BedMap, at: Pixel | None, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Every node's place (Y, X) along a relief's columns and rows, from its middle, metres."""
    x, y = bed.axes()
    x0, y0 = bed.point(at or bed.middle())
    x, y = x[None, :] - x0, y[:, None] - y0
    return np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
