"""Pairs of frames from the actions of a run, as data sets have them: the hand is not turned."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from jshape._typing import Float
from jshape.actions import fits
from jshape.camera import Camera
from jshape.errors import BadImage
from jshape.io import runs
from jshape.models.bank import Bank
from jshape.robot.run_actions import done_of


def pairs_of(run: runs.Run, bank: Bank, left_out: Counter[str]) -> Iterator[dict[str, Any]]:
    """A row for `datasets.dataset_writer` per action that was looked at before and after.

    Of a turned hand both frames are turned back about the camera's axis, which changes no depth.

    Args:
      run: its frames are of the bank's camera.
      bank: knows how large the ROIs are.
      left_out: counts why actions have no pair.

    Raises:
      BadFile, BadImage: the run is damaged, or of another camera than the bank's.
    """
    found = 0
    for done in done_of(run):
        found += 1
        act = done.act
        if act.action not in bank.actions:
            left_out[f"{act.action}: not in the bank"] += 1
            continue
        if done.before.shape != bank.camera.shape:
            raise BadImage(
                f"{run.folder}: frames of {done.before.shape}; the bank's camera makes "
                f"{bank.camera.shape}"
            )
        hand = bank.predictor(act.action)
        hand = hand if act.length == 1 else hand.lengthened(act.length)
        place = np.rint(_turned_place(act.position, bank.camera, act.yaw)).astype(int)
        if not fits(bank.camera, place[None], hand.roi).all():
            left_out["turned back, the ROI leaves the image"] += 1
            continue
        frames = (turned_back(one, bank.camera, act.yaw) for one in (done.before, done.after))
        prior, posterior = (
            np.nan_to_num(np.rint(one / run.depth_unit)).astype(np.uint16) for one in frames
        )
        yield {
            "id": f"{act.action}_{done.number:05d}",
            "action": act.action,
            "prior": prior,
            "posterior": posterior,
            "u": int(place[0]),
            "v": int(place[1]),
            "width": hand.roi[0],
            "height": hand.roi[1],
            "strength": float(act.strength),
            "path_mm": float(hand.path_mm),
        }
    if missed := len(run) - found:
        left_out["no look before or after, or an unlikely one"] += missed


def turned_back(
    depth: Float[np.ndarray, "H W"], camera: Camera, yaw: float
) -> Float[np.ndarray, "H W"]:
    """A frame as the camera would see it, were it turned by `yaw` about its axis, u towards v.

    Interpolated; NaN beyond the frame and beside pixels without a reading.
    """
    if not yaw:
        return depth
    v, u = np.indices(camera.shape)
    x, y = camera.at(u, v, 1.0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    u, v = camera.pixel(cos * x - sin * y, sin * x + cos * y, 1.0)
    at = np.stack([np.asarray(v, float), np.asarray(u, float)])
    return map_coordinates(depth, at, order=1, cval=np.nan)


def _turned_place(place: Any, camera: Camera, yaw: float) -> Float[np.ndarray, "2"]:
    if not yaw:
        return np.asarray(place, float)
    x, y = camera.at(place[0], place[1], 1.0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([float(p) for p in camera.pixel(cos * x + sin * y, cos * y - sin * x, 1.0)])
