"""What an arm with a hand is.

Poses are 4x4 matrices in the arm's base frame, metres.  The tool frame is the point of the hand
that touches the material; at yaw 0 it is parallel to the camera's: x to the right of the image, y
down the image, z into the bed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

from jshape.camera import Camera
from jshape.errors import JShapeError
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.rigid import Pose
from jshape.robot.signals import uninterrupted
from jshape.sim.material import Material

POSTURES = (
    *("claw", "closed", "fist", "side", "point", "pinch_open", "pinch_closed"),
    *("cup", "open"),
)
"""What the bundled files of actions ask of a hand."""


class ArmError(JShapeError):
    """An arm that did not do what it was told."""


class PoseRefused(ArmError):
    """A pose beyond the workspace or the joints' limits, or without inverse kinematics."""


class EffortLimit(ArmError):
    """A contact effort above the hard limit: the arm is stopped at once."""


class ArmLost(ArmError):
    """An arm that does not answer: a call is overdue."""


class Moved(NamedTuple):
    """How a motion ended."""

    contact: bool
    """The effort rose above the threshold, which ended the motion before its end."""
    effort: float
    """The greatest contact effort on the way, |joint torque - what gravity needs|, Nm: a magnitude,
    finite, from 0."""
    pose: Pose
    """Of the tool, where it ended."""


class Doing(NamedTuple):
    """What an arm is told before each operation; a real one may log it or leave it."""

    action: str
    operation: str
    """One of the six: above, prepare, contact, act, up, clear."""
    strength: float
    """How many times as deep as the trained action."""
    yaw: float
    """Turn of the hand from u towards v, radians."""
    length: float = 1.0
    """How many times as long as the trained action's the path of the act is."""
    way: float = 0.0
    """How far the act goes along the hand's x, metres; its moves follow one after the other."""


@runtime_checkable
class Arm(Protocol):
    """An arm with a hand.  Whatever raises leaves it at rest.

    All calls but `stop` come from one thread, one after the other; `GuardedArm` says how long each
    may take.  A simulation may have a `slowness`: it is given so many times as long.
    """

    name: str
    """What people call it."""

    def limit(self, *, effort: float, speed: float) -> None:
        """What no motion may exceed from now on, the way home included.

        At a contact effort in Nm above `effort` it stops at once and raises `EffortLimit`; the tool
        is no faster than `speed`, metres per second.
        """
        ...

    def check(self, poses: Sequence[Pose], postures: Sequence[str], tool: Pose) -> None:
        """Whether the tool can go to these poses one after the other; nothing moves.

        Raises:
          PoseRefused: a pose that it cannot reach.
          ArmError: a posture that it does not know.
        """
        ...

    def begin(self, doing: Doing, tool: Pose) -> None:
        """Told before each operation.

        `tool` is the pose of the tool frame in the hand's flange frame, for the action's posture.
        """
        ...

    def move(self, pose: Pose, *, speed: float, threshold: float) -> Moved:
        """Bring the tool to a pose along a straight line; end early at contact.

        Args:
          pose: of the tool in the base frame.
          speed: metres per second.
          threshold: contact effort in Nm that ends the motion.

        Raises:
          PoseRefused: it cannot go there.
          EffortLimit: an effort above the hard limit.
          ArmError: anything else that kept it from moving.
        """
        ...

    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """Give the hand one of `POSTURES`, or of those in your own files; end early at contact.

        Raises:
          ArmError: no such posture, or it did not do it.
        """
        ...

    def home(self) -> Moved:
        """Go to the pose in which the camera sees the whole bed: from wherever it is, up first.

        Raises as `move`.
        """
        ...

    def pose(self) -> Pose:
        """Of the tool now, base frame."""
        ...

    def stop(self) -> None:
        """Stand still at once.  Always possible, never raises, and always the last call.

        It comes from another thread, at any time and as often as somebody likes.  A motion that is
        under way then ends and raises `ArmError`.  Where a driver lets only one thread speak to the
        controller, `move` asks a flag that this sets, or this has a connection of its own: an arm
        that `stop` reaches only when its motion has ended cannot be stopped.
        """
        ...

    def close(self) -> None:
        """Let go of the hardware, after `stop`."""
        ...


class NoHardware:
    """What an arm that moves nothing real need not say: it can do all, and stands already."""

    def limit(self, *, effort: float, speed: float) -> None:
        """Nothing exceeds it."""

    def check(self, poses: Sequence[Pose], postures: Sequence[str], tool: Pose) -> None:
        """It can do all of it."""

    def stop(self) -> None:
        """It stands already."""

    def close(self) -> None:
        """Nothing to let go of."""


class ArmSettings(NamedTuple):
    """What people say of an arm beside its name; each kind takes what concerns it."""

    camera: Camera
    """The bank's; the camera above a simulated bed is like it."""
    material: str | Material = "flour"
    """Of a simulated bed."""
    say: Callable[[str], object] = print
    """Told what a dry run would do."""
    cameras: Sequence[Camera] = ()
    """That look at a simulated bed, each from its pose in the bed's frame; none: one like
    `camera`."""
    stock_cm3: float = 0.0
    """Of loose material beside a simulated bed."""


@dataclass(frozen=True)
class OpenedArm:
    """An arm, and what comes with it."""

    arm: Arm
    depth_camera: DepthCamera | None = None
    """The camera above its own bed, which simulations bring."""
    base_camera: Pose | None = None
    """Pose of that camera in the arm's base frame."""
    others: Sequence[DepthCamera] = ()
    """More cameras above that bed."""
    moves: bool = True
    """False: it only says what it would do, and needs to know of no camera."""


def stop_arm(arm: Arm) -> str | None:
    """Stop an arm whatever it does about it; what went wrong with that, in one line.

    A second Ctrl-C does not cut it short.
    """
    try:
        with uninterrupted():
            arm.stop()
    except ArmError as problem:  # one that was waited for, and says so itself
        return str(problem)
    except Exception as problem:  # a broken driver: there is nothing left but to say so
        return f"{arm.name}: did not stop: {type(problem).__name__}: {problem}"
    return None
