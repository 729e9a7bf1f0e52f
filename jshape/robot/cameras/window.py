"""A window of another camera's frames: the box without the table around it."""

from contextlib import AbstractContextManager

import numpy as np

from jshape._typing import Num
from jshape.robot.cameras.base import DepthCamera


class Window(AbstractContextManager):
    """A camera that shows a window of another one's frames; its principal point moves with it."""

    def __init__(self, inside: DepthCamera, left: int, top: int, width: int, height: int):
        """A window, in pixels of the other camera.

        Raises:
          BadCamera: it is empty or leaves the image.
        """
        self.camera = inside.camera.crop(left, top, width, height)
        self.whole = inside.camera
        """The other camera's, whose frames the window is cut out of."""
        self.name = inside.name
        self.depth_unit = inside.depth_unit
        self.still = bool(getattr(inside, "still", False))
        self.live = bool(getattr(inside, "live", False))
        self.count = getattr(inside, "count", None)
        self._inside = inside
        self._part = np.s_[top : top + height, left : left + width]

    def frame(self) -> Num[np.ndarray, "H W"]:
        """The window of the next frame.  Raises as the other camera does."""
        return np.ascontiguousarray(self._inside.frame()[self._part])

    def close(self) -> None:
        """Close the other camera."""
        self._inside.close()

    def __exit__(self, *problem: object) -> None:
        self.close()
