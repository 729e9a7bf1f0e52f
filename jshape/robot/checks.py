"""What is looked for in a look before it is believed: something in the way, or a bed that moved."""

import numpy as np

from jshape import metric
from jshape._typing import Bool, Float
from jshape.actions import PlacedAction
from jshape.camera import Camera
from jshape.data.missing import missing
from jshape.errors import BadImage
from jshape.models.bank import Bank
from jshape.models.spread import surprise

NEARER_MM = 10.0
"""Readings nearer than the camera's range by more than this are not the bed."""
OCCLUDED = 0.002
"""Largest share of such readings: 400 pixels of the paper's image, the tip of a finger."""
MOVED_MM = 1.0
"""Largest median change beside the action.  The noise of a look's median is a tenth of it; a bed
that was pushed by 5 mm changes by more wherever it is not flat, and at its walls."""


class Occluded(BadImage):
    """Something is between the camera and the bed."""


class BedMoved(BadImage):
    """The bed is not where it was, though no action touched it there."""


def check_clear(depth: Float[np.ndarray, "H W"], camera: Camera, where: str = "look") -> None:
    """Occluded where more than `OCCLUDED` of the pixels are nearer than the camera's range."""
    near = ~missing(depth) & (depth < float(camera.z_min) - NEARER_MM / 1000.0)
    if near.mean() > OCCLUDED:
        v, u = (int(x.mean()) for x in np.nonzero(near))
        raise Occluded(
            f"{where}: {100 * near.mean():.1f} % of the pixels, around ({u}, {v}), are nearer than "
            f"{float(camera.z_min) * 1000 - NEARER_MM:.0f} mm: something is in front of the bed"
        )


def check_still(
    before: Float[np.ndarray, "H W"],
    after: Float[np.ndarray, "H W"],
    touched: Bool[np.ndarray, "H W"],
) -> None:
    """BedMoved where the bed changed by more than `MOVED_MM` beside what an action touched.

    By any change of depth (metres): `data.moved` tells what all of a bed does, and only from 5 mm.
    """
    beside = ~missing(before) & ~missing(after) & ~touched
    change = np.abs(after[beside] - before[beside])
    moved = 1e3 * float(np.median(change)) if change.size else 0.0
    if moved > MOVED_MM:
        raise BedMoved(
            f"look: the bed beside the action changed by {moved:.1f} mm (median); at most "
            f"{MOVED_MM:g}: the bed or the camera was moved"
        )


def surprise_of(
    bank: Bank,
    action: str,
    before: Float[np.ndarray, "h w"],
    predicted: Float[np.ndarray, "h w"],
    after: Float[np.ndarray, "h w"],
) -> float:
    """How far a ROI is off, in intervals: `models.spread.surprise`; NaN where they are not known.

    Args:
      bank: knows the intervals.
      action: its name.
      before: I of the ROI before it, gaps filled.
      predicted: I after it, as predicted.
      after: I after it, NaN where there was no reading.
    """
    error = (after - predicted) * float(metric.to_mm(1.0, bank.camera))
    return float(surprise(error, bank.half_width_mm(action, before, predicted)))


def touched_by(camera: Camera, action: PlacedAction) -> Bool[np.ndarray, "H W"]:
    """Where an action may have changed the bed: its ROI, and half of it more on all sides."""
    assert action.roi is not None
    (u, v), (w, h) = action.position, action.roi
    rows, columns = np.ogrid[: camera.height, : camera.width]
    return (np.abs(columns - u) <= w) & (np.abs(rows - v) <= h)
