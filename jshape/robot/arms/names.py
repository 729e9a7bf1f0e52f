"""Arms by what people write on the command line: `NAME` or `NAME:ADDRESS`."""

from jshape.robot.arms.base import ArmSettings, OpenedArm
from jshape.robot.arms.dry_run import open_dry_run
from jshape.robot.arms.mujoco import open_twin
from jshape.robot.arms.simulated import open_simulated
from jshape.robot.registry import DeviceKind, open_device

ARMS: dict[str, DeviceKind[ArmSettings, OpenedArm]] = {
    "dry": DeviceKind(open_dry_run, "says what it would do; needs a camera"),
    "sim": DeviceKind(open_simulated, "a hand over a simulated bed, with its camera", "[:SEED]"),
    "mujoco": DeviceKind(open_twin, "the robot's physics twin, with its camera", "[:SEED]"),
}
"""Every kind of arm; a new one is a file and a row here."""


def open_arm(text: str, settings: ArmSettings) -> OpenedArm:
    """The arm that `NAME` or `NAME:ADDRESS` of `ARMS` names.

    Raises:
      JShapeError: no such arm, or an address that it does not take.
    """
    return open_device(text, ARMS, settings, "an arm")
