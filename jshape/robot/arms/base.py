"""What an arm with a hand is.

Poses are 4x4 matrices in the arm's base frame, metres.  The tool frame is the point of the hand
that touches the material; at yaw 0 it is parallel to the camera's: x to the right of the image, y
down the image, z into the bed.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jshape._typing import Float
from jshape.errors import JShapeError


class ArmError(JShapeError):
    """An arm that did not do what it was told."""


class PoseRefused(ArmError):
    """A pose beyond the workspace or the joints' limits, or without inverse kinematics."""


class EffortLimit(ArmError):
    """A contact effort above the hard limit: the arm is stopped at once."""


class Moved(NamedTuple):
    """How a motion ended."""

    contact: bool
    """The effort rose above the threshold, which ended the motion before its end."""
    effort: float
    """The greatest contact effort on the way, Nm."""
    pose: Float[np.ndarray, "4 4"]
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


@runtime_checkable
class Arm(Protocol):
    """An arm with a hand.  Whatever raises leaves it at rest."""

    name: str
    """What people call it."""

    def begin(self, doing: Doing, tool: Float[np.ndarray, "4 4"]) -> None:
        """Told before each operation.

        Args:
          doing: what comes.
          tool: pose of the tool frame in the hand's flange frame, for the action's posture.
        """
        ...

    def move(self, pose: Float[np.ndarray, "4 4"], *, speed: float, threshold: float) -> Moved:
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
        """Give the hand a posture; end early at contact.

        Args:
          name: claw, fist, point, pinch_open, pinch_closed, side or flat.
          seconds: how long it takes.
          threshold: contact effort in Nm that ends it.

        Raises:
          ArmError: no such posture, or it did not do it.
        """
        ...

    def home(self) -> None:
        """Go to the pose in which the camera sees the whole bed.  Raises as `move`."""
        ...

    def effort(self) -> float:
        """The contact effort now: the greatest |joint torque - what gravity needs|, Nm."""
        ...

    def pose(self) -> Float[np.ndarray, "4 4"]:
        """Of the tool now, base frame."""
        ...

    def stop(self) -> None:
        """Stand still at once.  Always possible, never raises, and always the last call."""
        ...

    def close(self) -> None:
        """Let go of the hardware, after `stop`."""
        ...
