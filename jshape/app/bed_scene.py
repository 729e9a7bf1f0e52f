"""A bed in 3-D on a page: a mesh with a vertex per pixel, drawn by the browser.

The heights of a step travel as 16-bit counts and its colours as a picture, 0.7 MB for 480x395.
"""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from nicegui import ui  # noqa: F401  (nicegui.element does not import by itself)
from nicegui.element import Element
from nicegui.elements.scene import scene  # noqa: F401  (brings three.js, as "nicegui-scene")

from jshape._typing import Float, Num
from jshape.app.pictures import data_url
from jshape.camera import Camera
from jshape.data.missing import missing

MOST_COUNTS = 65_534
"""Of the depths of one mesh; 0 is no reading."""


class BedScene(Element, component="bed_scene.js"):
    """Drag to turn, scroll to come nearer."""

    def __init__(self, camera: Camera):
        """Build it where the caller is, for images of a camera."""
        super().__init__()
        self.use(camera)

    def use(self, camera: Camera) -> None:
        """Show images of another camera."""
        self._props["columns"], self._props["rows"] = camera.width, camera.height
        # x and y at a depth of 1 m; of parallel rays the same at every depth.
        self._props["parallel"] = camera.orthographic
        for name, ray in zip("xy", camera.rays(), strict=True):
            self._props[name] = _text(np.asarray(ray, np.float32).reshape(-1))

    def show(
        self,
        depth: Float[np.ndarray, "H W"] | None,
        rgb: Num[np.ndarray, "H W 3"],
        *,
        level: float,
        exaggeration: float = 1.0,
        goal: Float[np.ndarray, "H W"] | None = None,
        boxes: Sequence[dict[str, Any]] = (),
    ) -> None:
        """Draw a bed.

        Args:
          depth: metres, NaN or 0 = no reading: no face touches it; None: no bed.
          rgb: its colours.
          level: depth that stays in its place when heights are exaggerated, metres.
          exaggeration: factor on heights; places across the bed stay.
          goal: a second, pink surface.
          boxes: `edges` and `top`, points in the camera's frame, `colour`, `words`, `chosen`.
        """
        beds = [bed[~missing(bed)] for bed in (depth, goal) if bed is not None]
        known = np.concatenate([*beds, [level]])
        nearest = float(known.min())
        step = max(float(np.ptp(known)), 1e-6) / (MOST_COUNTS - 1)
        shown = {"nearest": nearest, "step": step, "level": level, "tall": exaggeration}
        shown |= {"heights": _counts(depth, nearest, step), "goal": _counts(goal, nearest, step)}
        self._props["shown"] = shown | {"picture": data_url(rgb), "boxes": list(boxes)}
        self.update()


def _counts(depth: np.ndarray | None, nearest: float, step: float) -> str:
    if depth is None:
        return ""
    gone = missing(depth)
    counts = np.rint((np.where(gone, nearest, depth) - nearest) / step) + 1
    return _text(np.where(gone, 0, counts).astype("<u2"))


def _text(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()
