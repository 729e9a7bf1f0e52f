"""Inverse kinematics of the arm within its joints' limits, through mink.

Poses are of the flange in the base frame, metres.  A straight line is solved point by point, each
from the one before, so that the arm neither jumps nor turns its elbow round.
"""

from typing import Any

import numpy as np

from jshape._typing import Float
from jshape.robot.arms.base import PoseRefused
from jshape.robot.rigid import Pose
from jshape.robot.twin.engine import mink, mujoco
from jshape.robot.twin.model import FOLDER

NEAR_MM, NEAR_RAD = 0.05, 2e-4
"""A pose is reached within this distance and this angle."""
ROUNDS = 60
"""Steps of the solver for one pose, at most; from a neighbour 2 to 5 are enough."""
RESTFUL = 8
"""In so many of them the arm also tends to its rest."""
STEP = 0.01
"""Points of a line are so far apart, metres: between them it strays by less than 0.03 mm."""
LEVER = 0.3
"""A turn by one radian counts as so many metres of way."""
JUMP = np.radians(12.0)
"""A joint that must turn further than this between two points jumps."""
MARGIN = np.radians(1.0)
"""Stay so far from the joints' limits."""


class Reach:
    """What the arm can reach, and how."""

    def __init__(self, posture: Float[np.ndarray, "7"]):
        """The arm's kinematics; of all solutions it takes those near `posture` (radians)."""
        self._mink = mink()
        model = mujoco().MjModel.from_xml_path(str(FOLDER / "iiwa.xml"))
        self.ranges = model.jnt_range[:, 1].copy()
        """The joints turn so far to either side, radians."""
        self._configuration = self._mink.Configuration(model)
        self._task = self._mink.FrameTask("flange", "site", position_cost=1.0, orientation_cost=0.3)
        self._rest = self._mink.PostureTask(model, cost=2e-3)
        self._rest.set_target(np.asarray(posture, float))
        self._limits = [self._mink.ConfigurationLimit(model, min_distance_from_limits=MARGIN)]

    def pose(self, joints: Float[np.ndarray, "7"]) -> Pose:
        """Of the flange at these joint angles."""
        self._configuration.update(np.asarray(joints, float))
        return self._configuration.get_transform_frame_to_world("flange", "site").as_matrix()

    def solve(self, pose: Pose, start: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        """Joint angles that bring the flange to a pose.

        Raises:
          PoseRefused: none within the joints' limits, or none that can be reached from `start`.
        """
        self._configuration.update(np.asarray(start, float))
        self._task.set_target(self._mink.SE3.from_matrix(np.asarray(pose, float)))
        for n in range(ROUNDS):
            far_mm, turned = self._error()
            if max(far_mm / NEAR_MM, turned / NEAR_RAD) < 1.0:
                return self._configuration.q.copy()
            # Where the arm is almost straight or folded, its rest would pull it off the target.
            tasks = [self._task, self._rest] if n < RESTFUL else [self._task]
            try:
                velocity = self._mink.solve_ik(
                    self._configuration, tasks, 1.0, "daqp", damping=1e-6, limits=self._limits
                )
            except (self._mink.NoSolutionFound, self._mink.NotWithinConfigurationLimits):
                break
            # A large step would leave where the linear problem holds.
            largest = np.abs(velocity).max()
            self._configuration.integrate_inplace(velocity * min(1.0, 0.3 / (largest + 1e-9)), 1.0)
        far_mm, turned = self._error()
        raise PoseRefused(
            f"inverse kinematics finds no joint angles for the flange at "
            f"{_mm(np.asarray(pose)[:3, 3])} mm in the base frame; "
            f"the nearest is {far_mm:.1f} mm and {np.degrees(turned):.1f} degrees off"
        )

    def line(
        self, start: Float[np.ndarray, "7"], pose: Pose
    ) -> tuple[float, Float[np.ndarray, "K 7"]]:
        """The straight line from where the flange is at `start` to a pose.

        Returns:
          Its length in metres, turns counted with `LEVER`, and joint angles of evenly spaced points
          along it, radians.

        Raises:
          PoseRefused: a point of it cannot be reached, or only by a jump.
        """
        start = np.asarray(start, float)
        first = self._mink.SE3.from_matrix(self.pose(start))
        last = self._mink.SE3.from_matrix(np.asarray(pose, float))
        across = last.translation() - first.translation()
        turn = (first.rotation().inverse() @ last.rotation()).log()
        angle = float(np.linalg.norm(turn))
        try:
            return self._along(start, first, across, turn)
        except PoseRefused:
            if angle < np.pi / 2:
                raise
            # A joint at its limit: the hand may get there by turning the other way round.
            return self._along(start, first, across, turn * (1 - 2 * np.pi / angle))

    def _along(
        self,
        start: Float[np.ndarray, "7"],
        first: Any,
        across: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3"],
    ) -> tuple[float, Float[np.ndarray, "K 7"]]:
        """A line from a pose by a way and a turn (rotation vector in its frame); see `line`."""
        length = float(np.linalg.norm(across) + LEVER * np.linalg.norm(turn))
        count = max(int(np.ceil(length / STEP)), 1)
        joints = [start]
        for share in np.linspace(0.0, 1.0, count + 1)[1:]:
            rotation = first.rotation() @ self._mink.SO3.exp(share * turn)
            point = self._mink.SE3.from_rotation_and_translation(
                rotation, first.translation() + share * across
            )
            solved = self.solve(point.as_matrix(), joints[-1])
            if np.abs(solved - joints[-1]).max() > JUMP:
                raise PoseRefused(
                    "the straight line passes too near a singular pose at "
                    f"{_mm(point.translation())} mm in the base frame"
                )
            joints.append(solved)
        return length, np.stack(joints)

    def _error(self) -> tuple[float, float]:
        """Distance in mm and angle in radians from the target."""
        error = self._task.compute_error(self._configuration)
        return float(np.linalg.norm(error[:3])) * 1000.0, float(np.linalg.norm(error[3:]))


def _mm(point: np.ndarray) -> str:
    return "({:.0f}, {:.0f}, {:.0f})".format(*(1000.0 * point))
