"""Images of the page: shaded heights, differences, boxes.  Arrays in, data URLs and SVG out."""

import base64
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex

from jshape._typing import Float, Num
from jshape.planning.plan import Plan
from jshape.viz.pictures import COLOURS

HEIGHTS, DIFFERENCES = "cividis", "RdBu_r"
"""Colour maps: higher is brighter; too high is red, too low is blue."""
LEAST_SPAN_MM = 6.0
"""Least range of heights that the colours span."""
STEP = 4
"""Every so many pixels have a point in 3-D: 12,000 for the paper's box."""


class Scale(NamedTuple):
    """What colours mean."""

    low: float
    """Value of the first colour, mm."""
    high: float
    """Of the last."""
    colours: str
    """Name of the colour map."""

    def paint(self, values: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W 3"]:
        """RGB in [0, 1] of values in mm."""
        share = (values - self.low) / (self.high - self.low)
        return mpl.colormaps[self.colours](share)[..., :3]

    @property
    def gradient(self) -> str:
        """The colours from low to high, as CSS."""
        stops = [to_hex(mpl.colormaps[self.colours](k / 16)) for k in range(17)]
        return f"linear-gradient(90deg, {', '.join(stops)})"


def height_scale(*heights_mm: Float[np.ndarray, "H W"]) -> Scale:
    """One for all of them: a colour means the same height in bed, goal and prediction."""
    ends = np.array([np.percentile(height, (0.5, 99.5)) for height in heights_mm])
    low, high = float(ends.min()), float(ends.max())
    more = max(LEAST_SPAN_MM - (high - low), 0.0) / 2
    return Scale(low - more, high + more, HEIGHTS)


def difference_scale(change_mm: Float[np.ndarray, "H W"]) -> Scale:
    """White in its middle, where all is as wanted."""
    reach = max(float(np.percentile(np.abs(change_mm), 99)), LEAST_SPAN_MM / 2)
    return Scale(-reach, reach, DIFFERENCES)


def shaded(height_mm: Float[np.ndarray, "H W"], scale: Scale) -> Num[np.ndarray, "H W 3"]:
    """Heights in mm as colours, lit from the upper left.  RGB."""
    smooth = cv2.GaussianBlur(height_mm.astype(np.float32), (0, 0), 1.5)
    down, right = np.gradient(smooth)
    light = np.clip(1.0 - 0.35 * (right + down), 0.5, 1.4)
    return (255 * np.clip(scale.paint(height_mm) * light[..., None], 0, 1)).astype(np.uint8)


def differing(change_mm: Float[np.ndarray, "H W"], scale: Scale) -> Num[np.ndarray, "H W 3"]:
    """Differences in mm: red is too high, blue too low, white as wanted.  RGB."""
    return (255 * scale.paint(change_mm)).astype(np.uint8)


def data_url(rgb: Num[np.ndarray, "H W 3"]) -> str:
    """An image as a browser shows it without asking for a file."""
    _, content = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode()


def cloud(
    points: Float[np.ndarray, "H W 3"], rgb: Num[np.ndarray, "H W 3"], exaggerate: float
) -> tuple[list[list[float]], list[list[float]]]:
    """Points in decimetres, z up, x to the right of the image, y up it; and their colours."""
    xyz = points[::STEP, ::STEP].reshape(-1, 3).astype(float) * (10.0, -10.0, -10.0)
    xyz[:, 2] = exaggerate * (xyz[:, 2] - np.median(xyz[:, 2]))
    colours = rgb[::STEP, ::STEP].reshape(-1, 3) / 255.0
    return np.round(xyz, 4).tolist(), np.round(colours, 3).tolist()


def boxes(plan: Plan, done: int) -> str:
    """The plan's numbered boxes; those of actions that are done are thin, the next is thick."""
    drawn = []
    for k, name in enumerate(plan.actions):
        (u, v), (w, h) = plan.exact_positions[k].tolist(), plan.rois[k].tolist()
        colour, width = to_hex(COLOURS.get(name, "0.5")), 3.0 if k == done else 1.2
        left, top = plan.positions[k].tolist()
        drawn.append(_box((left - w // 2, top - h // 2, w, h), colour, width))
        drawn.append(
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="9" fill="{colour}" stroke="white"/>'
            f'<text x="{u:.1f}" y="{v + 4:.1f}" font-size="12" text-anchor="middle" '
            f'fill="white" font-weight="bold">{k + 1}</text>'
        )
    return "".join(drawn)


def box(corners: tuple[int, int, int, int], colour: str) -> str:
    """One box (left, top, width, height)."""
    return _box(corners, colour, 2.0)


def line(points: Sequence[tuple[float, float]], width: float, colour: str) -> str:
    """A brush's way."""
    way = " ".join(f"{u:.1f},{v:.1f}" for u, v in (*points, points[-1]))
    return (
        f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-opacity="0.5" '
        f'stroke-width="{width:.1f}" stroke-linecap="round" stroke-linejoin="round"/>'
    )


def _box(corners: tuple[int, int, int, int], colour: str, width: float) -> str:
    left, top, w, h = corners
    return (
        f'<rect x="{left}" y="{top}" width="{w}" height="{h}" fill="none" stroke="{colour}" '
        f'stroke-width="{width}"/>'
    )
