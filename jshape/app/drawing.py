"""A goal made by hand: strokes of a brush, and words, that raise or sink the bed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.errors import JShapeError
from jshape.goals import BedMap, drawn_on_image, placed, relief_of_text

LARGEST_MM = {"brush": 100.0, "text": 500.0}
"""Widest brush, longest text."""
DEEPEST_MM = 100.0
"""Deepest mark."""


class BrushStroke(NamedTuple):
    """One movement of the brush."""

    line: tuple[tuple[float, float], ...]
    """Pixels (u, v) it went through, at least one."""
    width_mm: float
    """Of the brush where it is deepest."""
    depth_mm: float
    """How far it sinks the bed; negative raises it."""


class Words(NamedTuple):
    """A line of text."""

    text: str
    at: tuple[float, float]
    """Pixel (u, v) of its middle."""
    size_mm: float
    """Of its longer side."""
    depth_mm: float
    """How far it sinks the bed; negative raises it."""


Mark = BrushStroke | Words
"""What can be drawn."""


def wanted(bed: BedMap, marks: Sequence[Mark]) -> Float[np.ndarray, "Y X"]:
    """The change of a bed's height that marks ask for, metres up, before it is held to limits.

    Marks that cross do not add up: the deeper one counts, and the higher one.
    """
    strokes = [mark for mark in marks if isinstance(mark, BrushStroke)]
    change = drawn_on_image(_brushed(bed, strokes), bed)
    for mark in marks:
        if isinstance(mark, Words):
            relief = relief_of_text(mark.text, -mark.depth_mm / 1e3)
            share = mark.size_mm / 1e3 / max(relief.size)
            relief = replace(relief, size=(relief.size[0] * share, relief.size[1] * share))
            more = placed(relief, bed, mark.at)
            change = np.where(np.abs(more) > np.abs(change), more, change)
    return change


def _brushed(bed: BedMap, strokes: Sequence[BrushStroke]) -> Float[np.ndarray, "H W"]:
    """What strokes change in the frame, metres up."""
    shape = bed.frame.shape
    pixels_per_mm = float(bed.camera.scale(bed.level)[0]) / 1e3
    sunk, raised = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for stroke in strokes:
        away = np.ones(shape, np.uint8)
        line = np.rint(np.asarray(stroke.line) * 8).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(away, [line], False, 0, shift=3)
        u, v = np.rint(stroke.line[0]).astype(int)
        away[v, u] = 0  # a press without a way has no line
        mm = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) / pixels_per_mm
        change = np.where(mm <= stroke.width_mm / 2, abs(stroke.depth_mm) / 1e3, 0.0)
        side = sunk if stroke.depth_mm > 0 else raised
        np.maximum(side, change, out=side)
    return raised - sunk


def check_mark(mark: Mark, camera: Camera) -> Mark:
    """A mark that begins in the image; a JShapeError says what of it makes no sense."""
    size, most = (
        (mark.width_mm, "brush") if isinstance(mark, BrushStroke) else (mark.size_mm, "text")
    )
    if not 0 < size <= LARGEST_MM[most] or not 0 < abs(mark.depth_mm) <= DEEPEST_MM:
        raise JShapeError(
            f"a {most} of {size:g} mm, {mark.depth_mm:g} mm deep; expected a size up to "
            f"{LARGEST_MM[most]:g} mm and a depth up to {DEEPEST_MM:g} mm, neither of them 0"
        )
    if isinstance(mark, Words):
        return mark
    line = np.asarray(mark.line, float).reshape(-1, 2)
    if not len(line) or not np.isfinite(line).all():
        raise JShapeError(f"a stroke of {len(line)} points; expected at least one (u, v)")
    inside = np.clip(line, 0, (camera.width - 1, camera.height - 1))
    return mark._replace(line=tuple((float(u), float(v)) for u, v in inside))
