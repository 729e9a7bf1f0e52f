"""What a bystander sees of the twin: pictures in colour, and strips of them."""

import weakref
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

import cv2
import numpy as np

from jshape._typing import Num
from jshape.robot.cameras.mujoco import upload_bed
from jshape.robot.twin.engine import mujoco, renderer
from jshape.robot.twin.world import Twin

SIZE = (480, 400)
"""Of a picture (width, height), pixels."""


class Bystander(AbstractContextManager):
    """A colour camera that stands beside the box; a context manager."""

    def __init__(
        self,
        twin: Twin,
        *,
        size: tuple[int, int] = SIZE,
        azimuth: float = 150.0,
        elevation: float = -22.0,
        distance: float = 1.0,
        raised: float = 0.16,
    ):
        """A bystander who looks at a point above the box.

        Args:
          twin: what is looked at.
          size: (width, height) in pixels.
          azimuth: direction of the look about the vertical, degrees; 0 looks along the base's x.
          elevation: above the horizon, degrees; negative looks down.
          distance: from that point, metres.
          raised: how high it is above the floor of the box, metres.

        Raises:
          NoPicture: MuJoCo cannot draw here.
        """
        engine = mujoco()
        self._twin, self._shown = twin, -1
        self._renderer = renderer(twin.model, *size)
        self._end = weakref.finalize(self, self._renderer.close)
        self._camera: Any = engine.MjvCamera()
        self._camera.azimuth, self._camera.elevation = azimuth, elevation
        self._camera.distance = distance
        self.look_at(raised=raised)

    def look_at(self, xy: tuple[float, float] = (0.0, 0.0), raised: float = 0.16) -> None:
        """Look at a point over the bed: (x, y) in the bed's frame and above its floor, metres."""
        point = self._twin.base_camera[:3, :3] @ np.array([*xy, 0.0])
        middle = self._twin.base_camera[:3, 3]
        floor = self._twin.model.body("box").pos[2]
        self._camera.lookat[:] = middle[0] + point[0], middle[1] + point[1], floor + raised

    def picture(self) -> Num[np.ndarray, "H W 3"]:
        """What it sees now, 8 bits, red first."""
        twin = self._twin
        if self._shown != twin.shown:
            upload_bed(self._renderer, twin)
            self._shown = twin.shown
        mujoco().mj_forward(twin.model, twin.data)
        self._renderer.update_scene(twin.data, camera=self._camera)
        return self._renderer.render().copy()

    def close(self) -> None:
        """Let go of the renderer."""
        self._end()

    def __exit__(self, *problem: object) -> None:
        self.close()


def strip(
    pictures: Sequence[Num[np.ndarray, "H W 3"]], titles: Sequence[str], columns: int = 6
) -> Num[np.ndarray, "h w 3"]:
    """Pictures side by side, each with its title, in rows of `columns`; all of one size."""
    titled = [_titled(one, title) for one, title in zip(pictures, titles, strict=True)]
    blank = np.full_like(titled[0], 255)
    titled += [blank] * (-len(titled) % columns)
    rows = [np.hstack(titled[k : k + columns]) for k in range(0, len(titled), columns)]
    return np.vstack(rows)


def _titled(picture: np.ndarray, title: str) -> np.ndarray:
    height, width = 30, picture.shape[1]
    head = np.full((height, width, 3), 255, np.uint8)
    cv2.putText(head, title, (6, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.62, (30, 30, 30), 1, cv2.LINE_AA)
    framed = np.vstack([head, picture])
    framed[:, -3:] = 255  # a gap to the next one
    return framed
