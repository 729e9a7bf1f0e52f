"""Where the camera is: hand-eye calibration from pairs of poses.

A target that the camera can measure and the gripper of the arm are moved together (eye-to-hand: a
fixed camera, the target in the gripper), or the camera is in the gripper and the target lies still
(eye-in-hand).  Every pair is (T_base_gripper, T_camera_target).  What is wanted is X: T_base_camera
for a fixed camera, T_gripper_camera for one in the hand.  With A = T_base_gripper, or its inverse
for a fixed camera, A X T_camera_target is the same for all pairs: where the target is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import ArrayLike, Float
from jshape.camera import Camera
from jshape.errors import UnknownName
from jshape.robot.hand_eye import (
    METHODS,
    PAIR_TOLERANCE,
    POINTS,
    Residuals,
    least_turn_deg,
    residuals_of,
    solve,
)
from jshape.robot.rigid import BadPose, check_far, check_rigid, mean_pose

LEAST, ENOUGH, MOST = 3, 8, 300
"""Pairs: fewer are refused, fewer are warned of, more are refused."""
LEAST_DEG, ENOUGH_DEG = 5.0, 15.0
"""The same for the turn about the axis that is turned about least."""
USUAL_MM, WORST_MM = 2.0, 10.0
"""Mean errors of the target's points: larger ones are warned of, and refused."""
NEAR_HAND, NEAR_TARGET = 0.1, 0.05
"""Metres: no arm keeps its gripper so near its base in all poses, no camera a target so near
itself.  What is nearer is in another unit."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera's pose, and how well it fits."""

    pose: Float[np.ndarray, "4 4"]
    """T_base_camera; T_gripper_camera if the camera is in the hand.  Metres."""
    eye_in_hand: bool
    """The camera is in the gripper."""
    method: str
    """Of `METHODS`."""
    target: Float[np.ndarray, "4 4"]
    """T_gripper_target; T_base_target if the camera is in the hand.  Metres."""
    residuals: Residuals
    """Of the pairs that it was found from."""
    left_out: Residuals | None
    """Of each pair with a calibration from all others: the honest error.  NaN where the others
    turn too little.  None for 3 pairs."""
    turn_deg: float
    """How far the poses are turned about the axis that they are turned about least."""
    tried_mm: dict[str, float]
    """Mean error of the target's points by method."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know, a line each."""
        error = self.residuals.points_mm
        count = len(error)
        lines = []
        if count < ENOUGH:
            lines.append(f"only {count} pose pairs; {ENOUGH} or more average the noise")
        if self.turn_deg < ENOUGH_DEG:
            lines.append(
                f"the gripper is turned by only {self.turn_deg:.0f}° about its least-turned axis; "
                f"{ENOUGH_DEG:g}° or more make the position sure"
            )
        worst, usual = int(error.argmax()), float(np.median(error))
        if count > LEAST and error[worst] > max(4 * usual, 1.0):
            lines.append(
                f"pair {worst + 1} is off by {error[worst]:.1f} mm, half of all by at most "
                f"{usual:.1f}: look at it, or leave it out"
            )
        if error.mean() > USUAL_MM:
            lines.append(f"the pairs contradict each other by {error.mean():.1f} mm on average")
        return tuple(lines)


