"""ROS messages to cameras: `sensor_msgs/CameraInfo`, of ROS 1 (capitals) and ROS 2.

K and D describe the frames as the lens gives them, P the rectified ones; all three are those of the
whole sensor, of which frames may be a region (`roi`), with pixels put together (`binning`).
"""

import re
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.data.intrinsics import bent, pinhole
from jshape.errors import BadCamera, quoted

INFO = "sensor_msgs/msg/CameraInfo"

LENSES = ("plumb_bob", "rational_polynomial", "")
"""Models of lenses that are read; some name none, and mean these."""

_ALIKE_PX = 0.1
"""K and P that differ by less say the same: 0.1 mm beside the bed of a D435 at 0.45 m."""


def stated(info: Any) -> tuple[np.ndarray, ...]:
    """All that a CameraInfo says of its frames.

    Returns:
      K (3, 3), D (n,), P (3, 4), (width, height), binning (x, y), and the region (left, top, width,
      height, whether it is another one in rectified frames).
    """
    k, d, p = (np.asarray(getattr(info, n, getattr(info, n.upper(), ())), float) for n in "kdp")
    roi = info.roi
    return (
        k.reshape(3, 3),
        d.reshape(-1),
        p.reshape(3, 4),
        np.array([info.width, info.height]),
        np.array([info.binning_x, info.binning_y]).clip(1),
        np.array([roi.x_offset, roi.y_offset, roi.width, roi.height, roi.do_rectify]),
    )


def camera_of(
    info: Any, topic: str, size: tuple[int, int], z_range: tuple[float, float], where: str
) -> Camera:
    """The camera of frames of a topic, as the CameraInfo beside it states.

    The topic's name says whether the frames, of `size` (width, height), are rectified; the bed lies
    in `z_range`, metres.

    Raises BadCamera: numbers that make no sense, of frames of another size, or of a lens of another
    model than those of `LENSES`; or K and P differ, or the lens distorts, and nothing says whether
    the frames are rectified.
    """
    k, d, p, whole, binning, region = stated(info)
    left, top, width, height, distinct = (int(n) for n in region)
    part = int(width or whole[0]), int(height or whole[1])
    made = part[0] // int(binning[0]), part[1] // int(binning[1])
    cut = (left, top, *part) != (0, 0, *whole)
    if made != size and min(made) > 0:
        said = f"{whole[0]}x{whole[1]}"
        said += f", of which it shows {part[0]}x{part[1]} at ({left}, {top})" if cut else ""
        said += f", {binning[0]}x{binning[1]} put together" if binning.max() > 1 else ""
        raise BadCamera(
            f"{where}: the frames have {size[0]}x{size[1]} pixels; their CameraInfo is for {said}; "
            "--camera FILE replaces it"
        )
    taken, lens = _taken(k, d, p, topic, where)
    model = str(info.distortion_model)
    if bent(lens) and model not in LENSES:
        raise BadCamera(
            f"{where}: the lens is of the model {quoted(model)}; read are {', '.join(LENSES[:2])}; "
            "rectify the frames first"
        )
    if cut and distinct and taken is p:
        raise BadCamera(
            f"{where}: shows {part[0]}x{part[1]} at ({left}, {top}) of the frames before they were "
            "rectified (do_rectify); nothing says where that lies now; --camera FILE does"
        )
    if abs(taken[0, 1]) > _ALIKE_PX:
        raise BadCamera(f"{where}: has skew, {taken[0, 1]:g}; --camera FILE replaces it")
    # As image_geometry has it: first the region, then the binning.
    focal = (taken[0, 0] / binning[0], taken[1, 1] / binning[1])
    centre = ((taken[0, 2] - left) / binning[0], (taken[1, 2] - top) / binning[1])
    return pinhole(where, made, focal, centre, lens, z_range)


def _taken(
    k: np.ndarray, d: np.ndarray, p: np.ndarray, topic: str, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """K and D, or P and no distortion, whichever the frames of a topic have."""
    words = {*re.split("[/_]", topic.lower())}
    rectified = bool(words & {"rect", "rectified"})
    if rectified and (p.any() or not bent(d)):
        return (p if p.any() else k), d[:0]
    projects = bool(p[0, 0] > 0 and p[1, 1] > 0)
    alike = not projects or np.allclose(k, p[:, :3], rtol=0, atol=_ALIKE_PX)
    if not rectified and ("raw" in words or alike and not bent(d)):
        return k, d
    why = "P is empty" if rectified else "the topic's name says neither rect nor raw"
    raise BadCamera(
        f"{where}: {why}; K says {_shown(k)}, the lens {', '.join(f'{c:g}' for c in d[:5])}, and "
        f"P, which holds for rectified frames, {_shown(p)}; --camera FILE says what it is"
    )


def _shown(m: np.ndarray) -> str:
    return f"fx {m[0, 0]:g}, fy {m[1, 1]:g}, u0 {m[0, 2]:g}, v0 {m[1, 2]:g}"
