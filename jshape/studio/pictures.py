"""Images of the page: shaded heights, differences, boxes.  Arrays in, data URLs and SVG out."""

import base64
from collections.abc import Sequence

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex

from jshape._typing import Float, Num
from jshape.planned import Plan
from jshape.viz.pictures import COLOURS

LEAST_SPAN_MM = 6.0
"""Least range of heights that the colours span."""
STEP = 4
"""Every so many pixels have a point in 3-D: 12,000 for the paper's box."""


def shaded(depth: Float[np.ndarray, "H W"]) -> Num[np.ndarray, "H W 3"]:
    """Depth in metres as coloured heights, lit from the upper left.  RGB."""
    height = -1e3 * depth
    low, high = np.percentile(height, (1, 99))
    middle, span = (low + high) / 2, max(high - low, LEAST_SPAN_MM)
    colours = mpl.colormaps["cividis"](0.5 + (height - middle) / span)[..., :3]
    smooth = cv2.GaussianBlur(height.astype(np.float32), (0, 0), 1.5)
    down, right = np.gradient(smooth)
    light = np.clip(1.0 - 0.35 * (right + down), 0.5, 1.4)
    return (255 * np.clip(colours * light[..., None], 0, 1)).astype(np.uint8)


def differing(change_mm: Float[np.ndarray, "H W"]) -> Num[np.ndarray, "H W 3"]:
    """Differences in mm: red is too high, blue too low, white as wanted.  RGB."""
    reach = max(float(np.percentile(np.abs(change_mm), 99)), LEAST_SPAN_MM / 2)
    colours = mpl.colormaps["RdBu_r"](0.5 + change_mm / (2 * reach))[..., :3]
    return (255 * colours).astype(np.uint8)


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
