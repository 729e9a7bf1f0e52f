"""Frames that come out of an iterator, as a camera: what recordings and pictures have in common."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import numpy as np

from jshape._typing import Num
from jshape.camera import Camera
from jshape.robot.cameras.base import CameraLost, EndOfFrames


class Played(AbstractContextManager):
    """A camera over frames that are made or read one after another."""

    def __init__(
        self,
        name: str,
        camera: Camera,
        depth_unit: float,
        frames: Iterator[np.ndarray],
        *,
        count: int | None = None,
        still: bool = False,
        live: bool = False,
        close: Callable[[], None] | None = None,
    ):
        """A camera.

        Args:
          name: what people call it.
          camera: of the frames.
          depth_unit: metres per count.
          frames: (H, W) uint16 counts each, 0 = no reading.
          count: how many there are, where that is known.
          still: the same frame again and again is what it should send.
          live: frames come from now, not from a recording.
          close: lets go of what the frames are read from.
        """
        self.name = name
        self.camera = camera
        self.depth_unit = depth_unit
        self.count = count
        self.still = still
        self.live = live
        self._frames: Iterator[np.ndarray] | None = frames
        self._close = close

    def frame(self) -> Num[np.ndarray, "H W"]:
        """The next frame, counts of `depth_unit`.

        Raises:
          EndOfFrames: there is none.
          CameraLost: it was closed, or is live and has sent its last.
          BadFile, BadDataset, BadImage: what is read is damaged here.
        """
        if self._frames is None:
            raise CameraLost(f"{self.name}: was closed")
        counts = next(self._frames, None)
        if counts is None:
            end = CameraLost if self.live else EndOfFrames
            raise end(f"{self.name}: has no more frames")
        return counts

    def close(self) -> None:
        """Let go of the frames; a second time does nothing."""
        if self._frames is not None:
            self._frames = None
            if self._close is not None:
                self._close()

    def __exit__(self, *problem: object) -> None:
        self.close()
