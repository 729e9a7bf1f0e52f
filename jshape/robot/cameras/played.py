"""Frames that come out of an iterator, as a camera: what recordings and pictures have in common."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import numpy as np

from jshape._typing import Num
from jshape.camera import Camera
from jshape.robot.cameras.base import CameraLost, DepthCamera, EndOfFrames, traits_of


class Played(AbstractContextManager):
    """A camera over frames that are made or read one after another."""

    def __init__(
        self,
        name: str,
        camera: Camera,
        depth_unit: float,
        frames: Iterator[np.ndarray],
        *,
        still: bool = False,
        live: bool = False,
        close: Callable[[], object] = lambda: None,
        whole: Camera | None = None,
    ):
        """A camera.

        Args:
          name: what people call it.
          camera: of the frames.
          depth_unit: metres per count.
          frames: (H, W) uint16 counts each, 0 = no reading.
          still: the same frame again and again is what it should send.
          live: frames come from now, not from a recording.
          close: lets go of what the frames are read from.
          whole: the camera that the frames are cut out of; None: `camera`.
        """
        self.name, self.camera, self.depth_unit = name, camera, depth_unit
        self.still, self.live, self.whole = still, live, whole or camera
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
            self._close()

    def __exit__(self, *problem: object) -> None:
        self.close()


def calls(frame: Callable[[], np.ndarray]) -> Iterator[np.ndarray]:
    """What a function returns, again and again; unlike a generator it goes on after an error."""
    return map(lambda _: frame(), itertools.repeat(None))


def windowed(inside: DepthCamera, left: int, top: int, width: int, height: int) -> Played:
    """A window of another camera's frames, in its pixels: the box without the table around it.

    Raises:
      BadCamera: it is empty or leaves the image.
    """
    part = np.s_[top : top + height, left : left + width]
    return Played(
        inside.name,
        inside.camera.crop(left, top, width, height),
        inside.depth_unit,
        calls(lambda: np.ascontiguousarray(inside.frame()[part])),
        still=traits_of(inside).still,
        live=traits_of(inside).live,
        close=inside.close,
        whole=inside.camera,
    )