def calibrate(
    base_gripper: ArrayLike,
    camera_target: ArrayLike,
    *,
    eye_in_hand: bool = False,
    method: str | None = None,
    camera: Camera | None = None,
) -> Calibration:
    """Find the camera's pose.

    Args:
      base_gripper: (N, 4, 4) poses of the gripper in the arm's base frame, metres.
      camera_target: (N, 4, 4) poses of the target in the camera's frame, metres.
      eye_in_hand: the camera is in the gripper and the target lies still; else the camera is fixed
        and the target is in the gripper.
      method: one of `METHODS`; None: the one whose mean error of the target's points is least.
      camera: gives errors in its pixels as well.

    Raises:
      BadPose: too few or too many pairs, matrices that are not rigid, poses turned too little, a
        target behind the camera, a method that finds nothing, or pairs that contradict each other.
      UnknownName: no such method.
    """
    if method is not None and method not in METHODS:
        raise UnknownName("method", method, METHODS)
    hands = _checked(base_gripper, "base_gripper")
    targets = _checked(camera_target, "camera_target")
    if len(hands) != len(targets):
        raise BadPose(f"{len(hands)} poses of the gripper and {len(targets)} of the target")
    if not LEAST <= len(hands) <= MOST:
        raise BadPose(
            f"{len(hands)} pose pairs; {LEAST} to {MOST} are taken, {ENOUGH} or more are good"
        )
    turn = least_turn_deg(hands)
    if turn < LEAST_DEG:
        raise BadPose(
            f"the gripper is turned by only {turn:.1f}° about its least-turned axis; at least "
            f"{LEAST_DEG:g}° is needed: turn it about two axes or more, by 30° or so"
        )
    depths = (targets @ POINTS)[:, 2].min(-1)
    if camera is not None and depths.min() <= 0:  # its errors in pixels would be none
        k = int(depths.argmin())
        raise BadPose(
            f"camera_target of pair {k + 1}: the target is at z = {targets[k, 2, 3]:.3f} m, not "
            "before the camera; is it the target in the camera's frame, in metres?"
        )
    check_far(hands, NEAR_HAND, "base_gripper: the gripper", "the base")
    check_far(targets, NEAR_TARGET, "camera_target: the target", "the camera")
    moving = hands if eye_in_hand else np.linalg.inv(hands)
    names = (method,) if method else METHODS
    poses = {n: pose for n in names if (pose := solve(n, moving, targets)) is not None}
    tried = {n: float(residuals_of(p, moving, targets).points_mm.mean()) for n, p in poses.items()}
    if not tried:
        raise BadPose(
            f"{method or 'no method'} finds no rigid pose that fits these pairs"
            + _hint(eye_in_hand, np.inf, hands, targets)
        )
    best = min(tried, key=lambda name: tried[name])
    pose = poses[best]
    if tried[best] > WORST_MM:
        raise BadPose(
            f"the pairs contradict each other by {tried[best]:.0f} mm on average, at most "
            f"{WORST_MM:g} mm is allowed" + _hint(eye_in_hand, tried[best], hands, targets)
        )
    return Calibration(
        pose=pose,
        eye_in_hand=eye_in_hand,
        method=best,
        target=mean_pose(moving @ pose @ targets),
        residuals=residuals_of(pose, moving, targets, camera),
        left_out=_left_out(best, moving, targets, camera) if len(hands) > LEAST else None,
        turn_deg=turn,
        tried_mm=tried,
    )


def _checked(poses: ArrayLike, what: str) -> Float[np.ndarray, "N 4 4"]:
    try:
        pile = list(poses)  # pyright: ignore[reportArgumentType]
    except TypeError:
        raise BadPose(f"{what}: is a {type(poses).__name__}; expected (N, 4, 4) matrices") from None
    checked = (
        check_rigid(pose, f"{what} of pair {k}", PAIR_TOLERANCE) for k, pose in enumerate(pile, 1)
    )
    return np.array([*checked]).reshape(-1, 4, 4)


def _left_out(
    name: str, moving: np.ndarray, targets: np.ndarray, camera: Camera | None
) -> Residuals:
    """Of each pair, with all others."""
    all_rows = []
    for k in range(len(moving)):
        others = np.arange(len(moving)) != k
        enough = least_turn_deg(moving[others]) >= LEAST_DEG
        pose = solve(name, moving[others], targets[others]) if enough else None
        if pose is None:
            all_rows.append([np.nan] * 4)
            continue
        target = mean_pose(moving[others] @ pose @ targets[others])
        one = residuals_of(pose, moving[k : k + 1], targets[k : k + 1], camera, target)
        all_rows.append([np.nan if x is None else x.item() for x in one])
    mm, degrees, points_mm, pixels = np.array(all_rows).T
    return Residuals(mm, degrees, points_mm, None if camera is None else pixels)


def _hint(eye_in_hand: bool, error: float, hands: np.ndarray, targets: np.ndarray) -> str:
    """What may be the matter with pairs that contradict each other."""

    def fit(hands: np.ndarray, targets: np.ndarray, in_hand: bool = eye_in_hand) -> float:
        """Mean error of the target's points, mm, were these the pairs."""
        moving = hands if in_hand else np.linalg.inv(hands)
        pose = solve("park", moving, targets)
        return np.inf if pose is None else residuals_of(pose, moving, targets).points_mm.mean()

    other_hands, other_targets = _w_first(hands), _w_first(targets)
    for what, pairs in (
        ("base_gripper", (other_hands, targets)),
        ("camera_target", (hands, other_targets)),
        ("both", (other_hands, other_targets)),
    ):
        if (fits := fit(*pairs)) < min(error / 4, WORST_MM):
            return (
                f"; with the quaternions of {what} as w, x, y, z they fit to {fits:.1f} mm: "
                "x, y, z, w is expected"
            )
    fits = fit(hands, targets, not eye_in_hand)
    if np.isfinite(fits) and fits < error / 4:
        right = "with a fixed camera" if eye_in_hand else "with the camera in the hand"
        # The same as all poses of one kind inverted: which of the two, the pairs cannot say.
        return (
            f"; {right} they fit to {fits:.1f} mm: is that how it was set up, or are the poses "
            "of one kind inverted?"
        )
    return "; are they T_base_gripper and T_camera_target, each pair of one moment?"


def _w_first(poses: np.ndarray) -> np.ndarray:
    """Poses as they would be if their quaternions had been w, x, y, z."""
    found = poses.copy()
    read = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    found[:, :3, :3] = Rotation.from_quat(np.roll(read, -1, axis=1)).as_matrix()
    return found
