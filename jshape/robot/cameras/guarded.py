"""The one way to a robot's camera: a driver that hangs is noticed."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from jshape._typing import Num
from jshape.robot.cameras.base import CameraLost, DepthCamera, still
from jshape.robot.worker import Worker

HANGS = 30.0
"""Seconds after which a frame is waited for no longer.  A device says after `TIMEOUT` (5 s) that
nothing came; a simulated camera compiles for some seconds first."""
CLOSING = 5.0
"""Seconds that anybody waits for `close`."""


class GuardedCamera(AbstractContextManager):
    """Takes a camera's frames on a thread of its own, each within a deadline."""

    def __init__(self, inside: DepthCamera, *, hangs: float = HANGS, closing: float = CLOSING):
        """Guard a camera: all frames are taken from one thread."""
        self.inside = inside
        self.name, self.camera, self.depth_unit = inside.name, inside.camera, inside.depth_unit
        self.still = still(inside)
        self._hangs, self._closing = hangs, closing
        self._worker = Worker(self.name)

    def frame(self) -> Num[np.ndarray, "H W"]:
        """As the camera's.

        Raises:
          CameraLost: as the camera's; nothing came in time, or its driver raised something.
        """
        return self._made(self._worker, "frame", self.inside.frame, self._hangs)

    def close(self) -> None:
        """As the camera's, within `CLOSING` seconds; beside a frame that hangs.

        Raises:
          CameraLost: it has not ended by then, or raised something.
        """
        worker = self._worker if self._worker.busy is None else Worker(self.name)
        try:
            self._made(worker, "close", self.inside.close, self._closing)
        finally:
            worker.end()
            self._worker.end()

    def __exit__(self, *problem: object) -> None:
        self.close()

    def _made(self, worker: Worker, what: str, function: Callable[[], Any], seconds: float) -> Any:
        call = worker.begin(what, function)
        try:
            call.wait(seconds)
        finally:  # Ctrl-C too: nobody waits for it any more
            call.settle(
                problem=CameraLost(f"{self.name}: {what} has not ended after {seconds:g} s")
            )
        return call.result(self.name, CameraLost)
