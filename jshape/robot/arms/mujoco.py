"""The arm of the physics twin: MuJoCo moves it, mink says how, and the bed gives way below it.

`make_twin` gives it with its camera, ready to use.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.interpolate import CubicSpline

from jshape import sim
from jshape._typing import Array, Key
from jshape.camera import D435_BAZAR, Camera
from jshape.errors import BadCamera, BadPosition, UnknownName
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
from jshape.robot.cameras.mujoco import MuJoCoCamera
from jshape.robot.registry import seed_of
from jshape.robot.rigid import Pose
from jshape.robot.simulated import bed_of
from jshape.robot.twin import fingers
from jshape.robot.twin.model import FLOOR, RIM, Obstacle
from jshape.robot.twin.stroke import BedStroke, pours
from jshape.robot.twin.world import Twin

BOX = (0.50, 0.40)
"""The paper's wooden box, metres along u and v."""
HARD = 120.0
"""Contact effort at which the arm stops for good unless `limit` says otherwise, Nm."""
PEAK = 1.875
"""Highest speed of a smooth motion over its mean speed."""
SLOWEST = 0.15
"""A motion takes at least so long, seconds."""
SETTLE = 0.15
"""The arm waits so long at the end of a motion, seconds, for what still swings."""
TURNS = 2.5
"""The hand's joints turn at most so fast, radians per second."""
HOMING = 0.8
"""The arm's joints turn at most so fast on the way home, radians per second."""
FASTEST = 0.25
"""Of the tool on the way home unless `limit` says otherwise, metres per second."""
SAMPLES = 41
"""Points of the way home at which the tool's speed is looked at."""
CLEAR = 0.05
"""The tool leaves the box straight up until it is so far above its rim, metres."""
LIFTING = 0.1
"""Speed on that way, metres per second."""


