"""An arm over the height-field bed: it moves at once, feels the material, and the bed gives way."""

from collections.abc import Sequence

import jax
import numpy as np

from jshape import sim
from jshape.actions import PAPER_Z
from jshape.camera import matrix
from jshape.robot.arms.base import (
    ArmError,
    ArmSettings,
    Doing,
    EffortLimit,
    Moved,
    NoHardware,
    OpenedArm,
    PoseRefused,
)
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.registry import seed_of
from jshape.robot.rigid import Pose, yaw_of
from jshape.robot.simulated import SimulatedWorld, bed_of, goes_along, placed_path
from jshape.robot.twin.model import base_camera
from jshape.sim.inputs import half_sides

TOUCH = 5.0
"""Effort at which the surface is felt, Nm."""
STIFFNESS = 400.0
"""Further effort per metre below the surface, Nm: 20 mm into flour are 13 Nm."""
STEP = 0.0005
"""Distance between two looks at the effort, metres."""


class SimulatedArm(NoHardware):
    """Moves the tool over a bed that gives way.

    What it does to the bed it does when it comes up again: as much of the stroke as the tool really
    went down, or along its path.
    """

    name = "simulated arm"
    slowness = 10.0
    """Over a bed that is compiled first."""

    def __init__(self, world: SimulatedWorld, base_camera: Pose | None = None):
        """An arm over a world's bed.

        `base_camera` is the pose of its camera in the arm's base frame; None: they are the same.
        """
        self.world = world
        self._base_camera = np.eye(4) if base_camera is None else base_camera
        self._camera_base = np.linalg.inv(self._base_camera)
        self._pose = np.eye(4)  # of the tool, in the camera's frame
        self._effort = 0.0
        self._hard = np.inf
        self._doing: Doing | None = None
        self._start = np.zeros(3)  # of the tool, when the act began
        self._legs = 0  # of the act, so far
        self._sunk = 0.0  # share of the way down to its first point

    def limit(self, *, effort: float, speed: float) -> None:
        """Stop at this effort; it has no speed."""
        self._hard = effort

    def check(self, poses: Sequence[Pose], postures: Sequence[str], tool: Pose) -> None:
        """Whether all of it is within the box."""
        half = half_sides(self.world.bed)
        for pose in poses:
            x, y = (self._camera_base @ pose)[:2, 3]
            if abs(x) > half[0] or abs(y) > half[1]:
                raise PoseRefused(
                    f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm is beyond the walls of the simulated box, "
                    f"±{1e3 * half[0]:.0f} and ±{1e3 * half[1]:.0f} mm from its middle"
                )

    def begin(self, doing: Doing, tool: Pose) -> None:
        """Remember what is being done; coming up, the bed changes."""
        if self._doing is not None and self._doing.operation == "act" and doing.operation == "up":
            self._reshape(self._doing)
        if doing.operation == "act":
            self._start, self._legs, self._sunk = self._pose[:3, 3].copy(), 0, 0.0
        self._doing = doing

    def move(self, pose: Pose, *, speed: float, threshold: float) -> Moved:
        """Go there, or as far as the effort allows."""
        wanted = self._camera_base @ pose
        start, target = self._pose[:3, 3], wanted[:3, 3]
        count = max(int(np.ceil(np.linalg.norm(target - start) / STEP)), 1)
        line = start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (target - start)
        # On its way down the arm feels the bed as it was; it has made its way on the way up.
        upward = target[2] < start[2]
        efforts = np.zeros(count) if upward else self._efforts(line)
        over = np.flatnonzero(efforts > threshold)
        end = over[0] if over.size else count - 1
        self._pose = wanted.copy()
        self._pose[:3, 3] = line[end]
        self._effort = float(efforts[end])
        if self._effort > self._hard:
            said = f"contact effort {self._effort:.0f} Nm; the arm stops at {self._hard:g}"
            raise EffortLimit(said)
        if self._doing is not None and self._doing.operation == "act":
            if self._legs == 0:
                surface = float(self._bed_depth(target[None])[0])
                self._sunk = float(line[end, 2] - surface) / max(float(target[2]) - surface, 1e-6)
            self._legs += 1
        return Moved(bool(over.size), float(efforts[: end + 1].max()), self.pose())

    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """Any; the bed knows its hand."""
        return Moved(False, self._effort, self.pose())

    def home(self) -> Moved:
        """Out of the view; a stroke that was begun has left its trace."""
        if self._doing is not None and self._doing.operation == "act":
            self._reshape(self._doing)
        self._doing, self._pose, self._effort = None, np.eye(4), 0.0
        return Moved(False, 0.0, self.pose())

    def pose(self) -> Pose:
        """Of the tool."""
        return self._base_camera @ self._pose

    def _bed_depth(self, points: np.ndarray) -> np.ndarray:
        """Depth of the surface in front of points (N, 3) in the camera's frame, metres."""
        height = np.asarray(self.world.bed.height)
        column, row = (
            np.clip(np.rint((points[:, k] - at[0]) / (at[1] - at[0])), 0, len(at) - 1).astype(int)
            for k, at in enumerate(map(np.asarray, self.world.bed.axes()))
        )
        return sim.Z_FLOOR - height[row, column]

    def _efforts(self, line: np.ndarray) -> np.ndarray:
        below = line[:, 2] - self._bed_depth(line)
        return np.where(below > 0, TOUCH + STIFFNESS * below, 0.0)

    def _reshape(self, doing: Doing) -> None:
        """What the act did, from where the tool began, where it is and how deep it went."""
        world = self.world
        known = sim.actions_of(world.agent)
        if doing.action not in known:
            raise ArmError(f"the simulated hand cannot {doing.action}; it can: {', '.join(known)}")
        stroke, yaw = sim.stroke(doing.action, world.agent), yaw_of(self._pose)
        gives = stroke.load is not None and float(stroke.load.gives) > 0
        # It acts in the air; and the later points of a path follow the first, so it is down.
        deep = 1.0 if gives or self._legs > 1 else min(self._sunk, 1.0)
        if deep <= 0.02:  # it touched, no more
            return
        place, own, share = self._pose[:2, 3], 1.0, 1.0
        if goes_along(stroke):  # as far as the tool; without a path it only went down
            own, place = placed_path(stroke, doing.way, self._start[:2], yaw)
            gone = float(np.linalg.norm(self._pose[:2, 3] - self._start[:2]))
            share = min(gone / doing.way, 1.0) if doing.way else 0.0
        # Places are pixels of points at the paper's depth, wherever the surface is.
        u, v = (float(at) for at in world.camera.pixel(place[0], place[1], PAPER_Z))
        world.act(doing.action, (u, v), doing.strength * deep, yaw, own, share=share)


def open_simulated(address: str, settings: ArmSettings) -> OpenedArm:
    """An arm over the levelled bed of a seed, and the camera above it, or cameras from anywhere.

    Its base is where the twin's is: both take the same areas and poses.
    """
    bed, for_world, for_eye = bed_of(seed_of(address))
    world = SimulatedWorld(
        *(for_world, bed),
        material=settings.material,
        camera=settings.camera,
        stock_cm3=settings.stock_cm3,
    )
    cameras = settings.cameras or (settings.camera,)
    eyes = [
        simulated_camera(world, jax.random.fold_in(for_eye, k) if k else for_eye, camera)
        for k, camera in enumerate(cameras)
    ]
    above = base_camera()
    arm = SimulatedArm(world, base_camera=above)
    return OpenedArm(arm, eyes[0], above @ matrix(cameras[0].pose), eyes[1:])
