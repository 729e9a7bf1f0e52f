"""What a hand-eye calibration is made of: OpenCV's solvers, and how far pairs of poses are off.

`moving` are the poses A of `jshape.robot.calibration`, `targets` the T_camera_target, (N, 4, 4).
"""

from typing import Any, NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.robot.rigid import BadPose, angles_deg, check_rigid, mean_pose

METHODS = ("tsai", "park", "horaud", "andreff", "daniilidis")
"""What OpenCV's `calibrateHandEye` offers."""
PAIR_TOLERANCE = 2e-3
"""How far from orthonormal the rotations of pairs may be: those written with 3 decimals are
by up to 0.0016, and some 0.03° off."""
TARGET = 0.1
"""Side of the square target whose corners and middle measure errors, metres."""

_HALF = TARGET / 2
POINTS = np.array([[0, -1, 1, 1, -1], [0, -1, -1, 1, 1], [0] * 5, [1 / _HALF] * 5]) * _HALF


class Residuals(NamedTuple):
    """How far each pair's target is from where the calibration says it is."""

    mm: Float[np.ndarray, "N"]
    """Of its origin."""
    degrees: Float[np.ndarray, "N"]
    """Of its rotation."""
    points_mm: Float[np.ndarray, "N"]
    """Mean over the corners and the middle of a square of 100 mm: both in one number."""
    pixels: Float[np.ndarray, "N"] | None
    """The same points in the image; None without a camera."""


def least_turn_deg(poses: Float[np.ndarray, "N 4 4"]) -> float:
    """How far poses are turned about the axis that they are turned about least, degrees.

    The least singular value of all R_ij - 1 stacked, over the root of their number, as the angle
    that would give it.  Hand-eye calibration divides by it: 0 if all turn about one axis.
    The sum of the R_ij is SᵀS with S the sum of the R_i, so no pair is ever formed.
    """
    count = len(poses)
    most = np.linalg.svd(poses[:, :3, :3].sum(0), compute_uv=False)[0]
    square = max(0.0, 2 * (count**2 - most**2) / (count * (count - 1)))
    return float(np.degrees(2 * np.arcsin(min(1.0, np.sqrt(square) / 2))))


def solve(name: str, moving: np.ndarray, targets: np.ndarray) -> np.ndarray | None:
    """X by one of OpenCV's methods; None if it finds no rotation."""
    import cv2

    opencv: Any = cv2  # its stubs know lists of matrices only
    log = opencv.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)  # Tsai's says on stderr where it fails
    try:
        parts = [part for all_ in (moving, targets) for part in (all_[:, :3, :3], all_[:, :3, 3])]
        method = getattr(opencv, f"CALIB_HAND_EYE_{name.upper()}")
        rotation, position = opencv.calibrateHandEye(*parts, method=method)
    except cv2.error:
        return None
    finally:
        log.setLogLevel(level)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, np.ravel(position)
    if (pose == np.eye(4)).all():  # what Tsai's gives where it fails
        return None
    try:
        return check_rigid(pose, name, PAIR_TOLERANCE)
    except BadPose:
        return None


def residuals_of(
    pose: np.ndarray,
    moving: np.ndarray,
    targets: np.ndarray,
    camera: Camera | None = None,
    target: np.ndarray | None = None,
) -> Residuals:
    """Of pairs; `target` is where the target is, None: the mean over these pairs."""
    if target is None:
        target = mean_pose(moving @ pose @ targets)
    expected = np.linalg.inv(moving @ pose) @ target
    a, b = (np.swapaxes((poses @ POINTS)[:, :3], -1, -2) for poses in (targets, expected))
    return Residuals(
        1e3 * np.linalg.norm(targets[:, :3, 3] - expected[:, :3, 3], axis=-1),
        angles_deg(targets, expected),
        1e3 * np.linalg.norm(a - b, axis=-1).mean(-1),
        None if camera is None else _pixels(camera, a, b),
    )


def _pixels(camera: Camera, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) mean distance of points (N, 5, 3) in the image; infinite behind the camera."""

    def at(points: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(points, -1, 0)
        return np.stack(camera.pixel(x, y, np.where(z > 0, z, np.nan)), -1)

    return np.nan_to_num(np.linalg.norm(at(a) - at(b), axis=-1).mean(-1), nan=np.inf)