def _commanded(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command that another thread may stop from its first moment on, planning included."""

    @wraps(command)
    def run(self: "MuJoCoArm", *given: Any, **named: Any) -> Any:
        if self._mover is not None:  # part of another command
            return command(self, *given, **named)
        self._mover = threading.get_ident()
        try:
            return command(self, *given, **named)
        finally:
            self._mover = None
            self._halt.clear()

    return run


class MuJoCoArm(NoHardware):
    """Moves the twin's arm and hand."""

    name = "KUKA LBR iiwa 14 with a five-finger hand (MuJoCo)"
    slowness = 30.0
    """The physics is compiled first, and then slower than the clock."""

    def __init__(self, twin: Twin):
        """An arm over a twin's bed."""
        self.twin = twin
        self._hard, self._fastest = HARD, FASTEST
        self.watch: Callable[[Twin], None] = lambda twin: None
        """Called after every step of the physics, for pictures and measurements."""
        self._tool = np.eye(4)
        self._doing: Doing | None = None
        self._stroke: BedStroke | None = None  # what it does to the bed
        self._mover: int | None = None  # the thread that moves it
        self._halt = threading.Event()  # another thread wants it to stand still

    def limit(self, *, effort: float, speed: float) -> None:
        """Stop at this effort; bring the tool home no faster than this."""
        self._hard, self._fastest = effort, speed

    def check(self, poses: Sequence[Pose], postures: Sequence[str], tool: Pose) -> None:
        """Inverse kinematics along all of the lines, from where the arm is."""
        for name in postures:
            if name not in fingers.POSTURES:
                raise ArmError(str(UnknownName("posture", name, fingers.POSTURES)))
        joints, flange = self.twin.target, np.linalg.inv(np.asarray(tool, float))
        for pose in poses:
            joints = self.twin.reach.line(joints, np.asarray(pose, float) @ flange)[1][-1]

    @_commanded
    def begin(self, doing: Doing, tool: Pose) -> None:
        """Remember the tool; when the act begins, work out what it will do to the bed.

        Raises:
          ArmError: a path that the action does not have in the twin, or the other way round.
        """
        self._finish()
        by_hand = pours(doing)
        self._doing, self._tool = doing, np.asarray(tool, float)
        if by_hand and doing.operation == "act":
            self._begin_stroke(doing, self.pose())

    @_commanded
    def move(self, pose: Pose, *, speed: float, threshold: float) -> Moved:
        """Bring the tool there along a straight line, or as far as the effort allows."""
        flange = np.asarray(pose, float) @ np.linalg.inv(self._tool)
        length, joints = self.twin.reach.line(self.twin.target, flange)
        doing = self._doing
        if doing and doing.operation == "act" and self._stroke is None:
            self._begin_stroke(doing, np.asarray(pose, float))
        seconds = max(PEAK * length / speed, SLOWEST)
        spline = CubicSpline(np.linspace(0.0, 1.0, len(joints)), joints)
        return self._follow(spline, seconds, threshold)

    @_commanded
    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """Give the hand a posture; a turn of the wrist may take longer than `seconds`."""
        try:
            first, last = self.twin.grip, fingers.angles(name)
        except UnknownName as problem:
            raise ArmError(str(problem)) from None
        seconds = max(seconds, PEAK * np.abs(last - first).max() / TURNS)

        def step(share: float, rate: float) -> float:
            self.twin.grip = first + share * (last - first)
            if self._stroke is not None:
                self._stroke.close(share)
            return self.twin.step()

        return self._run(step, seconds, threshold)

    @_commanded
    def home(self) -> Moved:
        """Up, and lead the joints to where the camera looks straight down at the bed."""
        self._finish()
        self._lift()
        first, last = self.twin.target, self.twin.home
        spline = CubicSpline([0.0, 1.0], np.stack([first, last]))
        # Joints that turn slowly may still sweep the hand along a wide arc.
        shares = np.linspace(0.0, 1.0, SAMPLES)
        poses = np.stack([self.twin.reach.pose(spline(share)) for share in shares])
        ways = np.diff(np.stack([poses, poses @ self._tool])[..., :3, 3], axis=1)
        steepest = (SAMPLES - 1) * np.linalg.norm(ways, axis=-1).max()
        seconds = PEAK * max(np.abs(last - first).max() / HOMING, steepest / self._fastest)
        return self._follow(spline, max(seconds, SLOWEST), self._hard)

    def pose(self) -> Pose:
        """Of the tool now, from the physics."""
        return self.twin.flange() @ self._tool

    def stop(self) -> None:
        """Hold still; the bed stays as it is now."""
        if self._mover not in (None, threading.get_ident()):
            self._halt.set()  # the thread that steps the physics stands still at its next tick
            return
        self.twin.halt()
        self._finish()

    def _lift(self) -> None:
        """Straight up out of the box, should the tool still be in it."""
        pose = self.pose()
        if pose[2, 3] < FLOOR + RIM + CLEAR:
            pose[2, 3] = FLOOR + RIM + CLEAR
            with suppress(PoseRefused):  # then the joints' way has to do
                self._doing = None
                self.move(pose, speed=LIFTING, threshold=self._hard)

    def _follow(self, spline: CubicSpline, seconds: float, threshold: float) -> Moved:
        twin, speed = self.twin, spline.derivative()

        def step(share: float, rate: float) -> float:
            twin.target = spline(share)
            if self._stroke is not None:
                self._stroke.down(self.pose())
            return twin.step(speed(share) * rate)

        return self._run(step, seconds, threshold)

    def _run(
        self, step: Callable[[float, float], float], seconds: float, threshold: float
    ) -> Moved:
        """Step until the end, the threshold or the hard limit.

        `step` is given the share of the motion and its rate per second: a smooth start and end
        (the polynomial of least jerk), so that accelerations stay far below contact efforts.
        """
        tick = self.twin.model.opt.timestep
        count, rest = max(int(np.ceil(seconds / tick)), 1), int(SETTLE / tick)
        greatest = 0.0
        for n in range(1, count + rest + 1):
            t = min(n / count, 1.0)
            share, rate = t**3 * (10 - 15 * t + 6 * t**2), 30 * (t * (1 - t)) ** 2 / seconds
            effort = step(share, rate)
            greatest = max(greatest, effort)
            self.watch(self.twin)
            if self._halt.is_set():
                self.stop()
                raise ArmError(f"{self.name}: stopped")
            if effort > self._hard:
                self.stop()
                said = f"contact effort {effort:.0f} Nm; the arm stops at {self._hard:g}"
                raise EffortLimit(said)
            if effort > threshold:
                self.twin.halt()
                return Moved(True, greatest, self.pose())
        return Moved(False, greatest, self.pose())

    def _begin_stroke(self, doing: Doing, end: Pose) -> None:
        """What the act does to the bed, on its way from where the tool is."""
        try:
            self._stroke = BedStroke(self.twin, doing, self.pose(), end)
        except (UnknownName, BadPosition) as problem:
            raise ArmError(str(problem)) from None

    def _finish(self) -> None:
        if (stroke := self._stroke) is not None:
            self._stroke = None
            stroke.finish()


class Ready(NamedTuple):
    """A robot at home, the bed in its camera's view; `arm.twin` is the world behind both."""

    arm: MuJoCoArm
    camera: MuJoCoCamera
    base_camera: Pose
    """Pose of the camera in the arm's base frame."""


def make_twin(
    key: Key[Array, ""] | int,
    bed: sim.Bed,
    material: str | sim.Material = "flour",
    obstacle: Obstacle | None = None,
    *,
    camera: Camera = D435_BAZAR,
    noise: float = 0.00045,
    spread: float = 0.0,
    stock_cm3: float = 0.0,
) -> Ready:
    """The arm and the camera of a new twin over a bed, whose size is the box's.

    Args:
      key: of all that is random, or a seed.
      bed: as it is at first.
      material: of the bed.
      obstacle: something rigid in the bed.
      camera: size and intrinsics of the depth camera.
      noise: of the camera at 0.45 m, metres; 0 for a perfect one.
      spread: factor on how much the robot's actions vary beyond what the physics does.
      stock_cm3: loose material in a stock beside the bed, which pours may bring.

    Raises:
      UnknownName: no such material.
      JShapeError: MuJoCo or mink is not installed.
    """
    key = jax.random.key(key) if isinstance(key, int) else key
    for_actions, for_camera = jax.random.split(key)
    twin = Twin(for_actions, bed, sim.read_material(material), camera, obstacle, spread, stock_cm3)
    eye = MuJoCoCamera(twin, for_camera, noise)
    return Ready(MuJoCoArm(twin), eye, twin.base_camera)


def open_twin(address: str, settings: ArmSettings) -> OpenedArm:
    """The twin over the levelled bed of a seed in the paper's box, and the camera on its wrist.

    Raises:
      BadCamera: cameras that stand elsewhere.
    """
    if settings.cameras:
        raise BadCamera(
            "the arm mujoco sees through the camera on its wrist, which --camera-file does not move"
        )
    bed, key, _ = bed_of(seed_of(address, "mujoco"), size=BOX)
    return OpenedArm(*make_twin(key, bed, settings.material, stock_cm3=settings.stock_cm3))
