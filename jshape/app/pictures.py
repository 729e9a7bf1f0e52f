"""Images of the page: shaded heights, differences, boxes.  Arrays in, data URLs and SVG out."""

import base64
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex, to_rgb

from jshape._typing import Float, Int, Num
from jshape.actions import PlacedAction
from jshape.viz.limits import COLOURS as CAUSES
from jshape.viz.overlay import COLOURS

HEIGHTS, DIFFERENCES = "cividis", "RdBu_r"
"""Colour maps: higher is brighter; too high is red, too low is blue."""
LEAST_SPAN_MM = 6.0
"""Least range of heights that the colours span."""
NUMBER = 9
"""Radius of the disc with an action's number, pixels."""
DARK = (40, 40, 40)
"""Beside coloured stripes: one of the two stands out from any height."""
NOTHING = (110, 110, 110)
"""Colour of pixels without a reading."""


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
        painted = mpl.colormaps[self.colours](share)[..., :3]
        return np.where(np.isfinite(share)[..., None], painted, np.divide(NOTHING, 255))

    @property
    def gradient(self) -> str:
        """The colours from low to high, as CSS."""
        stops = [to_hex(mpl.colormaps[self.colours](k / 16)) for k in range(17)]
        return f"linear-gradient(90deg, {', '.join(stops)})"


def height_scale(*heights_mm: Float[np.ndarray, "H W"]) -> Scale:
    """One for all of them: a colour means the same height in bed, goal and prediction."""
    known = [height[np.isfinite(height)] for height in heights_mm]
    ends = np.array([np.percentile(h, (0.5, 99.5)) for h in known if h.size] or [(0.0, 0.0)])
    low, high = float(ends.min()), float(ends.max())
    more = max(LEAST_SPAN_MM - (high - low), 0.0) / 2
    return Scale(low - more, high + more, HEIGHTS)


def difference_scale(change_mm: Float[np.ndarray, "H W"]) -> Scale:
    """White in its middle, where all is as wanted."""
    known = np.abs(change_mm[np.isfinite(change_mm)])
    most = max(float(np.percentile(known, 99)) if known.size else 0.0, LEAST_SPAN_MM / 2)
    return Scale(-most, most, DIFFERENCES)


def shaded(height_mm: Float[np.ndarray, "H W"], scale: Scale) -> Num[np.ndarray, "H W 3"]:
    """Heights in mm as colours, lit from the upper left.  RGB."""
    known = np.isfinite(height_mm)
    level = np.median(height_mm[known]) if known.any() else 0.0
    smooth = cv2.GaussianBlur(np.where(known, height_mm, level).astype(np.float32), (0, 0), 1.5)
    down, right = np.gradient(smooth)
    light = np.clip(1.0 - 0.35 * (right + down), 0.5, 1.4)
    return (255 * np.clip(scale.paint(height_mm) * light[..., None], 0, 1)).astype(np.uint8)


def differing(change_mm: Float[np.ndarray, "H W"], scale: Scale) -> Num[np.ndarray, "H W 3"]:
    """Differences in mm: red is too high, blue too low, white as wanted.  RGB."""
    return (255 * scale.paint(change_mm)).astype(np.uint8)


def marked(
    rgb: Num[np.ndarray, "H W 3"], causes: Int[np.ndarray, "H W"]
) -> Num[np.ndarray, "H W 3"]:
    """An image with stripes where something remains (`Limit.causes`); `stripes` is their legend."""
    v, u = np.indices(causes.shape)
    found, square = rgb.copy(), np.ones((3, 3), np.uint8)
    ways = u + v, u - v, u, v, u + 2 * v
    for k, (colour, along) in enumerate(zip(CAUSES.values(), ways, strict=True), 1):
        here = causes == k
        inside = cv2.erode(here.astype(np.uint8), square) > 0  # specks are all edge: they are seen
        found[here & (along % 8 < 4)] = DARK
        found[here & ((along % 8 < 2) | ~inside)] = 255 * np.array(to_rgb(colour))
    return found


def stripes(cause: str) -> str:
    """The stripes of a cause, as CSS."""
    angle = dict(zip(CAUSES, (135, 45, 90, 0, 153), strict=True))[cause]
    dark = "#{:02x}{:02x}{:02x}".format(*DARK)
    return f"repeating-linear-gradient({angle}deg, {CAUSES[cause]} 0 3px, {dark} 3px 6px)"


def data_url(rgb: Num[np.ndarray, "H W 3"]) -> str:
    """An image as a browser shows it without asking for a file."""
    _, content = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode()


def boxes(actions: Iterable[PlacedAction], chosen: int | None) -> str:
    """Numbered boxes of actions, the one `chosen` thick, and arrows along their strokes.

    One whose ROI is not known keeps its number, and is not drawn.
    """
    drawn = []
    for k, action in enumerate(actions):
        if action.roi is None:
            continue
        colour, width = colour_of(action.action), 3.0 if k == chosen else 1.2
        (u, v), corners = action.position, action.outline
        drawn.append(
            f'<polygon points="{_path(corners)}" fill="none" stroke="{colour}" '
            f'stroke-width="{width}"/>{_arrow(action.ends, corners.mean(0), colour, 1.5 * width)}'
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{NUMBER}" fill="{colour}" stroke="white"/>'
            f'<text x="{u:.1f}" y="{v + 4:.1f}" font-size="12" text-anchor="middle" '
            f'fill="white" font-weight="bold">{k + 1}</text>'
        )
    return "".join(drawn)


def _arrow(
    ends: Float[np.ndarray, "2 2"], place: Float[np.ndarray, "2"], colour: str, width: float
) -> str:
    """From one place (u, v) to another; nothing where they are one.

    One that begins at the action's `place` ends before the number of the next one's.
    """
    start, tip = ends
    far = float(np.linalg.norm(tip - start))
    if far < 1:
        return ""
    ahead = (tip - start) / far
    if np.allclose(start, place, atol=0.5):
        tip = tip - NUMBER * ahead
    aside = np.array([-ahead[1], ahead[0]])
    foot = tip - min(12.0, far / 2) * ahead
    head = _path((tip, foot + 5 * aside, foot - 5 * aside))
    return (
        f'<polyline points="{_path((start, foot))}" fill="none" stroke="{colour}" '
        f'stroke-width="{width}"/><polygon points="{head}" fill="{colour}"/>'
    )


def colour_of(action: str) -> str:
    """Of an action, as on the project's pictures: "#rrggbb"."""
    return to_hex(COLOURS.get(action, "0.5"))


def box(corners: tuple[int, int, int, int], colour: str) -> str:
    """One box (left, top, width, height)."""
    left, top, w, h = corners
    return (
        f'<rect x="{left}" y="{top}" width="{w}" height="{h}" fill="none" stroke="{colour}" '
        f'stroke-width="2"/>'
    )


def line(points: Sequence[tuple[float, float]], width: float, colour: str) -> str:
    """A brush's path."""
    return (
        f'<polyline points="{_path((*points, points[-1]))}" fill="none" stroke="{colour}" '
        f'stroke-opacity="0.5" stroke-width="{width:.1f}" stroke-linecap="round" '
        f'stroke-linejoin="round"/>'
    )


def _path(points: Iterable[Sequence[float] | np.ndarray]) -> str:
    return " ".join(f"{u:.1f},{v:.1f}" for u, v in points)
