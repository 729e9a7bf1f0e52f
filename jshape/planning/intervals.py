"""Intervals of what a plan predicts: of the image's pixels, and of d (host).

Each action's half widths are those of its ROI (`models.spread`); here several come together.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from jshape import metric
from jshape._typing import Float
from jshape.camera import Camera
from jshape.models.spread import around, half_width_mm, radii_px

IN_D = 0.5
"""Half of the 80 % interval of d, in mean half widths of the image's pixels."""


def of_action(
    before: Float[np.ndarray, "h w"],
    after: Float[np.ndarray, "h w"],
    spread: Float[np.ndarray, "2"],
    camera: Camera,
) -> Float[np.ndarray, "h w"]:
    """Half widths of an action's ROI of I, mm; NaN where its `spread` is not known."""
    change = np.asarray(metric.to_mm(after - before, camera))  # on the host nothing compiles
    return np.asarray(half_width_mm(spread, around(change, radii_px(camera))))


def added(
    shape: tuple[int, int], rois: Iterable[tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, "H W"]:
    """Half widths of an image's pixels after several actions, mm; 0 where there was none.

    Errors of two actions have nothing to do with each other, so where ROIs overlap squares add.

    Args:
      shape: (H, W) of the image.
      rois: first pixel (u, v) and half widths (h, w) in mm of each action.
    """
    squares = np.zeros(shape, np.float32)
    for (left, top), half in rois:
        h, w = half.shape
        squares[top : top + h, left : left + w] += np.square(half)
    return np.sqrt(squares)


def of_distances(
    shape: tuple[int, int],
    rois: Sequence[tuple[np.ndarray, np.ndarray]],
    seen: np.ndarray | None = None,
) -> Float[np.ndarray, "steps"]:
    """Half widths of d to a goal before and after each action, mm.

    d is a mean over the image, and a difference of absolute values is at most the absolute value of
    the difference: so d is off by at most the mean |error|, and by as much where the prediction is
    the goal, which plans aim at.  Errors at different places do not cancel in it, so the mean of
    the half widths counts, `IN_D` of it.

    Args:
      shape: (H, W) of the image.
      rois: first pixel (u, v) and half widths (h, w) in mm of each action.
      seen: (H, W) pixels that d counts; None: all.
    """
    counted = np.ones(shape, bool) if seen is None else seen
    means = [added(shape, rois[:k])[counted].mean() for k in range(len(rois) + 1)]
    return IN_D * np.array(means, np.float32)
