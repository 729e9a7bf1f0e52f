"""An arm that a person can stop while another thread moves it."""

import threading
from collections.abc import Sequence

import numpy as np

from jshape._typing import Float
from jshape.robot.arms.base import Arm, ArmError, Doing, Moved, stop_arm


class Interruptible:
    """Passes everything on to an arm until `interrupt`; from then on every command is refused.

    The motion under way is ended by the arm's own `stop`, which may come from another thread.
    """

    def __init__(self, arm: Arm):
        """Guard an arm."""
        self.arm = arm
        self.name = arm.name
        self._stopped = threading.Event()

    def interrupt(self) -> str | None:
        """Stop now, from any thread; what went wrong with that, in one line."""
        self._stopped.set()
        return stop_arm(self.arm)

    def _allowed(self) -> None:
        if self._stopped.is_set():
            raise ArmError(f"{self.name}: stopped by a person")

    def limit(self, *, effort: float, speed: float) -> None:
        """As the arm's; refused once it was stopped, as all that follow."""
        self._allowed()
        self.arm.limit(effort=effort, speed=speed)

    def check(
        self,
        poses: Sequence[Float[np.ndarray, "4 4"]],
        postures: Sequence[str],
        tool: Float[np.ndarray, "4 4"],
    ) -> None:
        """As the arm's."""
        self._allowed()
        self.arm.check(poses, postures, tool)

    def begin(self, doing: Doing, tool: Float[np.ndarray, "4 4"]) -> None:
        """As the arm's."""
        self._allowed()
        self.arm.begin(doing, tool)

    def move(self, pose: Float[np.ndarray, "4 4"], *, speed: float, threshold: float) -> Moved:
        """As the arm's; one that was stopped on its way does not count as done."""
        self._allowed()
        moved = self.arm.move(pose, speed=speed, threshold=threshold)
        self._allowed()
        return moved

    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """As the arm's, like `move`."""
        self._allowed()
        moved = self.arm.posture(name, seconds=seconds, threshold=threshold)
        self._allowed()
        return moved

    def home(self) -> Moved:
        """As the arm's, like `move`."""
        self._allowed()
        moved = self.arm.home()
        self._allowed()
        return moved

    def effort(self) -> float:
        """As the arm's."""
        return self.arm.effort()

    def pose(self) -> Float[np.ndarray, "4 4"]:
        """As the arm's."""
        return self.arm.pose()

    def stop(self) -> None:
        """As the arm's."""
        self.arm.stop()

    def close(self) -> None:
        """As the arm's."""
        self.arm.close()
