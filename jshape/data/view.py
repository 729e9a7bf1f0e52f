"""Seeing a bed as a bank's camera would, whatever camera took the frames."""

from dataclasses import dataclass

import numpy as np

from jshape import camera as cameras
from jshape._typing import Float
from jshape.camera import Camera, check_camera, window_of
from jshape.data.missing import fill_missing
from jshape.errors import BadCamera, BadImage


@dataclass(frozen=True)
class View:
    """How the frames of one camera become those of another: cut a window out, or look again."""

    source: Camera
    """The camera that takes the frames."""
    target: Camera
    """The bank's camera."""
    window: tuple[int, int] | None
    """(left, top) of the target's image in the source's; None: it is no window of it."""
    rise: float = 0.0
    """How much farther the target stands from the bed, metres."""

    def depth(
        self, depth: np.ndarray, *, limit: float, where: str
    ) -> tuple[Float[np.ndarray, "h w"], int]:
        """A frame (H, W) in metres as the target would see it, and how many pixels were filled.

        A window is only cut out: its gaps are left for the caller to fill.

        Raises:
          BadImage: another size than the source's.
          MissingDepth: more than `limit` of it is missing, where it has to be looked at again.
        """
        if depth.shape != self.source.shape:
            raise BadImage(
                f"{where}: has {depth.shape} (rows, columns); the camera makes {self.source.shape}"
            )
        if self.window is not None:
            left, top = self.window
            return depth[top : top + self.target.height, left : left + self.target.width], 0
        whole, filled = fill_missing(depth, limit=limit, where=where)
        return np.asarray(cameras.reproject(whole, self.source, self.target, self.rise)), filled

    def pixels(self, positions: np.ndarray, z: float) -> np.ndarray:
        """Where positions (N, 2) of (u, v) in the target's image are in the source's: (N, 2).

        `z` is the depth of the bed from the target, metres.
        """
        if self.window is not None:
            return positions + np.array(self.window)
        source, target = self.source, self.target
        shrink = z / (z - self.rise)
        u = (positions[:, 0] - float(target.u0)) / float(target.fx) * shrink
        v = (positions[:, 1] - float(target.v0)) / float(target.fy) * shrink
        both = (u * float(source.fx) + float(source.u0), v * float(source.fy) + float(source.v0))
        return np.rint(np.stack(both, -1)).astype(int)


def view_of(source: Camera, target: Camera, first: np.ndarray, *, reproject: bool = False) -> View:
    """The view from `source` frames to `target` frames.

    Args:
      source: the camera that took the frames.
      target: the bank's camera.
      first: (H, W) metres, a frame: the middle of its bed goes to the middle of target's range.
      reproject: allow another camera than the bank's, or another distance from the bed.

    Raises:
      BadCamera: another camera, and `reproject` is False; or a camera that makes no sense.
    """
    check_camera(source)
    window = window_of(target, source)
    if window is not None:
        return View(source, target, window)
    if not reproject:
        names = ("width", "height", "fx", "fy", "u0", "v0", "z_min", "z_max")
        numbers = [(n, float(getattr(source, n)), float(getattr(target, n))) for n in names]
        differ = ", ".join(f"{n} {a:g} (bank: {b:g})" for n, a, b in numbers if a != b)
        raise BadCamera(
            f"the bank is for another camera: {differ}; with reproject (--reproject) the frames "
            "are seen as its camera would see them"
        )
    height, width = source.shape
    middle = first[height // 4 : height - height // 4, width // 4 : width - width // 4]
    seen = middle[np.isfinite(middle) & (middle > 0)]
    if seen.size == 0:
        raise BadImage("no depth reading in the middle of the frame: where is the bed?")
    rise = (float(target.z_min) + float(target.z_max)) / 2 - float(np.median(seen))
    return View(source, target, None, rise)
