"""`--reachable`: where the hand may be placed, in pixels or in metres, on the surface of the bed.

An image marks pixels, of the camera that took the frames or of what the bank sees.  A JSON file is
the outline of an area, seen from above, in metres of the arm's base or of the map:

    {"frame": "base", "polygon_m": [[0.3, -0.1], [0.6, -0.1], [0.6, 0.2], [0.3, 0.2]]}
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from jshape._typing import Bool, Float
from jshape.camera import Camera
from jshape.cli.tables import say
from jshape.data.missing import fill_missing
from jshape.data.view import View
from jshape.errors import BadFile, BadImage
from jshape.io import formats
from jshape.io.files import read_json
from jshape.io.records import Range, read_record

FAR = 10.0
"""Metres: no arm reaches as far from its base, and no bed from the middle of its map."""
_FLOAT = float(np.finfo(float).max)


@dataclass(frozen=True)
class Area:
    """An area in metres; what is above and below it lies in it too."""

    frame: Literal["base", "map"]
    polygon_m: list[Annotated[tuple[float, float], Range(-_FLOAT, _FLOAT)]]
    """(x, y) of its corners, in order."""

    def problem(self) -> str | None:
        """What no single field tells."""
        if (count := len(self.polygon_m)) < 3:
            return f"polygon_m has {count} corners; an area has 3 or more"
        far = max((n for corner in self.polygon_m for n in corner), key=abs)
        if abs(far) > FAR:
            return (
                f"polygon_m has a corner at {far:g}; it is in metres, at most {FAR:g} from the "
                f"origin (in millimetres it would be {far / 1e3:g} m)"
            )
        corners = np.array(self.polygon_m)
        if np.linalg.matrix_rank(corners - corners[0], 1e-6) < 2:
            return "polygon_m has no area: its corners lie on one line"
        if (at := _crossing(corners)) is not None:
            ends = " and ".join(f"{k + 1}-{(k + 1) % count + 1}" for k in at)
            return f"polygon_m crosses itself, between corners {ends}; give them in order"
        return None

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

    `surface` is the depth (h, w) of the bed from the target, metres, asked for only where it
    decides; `base` leads from the frame of the view's source to the arm's base, if that is known.
    """
    if path is None:
        return None
    if Path(path).suffix.lower() == ".json":
        area = read_record(Area, read_json(path), str(path))
        begin, along = view.target.lines(_frame(area, view, base, path))
        depth = _whole(surface)
        x, y = (np.asarray(begin[k] + depth * along[k]) for k in (0, 1))
        if not (free := area.holds(x, y)).any():
            raise BadImage(
                f"{path}: holds nothing of the bed: in frame {area.frame} the bed is "
                f"{_spans(x, y)}, the polygon {_spans(*np.transpose(area.polygon_m))}"
            )
    else:
        eyes = ("the camera", view.source), ("the bank's", view.target)
        of = {"the map" if eye.orthographic else whose: eye.shape for whose, eye in eyes}
        free = read_mask(path, of)
        if free.shape == view.source.shape:
            depth = None if view.window is not None else _whole(surface)
            free = view.drawing(free, depth) == 1
        if not free.any():
            raise BadImage(f"{path}: marks nothing of the bed")
    say(f"reachable: {free.mean():.1%} of the bed ({path})")
    return free


def read_mask(path: str | Path, shapes: dict[str, tuple[int, int]]) -> Bool[np.ndarray, "H W"]:
    """Where a drawing is not 0; it must have one of the shapes."""
    mask = formats.read_drawing(Path(path))
    if mask.shape not in shapes.values():
        made = ", ".join(f"{whose} makes {shape}" for whose, shape in shapes.items())
        raise BadImage(f"{path}: has {mask.shape} (rows, columns); {made}")
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{path}: has pixels that are NaN or infinite")
    drawn = np.ma.filled(mask, 0) != 0
    if not drawn.any():
        raise BadImage(f"{path}: is 0 everywhere; other numbers mark where the hand may be placed")
    return drawn


def _spans(x: np.ndarray, y: np.ndarray) -> str:
    return f"x {x.min():.3f} to {x.max():.3f}, y {y.min():.3f} to {y.max():.3f} m"


def _crossing(corners: Float[np.ndarray, "N 2"]) -> tuple[int, int] | None:
    """Two edges that cross, each by the corner (from 0) where it begins."""

    def side(of: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        (x, y), (u, v) = np.moveaxis(b - a, -1, 0), np.moveaxis(of - a, -1, 0)
        return np.sign(x * v - y * u)

    ends = np.roll(corners, -1, axis=0)
    for k, (a, b) in enumerate(zip(corners, ends, strict=True)):
        apart = side(corners, a, b) * side(ends, a, b) < 0
        apart &= side(a, corners, ends) * side(b, corners, ends) < 0
        if apart.any():
            return k, int(np.argmax(apart))
    return None


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
