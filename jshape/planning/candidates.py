"""Where actions are tried: grids, dense places, and what a hand can reach (host)."""

import re
from collections.abc import Mapping

import numpy as np
from scipy.ndimage import distance_transform_edt

from jshape import actions
from jshape._typing import ArrayLike, Bool
from jshape.camera import Camera
from jshape.errors import BadImage, BadPosition, JShapeError, UnknownName, quoted
from jshape.models.bank import Bank
from jshape.planning.options import STRIDE


def placed_positions(
    bank: Bank, positions: ArrayLike | Mapping[str, ArrayLike] | str, out_of_bounds: str = "refuse"
) -> dict[str, np.ndarray]:
    """Positions (N_a, 2) per action of a bank, all ROIs inside the image (host).

    "paper" is the paper's 5 x 3 grid, laid so that the bank's largest ROI fits everywhere; "21x15"
    is a grid as wide as each action's own ROI allows.
    """
    rois = bank.rois
    if isinstance(positions, str) and positions == "paper":
        per_action = dict.fromkeys(bank.actions, actions.grid(bank.camera, margin=bank.largest_roi))
    elif isinstance(positions, str):
        size = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", positions, re.ASCII)
        if not size:
            raise BadPosition(
                f"positions {quoted(positions)}: a grid is written COLUMNSxROWS or paper"
            )
        columns, rows = int(size[1]), int(size[2])
        per_action = {
            name: actions.grid(bank.camera, columns, rows, margin=roi) for name, roi in rois.items()
        }
    elif isinstance(positions, Mapping):
        unknown = [name for name in positions if name not in bank.actions]
        if unknown:
            raise UnknownName("action", unknown[0], bank.actions)
        per_action = {name: _as_positions(where) for name, where in positions.items()}
    else:
        per_action = dict.fromkeys(bank.actions, _as_positions(positions))
    return actions.place(bank.camera, per_action, rois, out_of_bounds)


def _as_positions(positions: ArrayLike) -> np.ndarray:
    try:
        array = np.asarray(positions)
    except ValueError:
        raise BadPosition("positions are not (N, 2): they have rows of different length") from None
    if array.size == 0:
        return np.zeros((0, 2), np.int32)
    whole = array.dtype.kind in "iuf" and np.all(np.abs(array) < 2**31)
    if array.ndim != 2 or array.shape[1] != 2 or not whole or np.any(array != np.rint(array)):
        raise BadPosition(
            f"positions have shape {array.shape} and type {array.dtype}; "
            "they must be (N, 2) whole pixels (u, v)"
        )
    return array.astype(np.int32)


def usual_stride(bank: Bank) -> int:
    """Pixels between positions that miss no action of a bank."""
    return min(STRIDE, max(min(min(roi) for roi in bank.rois.values()) // 4, 1))


def dense_positions(bank: Bank, stride: int) -> dict[str, np.ndarray]:
    """Every `stride` pixels along u and v, (N_a, 2) per action, wherever its own ROI fits.

    Raises:
      JShapeError: a stride that is no whole number from 1 to the image's shorter side.
    """
    most = min(bank.camera.shape)
    whole = isinstance(stride, int | np.integer) and not isinstance(stride, bool)
    if not whole or not 1 <= stride <= most:
        raise JShapeError(
            f"stride is {quoted(stride)}; it must be a whole number of pixels from 1 to {most}"
        )

    def line(size: int, roi: int) -> np.ndarray:
        first, last = roi // 2, size - (roi - roi // 2)
        return np.arange(first + (last - first) % stride // 2, last + 1, stride)

    found = {}
    for name, (w, h) in bank.rois.items():
        u, v = line(bank.camera.width, w), line(bank.camera.height, h)
        found[name] = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2).astype(np.int32)
    return found


def reachable(
    camera: Camera, mask: ArrayLike | None, clearance_mm: float = 0.0
) -> Bool[np.ndarray, "H W"] | None:
    """Pixels at which the hand may be placed; None is everywhere.

    Args:
      camera: whose image.
      mask: (H, W), not 0 where the hand can go; None is everywhere in the image.
      clearance_mm: least distance to the image's edge, where the box has its walls, and to what
        the mask leaves out; measured in the middle of the camera's range.

    Raises:
      BadImage: the mask has another shape or type, or leaves nothing.
      JShapeError: a clearance that is no number from 0.
    """
    if not isinstance(clearance_mm, int | float | np.number) or not 0 <= clearance_mm < np.inf:
        raise JShapeError(f"clearance_mm is {quoted(clearance_mm)}; it must be a number from 0")
    if mask is None and clearance_mm == 0:
        return None
    try:
        free = np.ones(camera.shape, bool) if mask is None else np.ma.filled(mask, 0)
    except ValueError:
        raise BadImage("reachable is no (H, W) image: it has rows of different length") from None
    if free.shape != camera.shape or free.dtype.kind not in "buif":
        raise BadImage(
            f"reachable has shape {free.shape} and type {free.dtype}; the bank's camera makes "
            f"{camera.shape} (rows, columns)"
        )
    if free.dtype.kind == "f" and not np.isfinite(free).all():
        raise BadImage("reachable has pixels that are NaN or infinite")
    free = free != 0
    if clearance_mm:
        depth = (float(camera.z_min) + float(camera.z_max)) / 2
        size = [1e3 / float(f) for f in camera.scale(depth)[::-1]]  # mm of a pixel
        far = np.asarray(distance_transform_edt(np.pad(free, 1), sampling=size))
        free = far[1:-1, 1:-1] > clearance_mm
    if not free.any():
        clear = f" {clearance_mm:g} mm from its ends" if clearance_mm else ""
        raise BadImage(f"reachable leaves no pixel{clear} where the hand may be placed")
    return free
