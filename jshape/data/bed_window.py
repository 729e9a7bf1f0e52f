"""Where in a map the bed is: a box on a table, or a table on the floor, seen from above."""

import numpy as np
from scipy import ndimage

from jshape._typing import Float
from jshape.data.planes import NEAR

FILLS = 0.95
"""Share of its rectangle that a bed fills; if that is as much of the view, nothing surrounds it."""
MOSTLY = 0.85
"""Share of what is level with the middle that lies in that rectangle: less of a round heap."""
INSET, MIN_SIDE = 2, 16
"""Pixels: left out at the bed's edge, where readings mix; and the smallest bed."""


def bed_window(heights: Float[np.ndarray, "H W"]) -> tuple[int, int, int, int] | None:
    """(left, top, width, height) that holds only the bed, pixels; None: it fills the view.

    A table under it, or the floor around a table, lies higher or lower by a step; if what is level
    with the middle fills a rectangle, that is the bed.  `heights` are metres above the plane that
    most of the view lies in, NaN where nothing is known.
    """
    with np.errstate(invalid="ignore"):
        level = np.where(np.abs(heights) < NEAR, 1, 2 + (heights < 0))
    level[np.isnan(heights)] = 0
    height, width = heights.shape
    v, u = height * 2 // 5, width * 2 // 5
    middle = np.s_[v : height - v, u : width - u]
    usual = np.bincount(level[middle].ravel(), minlength=4)[1:].argmax() + 1
    parts = np.zeros(heights.shape, np.int32)
    ndimage.label(level == usual, output=parts)
    found = parts[middle][level[middle] == usual]
    return _filled(parts == np.bincount(found).argmax()) if found.size else None


def _filled(part: np.ndarray) -> tuple[int, int, int, int] | None:
    """The rectangle (left, top, width, height) that a part fills; None: all, or no rectangle."""
    found = []
    for axis in (0, 1):
        count = part.sum(axis)
        most = np.flatnonzero(count >= 0.8 * np.percentile(count[count > 0], 90))
        found.append((int(most[0]) + INSET, int(most[-1]) + 1 - INSET))
    (left, right), (top, bottom) = found
    if right - left < MIN_SIDE or bottom - top < MIN_SIDE:
        return None
    height, width = part.shape
    share = (right - left) * (bottom - top) / (width * height)
    inside = part[top:bottom, left:right]
    whole = inside.mean() > FILLS and inside.sum() > MOSTLY * part.sum()
    return (left, top, right - left, bottom - top) if whole and share < FILLS else None
