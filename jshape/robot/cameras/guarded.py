"""The one way to a robot's camera: a driver that hangs is noticed."""

from contextlib import AbstractContextManager

import numpy as np

from jshape._typing import Num
from jshape.robot.cameras.base import CameraLost, DepthCamera, traits_of
from jshape.robot.worker import Worker


class GuardedCamera(AbstractContextManager):
    """Takes a camera's frames on a thread of its own, each within a deadline."""

    hangs = 30.0
    """Seconds after which a frame is waited for no longer.  A device says after `TIMEOUT` (5 s)
    that nothing came; a simulated camera compiles for some seconds first."""
    closing = 5.0
    """Seconds that anybody waits for `close`."""

    def __init__(self, inside: DepthCamera):
        """Guard a camera: all frames are taken from one thread."""
        self.inside = inside
        self.name, self.camera, self.depth_unit = inside.name, inside.camera, inside.depth_unit
        self.still = traits_of(inside).still
        self._worker = Worker(self.name, CameraLost, CameraLost)

    def frame(self) -> Num[np.ndarray, "H W"]:
        """As the camera's; CameraLost too if nothing came in time, or its driver raised."""
        return self._worker.within(self.hangs, "frame", self.inside.frame)

    def close(self) -> None:
        """As the camera's, beside a frame that hangs; CameraLost if it does not end, or raises."""
        self._worker.close(self.closing, self.inside.close)

    def __exit__(self, *problem: object) -> None:
        self.close()
