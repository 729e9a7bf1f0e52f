"""An arm that only says what it would do."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from jshape.robot.arms.base import ArmSettings, Doing, Moved, NoHardware, OpenedArm
from jshape.robot.rigid import Pose, yaw_of


class DryRun(NoHardware):
    """Says every motion and makes none: for reading a plan, and for trying everything but the arm.

    The limits are checked before (`procedure.check_reach`), as for any arm.
    """

    name = "dry run"

    def __init__(self, say: Callable[[str], object] = print):
        """`say` is given each line."""
        self._tell, self._pose, self._stands = say, np.eye(4), True

    def begin(self, doing: Doing, tool: Pose) -> None:
        """Say what comes."""
        way = f", {1000 * doing.way:.0f} mm of way" if doing.way else ""
        self._say(f"{doing.action} x{doing.strength:.2f}{way}: {doing.operation}")

    def move(self, pose: Pose, *, speed: float, threshold: float) -> Moved:
        """Say where it would go."""
        self._pose = np.array(pose)
        x, y, z = pose[:3, 3] * 1000.0
        turn = np.degrees(yaw_of(pose))
        self._say(
            f"  tool to ({x:.1f}, {y:.1f}, {z:.1f}) mm, {turn:.0f}°, {speed * 1000:.0f} mm/s, "
            f"until {threshold:g} Nm"
        )
        return Moved(False, 0.0, self.pose())

    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """Say what the hand would do."""
        self._say(f"  hand: {name}, {seconds:g} s, until {threshold:g} Nm")
        return Moved(False, 0.0, self.pose())

    def home(self) -> Moved:
        """Say so."""
        self._pose = np.eye(4)
        self._say("  home")
        return Moved(False, 0.0, self.pose())

    def pose(self) -> Pose:
        """Where it would be."""
        return self._pose.copy()

    def stop(self) -> None:
        """Say so once after anything else, if anybody still listens."""
        with suppress(OSError):
            if not self._stands:
                self._say("  stop")
                self._stands = True

    def _say(self, line: str) -> None:
        self._stands = False
        self._tell(line)


def open_dry_run(address: str, settings: ArmSettings) -> OpenedArm:
    """The arm that says its motions where the settings want them said."""
    return OpenedArm(DryRun(settings.say), moves=False)
