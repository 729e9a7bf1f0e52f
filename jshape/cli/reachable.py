"""`--reachable`: where the hand may be placed, in pixels or in metres, on the surface of the bed.

An image marks pixels, of the camera that took the frames or of what the bank sees.  A JSON file is
the outline of an area, seen from above, in metres of the arm's base or of the map:

    {"frame": "base", "polygon_m": [[0.3, -0.1], [0.6, -0.1], [0.6, 0.2], [0.3, 0.2]]}
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from jshape._typing import Bool, Float
from jshape.camera import Camera
from jshape.data.missing import fill_missing
from jshape.data.view import View
from jshape.errors import BadFile, BadImage
from jshape.io import drawings
from jshape.io.files import read_json
from jshape.io.records import read_record


@dataclass(frozen=True)
class Area:
    """An area in metres; what is above and below it lies in it too."""

    frame: Literal["base", "map"]
    polygon_m: list[tuple[float, float]]
    """(x, y) of its corners, in order."""

    def problem(self) -> str | None:
        """What no single field tells."""
        count = len(self.polygon_m)
        return None if count >= 3 else f"polygon_m has {count} corners; an area has 3 or more"

    def holds(self, x: np.ndarray, y: np.ndarray) -> Bool[np.ndarray, "..."]:
        """Whether points lie in it: a line from each to the right crosses its edge an odd time."""
        inside = np.zeros(np.shape(x), bool)
        before = self.polygon_m[-1]
        for corner in self.polygon_m:
            (xa, ya), (xb, yb), before = before, corner, corner
            if ya != yb:
                inside ^= ((ya > y) != (yb > y)) & (x < xa + (y - ya) * (xb - xa) / (yb - ya))
        return inside


def reachable(
    path: str | Path | None,
    view: View,
    surface: Callable[[], np.ndarray],
    base: Float[np.ndarray, "4 4"] | None,
) -> Bool[np.ndarray, "h w"] | None:
    """Pixels of the view's target at which a file lets the hand be placed; None: all.

    Args:
      path: of the file; None is none.
      view: from the camera, or the map, to what the bank sees.
      surface: (h, w) depth of the bed from the target, metres; asked for only where it decides.
      base: (4, 4) from the frame of the view's source to the arm's base; None: nobody knows.

    Raises:
      BadFile: no outline of an area, or one in a frame that is not known here.
      BadImage: an image of another size, with NaN, or all 0; what is marked is beside the bed.
    """
    if path is None:
        return None
    if Path(path).suffix.lower() == ".json":
        area = read_record(Area, read_json(path), str(path))
        begin, along = view.target.lines(_frame(area, view, base, path))
        depth = _whole(surface)
        x, y = (np.asarray(begin[k] + depth * along[k]) for k in (0, 1))
        if not (free := area.holds(x, y)).any():
            spans = f"x {x.min():.3f} to {x.max():.3f}, y {y.min():.3f} to {y.max():.3f} m"
            raise BadImage(f"{path}: holds nothing of the bed: in frame {area.frame} it is {spans}")
        return free
    eyes = ("the camera", view.source), ("the bank's", view.target)
    free = read_mask(path, {"the map" if e.orthographic else whose: e.shape for whose, e in eyes})
    if free.shape == view.source.shape:
        depth = None if view.window is not None else _whole(surface)
        free = view.drawing(free, depth) == 1
    if not free.any():
        raise BadImage(f"{path}: marks nothing of the bed")
    return free


def read_mask(path: str | Path, shapes: dict[str, tuple[int, int]]) -> Bool[np.ndarray, "H W"]:
    """Where a drawing is not 0; it must have one of the shapes."""
    mask = drawings.read_drawing(Path(path))
    if mask.shape not in shapes.values():
        made = ", ".join(f"{whose} makes {shape}" for whose, shape in shapes.items())
        raise BadImage(f"{path}: has {mask.shape} (rows, columns); {made}")
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{path}: has pixels that are NaN or infinite")
    drawn = np.ma.filled(mask, 0) != 0
    if not drawn.any():
        raise BadImage(f"{path}: is 0 everywhere; other numbers mark where the hand may be placed")
    return drawn


def _whole(surface: Callable[[], np.ndarray]) -> Float[np.ndarray, "h w"]:
    return fill_missing(surface(), limit=1.0, where="the bed")[0]


def _frame(
    area: Area, view: View, base: np.ndarray | None, path: str | Path
) -> Float[np.ndarray, "4 4"]:
    """From the frame of the view's target to the area's."""
    if area.frame == "map":
        if not view.target.orthographic:
            raise BadFile(f"{path}: frame is 'map', and the bed is seen as an image; allowed: base")
        return np.diag([1.0, -1.0, -1.0, 1.0])
    if base is None:
        raise BadFile(
            f"{path}: frame is 'base', and nothing says where the arm's base is; the camera's file "
            "needs a pose in it, z up (jshape setup --base)"
        )
    return base @ view.to_source


def base_of(camera: Camera) -> Float[np.ndarray, "4 4"] | None:
    """From a camera's frame to the arm's base, if its pose can be in that: with z up."""
    return None if camera.pose is None or camera.pose[2][2] >= 0 else np.array(camera.pose)
