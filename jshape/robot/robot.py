"""Depth cameras and an arm as one world to act in."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack

import numpy as np

from jshape._typing import Float
from jshape.actions import Place, PlacedAction
from jshape.camera import Camera
from jshape.data.fusion import NOISE, check_poses
from jshape.data.missing import fill_missing, median_of
from jshape.data.view import View, cut_of, look_of
from jshape.errors import JShapeError
from jshape.robot.arms.base import Arm, stop_arm
from jshape.robot.arms.guarded import GuardedArm
from jshape.robot.cameras.base import FRAMES, DepthCamera, look
from jshape.robot.cameras.guarded import GuardedCamera
from jshape.robot.checks import check_clear
from jshape.robot.perform import OperationResult, perform
from jshape.robot.procedure import Hand, surface_point


class Robot(AbstractContextManager):
    """Looks with one camera or several, acts with an arm; a `World` of the loop."""

    def __init__(
        self,
        depth_camera: DepthCamera | GuardedCamera,
        arm: Arm | GuardedArm,
        hand: Hand,
        camera: Camera,
        *,
        base_camera: Float[np.ndarray, "4 4"] | None = None,
        others: Sequence[DepthCamera | GuardedCamera] = (),
        frames: int = FRAMES,
        on_operation: Callable[[OperationResult], None] = lambda done: None,
        on_look: Callable[[np.ndarray], None] = lambda depth: None,
    ):
        """A robot whose looks are those of a bank's camera.

        Args:
          depth_camera: takes the frames; behind deadlines from now on, like the arm.
          arm: acts.
          hand: the procedures of its actions, and its limits.
          camera: the bank's.
          base_camera: pose of `depth_camera` in the arm's base frame; None: they are the same.
          others: more cameras, whose looks are fused with its own; each of them all has a pose, in
            one frame.
          frames: of which a look is the median.
          on_operation: called after each operation of an action.
          on_look: called with each look (H, W), metres.

        Raises:
          BadCamera: several cameras, of which one has no pose.
        """
        eyes = (depth_camera, *others)
        self._eyes = [e if isinstance(e, GuardedCamera) else GuardedCamera(e) for e in eyes]
        self.depth_camera = self._eyes[0].inside
        """The (first) camera, for what it says of itself."""
        check_poses([eye.camera for eye in self._eyes], [eye.name for eye in self._eyes])
        self.guard = arm if isinstance(arm, GuardedArm) else GuardedArm(arm)
        """The way to the arm: every call goes through it, STOP too."""
        self.camera, self.base_camera = camera, base_camera
        self.on_operation, self.on_look = on_operation, on_look
        self.moved = False
        """The arm was told to move."""
        self.noise_mm = float("nan")
        """Of a D435's frame from where the farthest camera was in the last look."""
        self.view: View | None = None
        """How looks become those of the bank's camera; None: they hold its image."""
        self._hand, self._frames = hand, frames
        self._seen: np.ndarray | None = None  # (H, W) the last look
        self._whole: np.ndarray | None = None  # the same without gaps, once it was asked for

    @property
    def arm(self) -> Arm:
        """The arm itself; commands go through `guard`."""
        return self.guard.arm

    @property
    def several(self) -> bool:
        """Whether more than one camera looks: then the bed is always seen from above."""
        return len(self._eyes) > 1

    @property
    def eyes(self) -> str:
        """The names of all cameras."""
        return " + ".join(eye.name for eye in self._eyes)

    def frame(self) -> Float[np.ndarray, "H W"]:
        """What the (first) camera itself sees, metres; NaN or 0 = no reading.

        Raises CameraLost.
        """
        return look(self._eyes[0], self._frames)

    def look(self) -> Float[np.ndarray, "H W"]:
        """Depth in metres as the bank's camera sees it; NaN or 0 = no reading.

        Raises:
          CameraLost: a camera sends nothing, or always the same.
          BadCamera: the camera is not the bank's, and no view says how it is seen; or one of
            several was moved.
          Occluded: something is in front of the bed.
        """
        depth = self.frame()
        if self.view is None:
            source = self.depth_camera.camera
            self.view = View(source, self.camera, cut_of(source, self.camera))
        others = [look_of(look(eye, self._frames), eye.camera) for eye in self._eyes[1:]]
        seen = self.view.depth(depth, self.eyes, others)
        depths = (depth, *(other.depth for other in others))
        farthest = max(median_of(np.where(d > 0, d, np.nan)) for d in depths)
        self.noise_mm = 1e3 * NOISE * farthest**2
        check_clear(seen, self.camera, self.eyes)
        self._seen, self._whole = seen, None
        self.on_look(seen)
        return seen

    def act(
        self,
        action: str,
        position: Place,
        strength: float = 1.0,
        yaw: float = 0.0,
        length: float = 1.0,
    ) -> None:
        """Carry an action out at pixel (u, v) of the bank's image; ArmError: it did not."""
        self.moved = True
        self._perform(action, position, strength, yaw, length)

    def check(self, act: PlacedAction) -> None:
        """Whether it could carry an action out; nothing moves.  Raises as `act`."""
        how = act.strength, act.yaw, act.length
        self._perform(act.action, act.position, *how, only_check=True)

    def _perform(
        self,
        action: str,
        position: Place,
        *how: float,
        only_check: bool = False,
    ) -> None:
        """`how` is strength, yaw and length."""
        if self._seen is None or self.view is None:
            raise JShapeError("look before you act")
        if self._whole is None:  # once a look: a plan's actions are all checked on the first
            self._whole, _ = fill_missing(self._seen, limit=1.0, where=self.eyes)
        procedure = self._hand.procedures.get(action)
        beside = (0.0, 0.0) if procedure is None else procedure.begins(*how[1:])
        point = surface_point(self._whole, self.camera, position, beside=beside)
        base_camera = np.eye(4) if self.base_camera is None else self.base_camera
        perform(
            self.guard, self._hand, action, point, base_camera @ self.view.to_source, *how,
            on_operation=self.on_operation, only_check=only_check,
        )  # fmt: skip

    def home(self) -> None:
        """Bring the arm out of the camera's view; ArmError: it did not."""
        limits = self._hand.limits
        self.guard.limit(effort=limits.effort_nm, speed=limits.speed_mm_s / 1000.0)
        self.moved = True
        self.guard.home()

    def close(self) -> None:
        """Stop the arm, let go of both."""
        try:
            stop_arm(self.guard)
            self.guard.close()
        finally:
            with ExitStack() as stack:  # all of them, whatever the first ones raise
                for eye in self._eyes:
                    stack.callback(eye.close)

    def __exit__(self, *problem: object) -> None:
        self.close()
