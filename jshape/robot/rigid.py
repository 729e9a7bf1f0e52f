"""Poses as 4x4 matrices, metres: rotation and position of one frame in another.

`T_a_b` is the pose of frame b in frame a; it takes points of b to a.  Quaternions are (x, y, z, w).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import ArrayLike, Float
from jshape.errors import JShapeError

Pose = Float[np.ndarray, "4 4"]
"""Of one frame in another, metres."""
TOLERANCE = 1e-4
"""How far a rotation may be from orthonormal, per number of RᵀR."""
FARTHEST = 20.0
"""Largest coordinate of a position that is taken for metres."""


class BadPose(JShapeError):
    """A matrix that is no pose, or poses that say too little."""


def check_rigid(
    matrix: ArrayLike, what: str, tolerance: float = TOLERANCE
) -> Float[np.ndarray, "4 4"]:
    """The matrix as float64, its rotation the nearest exact one; `what` names it in errors.

    Raises:
      BadPose: another shape, not finite, sheared, scaled, mirrored, or not in metres.
    """
    try:
        found = np.array(matrix, np.float64)
    except (TypeError, ValueError):
        raise BadPose(f"{what}: is no array of numbers; expected a 4x4 matrix") from None
    if found.shape != (4, 4):
        raise BadPose(f"{what}: has shape {found.shape}; expected a 4x4 matrix")
    if not np.isfinite(found).all():
        raise BadPose(f"{what}: holds NaN or infinity")
    if np.abs(found[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise BadPose(f"{what}: the last row is {_text(found[3])}; expected (0, 0, 0, 1)")
    rotation = found[:3, :3]
    off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    det = np.linalg.det(rotation)
    if off > tolerance:
        raise BadPose(
            f"{what}: is not rigid: RᵀR is {off:.2g} off the identity; at most {tolerance:g}"
        )
    if abs(det - 1) > 3 * tolerance:
        raise BadPose(f"{what}: is not rigid: det R is {det:.4g}; a rotation has 1")
    if np.abs(found[:3, 3]).max() > FARTHEST:
        raise BadPose(
            f"{what}: its position {_text(found[:3, 3])} is beyond {FARTHEST:g} m; are these mm? "
            "a matrix is in metres, times 0.001"
        )
    if off > 1e-12:  # an exact one stays what it is to the bit
        left, _, right = np.linalg.svd(rotation)
        found[:3, :3] = left @ right
    return found


def check_far(poses: Float[np.ndarray, "*B 4 4"], least: float, what: str, of: str) -> None:
    """BadPose where all poses are nearer than `least` metres: another unit was meant."""
    far = float(np.linalg.norm(poses[..., :3, 3], axis=-1).max())
    if far < least:
        would = (
            f"; times 1000 would fit ({1e3 * far:.3g} m): are they metres where mm are meant?"
            if least <= 1e3 * far <= FARTHEST
            else ""
        )
        raise BadPose(
            f"{what} is never farther than {1e3 * far:.3g} mm from {of}, "
            f"{1e3 * least:g} mm or more is expected{would}"
        )


def pose_at(
    position: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "4 4"]:
    """The pose of a position in metres and a quaternion (x, y, z, w), which is normalised."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = position
    return pose


def quaternion_of(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4"]:
    """(x, y, z, w) of a pose's rotation, w from 0."""
    return Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)


def yaw_of(pose: Float[np.ndarray, "4 4"]) -> float:
    """Turn of a pose about its frame's z axis, from x towards y, radians."""
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def angles_deg(
    a: Float[np.ndarray, "N 4 4"], b: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "N"]:
    """Angle from each rotation to another, degrees."""
    between = np.swapaxes(a[:, :3, :3], -1, -2) @ b[:, :3, :3]
    return np.degrees(Rotation.from_matrix(between).magnitude())


def mean_pose(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "4 4"]:
    """The pose nearest to all (least squares, rotation and position apart)."""
    mean = np.eye(4)
    mean[:3, :3] = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    mean[:3, 3] = poses[:, :3, 3].mean(0)
    return mean


def _text(values) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
