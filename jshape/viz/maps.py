"""Pictures of heights: their scale, axes in mm, what nobody saw; a height map, a set-up."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import binary_erosion

from jshape.camera import Camera
from jshape.height_map import HeightMap, places_on
from jshape.viz.style import own_style

LEAST_SPAN = 5.0
"""Least range of heights on a grey scale, mm."""
RIM = 10
"""Nearer than so many pixels to what nobody saw, heights set no scale: walls of the bin of a real
SR300 are 156 mm high there, the bed in it 34 mm."""
UNSEEN: dict[str, Any] = {
    "facecolor": "mistyrose", "edgecolor": "tab:red", "hatch": "////", "linewidth": 0.0
}  # fmt: skip
"""How what no camera saw looks: no height has this colour."""
_LONG = 7.0
"""Inches of the longer side of a map's picture."""


def span(heights: Sequence[np.ndarray]) -> tuple[float, float]:
    """Black and white of a grey scale of heights, mm (NaN: not seen).

    All are between them but single pixels, and what lies at the rim of what was seen (`RIM`); noise
    is no relief; and a level bed, which is the highest there is, is light grey, not the white of
    the paper.
    """
    low, high = extremes(heights)
    more = max(LEAST_SPAN - (high - low), 0.0) / 2
    return low - more, high + more + 0.2 * (high - low + 2 * more)


def extremes(fields: Sequence[np.ndarray]) -> tuple[float, float]:
    """Least and most of fields (H, W; NaN: not seen), without single pixels and rims."""
    values = []
    for field in fields:
        known = np.isfinite(field)
        inner = np.array(binary_erosion(known, iterations=RIM, border_value=1), bool)
        values.append(np.asarray(field)[inner if inner.any() else known])
    low, high = np.percentile(np.concatenate(values), (0.02, 99.98))
    return float(low), float(high)


def mark_unseen(ax: Axes, seen: np.ndarray | None) -> bool:
    """Show what lies behind an image where it is NaN; whether there is any (`seen` None: no)."""
    if seen is None or seen.all():
        return False
    ax.patch.set(**UNSEEN)
    return True


def in_mm(ax: Axes, camera: Camera) -> None:
    """X and y of a height map in mm along an image of its camera, y up."""
    ends = 1e3 * places_on(camera, [(0, 0), (camera.width - 1, camera.height - 1)])
    u0, v0, per_mm = float(camera.u0), float(camera.v0), float(camera.fx) / 1e3
    for axis, (first, last), of in (
        (ax.xaxis, sorted(ends[:, 0]), lambda x: u0 + per_mm * x),
        (ax.yaxis, sorted(ends[:, 1]), lambda y: v0 - per_mm * y),
    ):
        at = MaxNLocator(8, steps=(1, 2, 5, 10)).tick_values(first, last)
        at = at[(at >= first) & (at <= last)]
        axis.set_ticks(of(at), [f"{mm:g}" for mm in at])
    ax.set(xlabel="x (mm)", ylabel="y (mm)")


@own_style()
def map_figure(found: HeightMap, title: str = "") -> Figure:
    """Heights in mm, x and y in mm as on the bed seen from above, y up; `title` above all."""
    rows, columns = np.shape(found.heights)
    size = _LONG * columns / max(rows, columns), _LONG * rows / max(rows, columns)
    figure = Figure(
        figsize=(max(size[0], 2.5) + 2.2, max(size[1], 2.0) + 1.2), layout="constrained"
    )
    ax = figure.subplots()
    _draw_map(figure, ax, found)
    if title:
        ax.set_title(title, fontsize=10)
    return figure


@own_style()
def setup_figure(depth: np.ndarray, bed: np.ndarray, found: HeightMap, title: str) -> Figure:
    """Depths as the camera sees them with the bed's outline, and the bed from above.

    Args:
      depth: (H, W) metres, NaN = no reading.
      bed: (H, W) pixels that show the rectangle of the map.
      found: the map.
      title: above all.
    """
    figure = Figure(figsize=(13, 5), layout="constrained")
    own, above = figure.subplots(1, 2)
    depth, (height, width) = 1e3 * depth, depth.shape
    low, high = np.nanpercentile(depth, (2, 98))
    shown = own.imshow(depth, cmap="viridis_r", vmin=low, vmax=max(high, low + 1.0),
                       interpolation="nearest")  # fmt: skip
    figure.colorbar(shown, ax=own, label="depth (mm)", shrink=0.85, extend="both")
    at = (np.arange(-1, n + 1) for n in (width, height))
    own.contour(*at, np.pad(bed, 1), [0.5], colors="tab:orange", linewidths=1.8)
    handles = [Patch(label="the bed", facecolor="none", edgecolor="tab:orange", linewidth=1.8)]
    if mark_unseen(own, np.isfinite(depth)):
        handles.append(Patch(label="no reading", **UNSEEN))
    own.legend(handles=handles, fontsize=8, loc="upper right")
    own.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u", ylabel="v")
    _draw_map(figure, above, found)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_map(figure: Figure, ax: Axes, found: HeightMap) -> None:
    x, y = 1e3 * found.x, 1e3 * found.y
    half = 5e2 * float(found.pitch)
    heights = 1e3 * np.where(found.mask, np.asarray(found.heights), np.nan)
    low, high = span([heights])
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    drawn = ax.imshow(heights, cmap="gray", vmin=low, vmax=high, origin="lower", extent=extent,
                      interpolation="nearest")  # fmt: skip
    figure.colorbar(drawn, ax=ax, label="above the plane (mm)", shrink=0.85, extend="both")
    inside = extent[0] <= 0 <= extent[1] and extent[2] <= 0 <= extent[3]
    if inside and found.frame is not None:
        ax.plot(0, 0, "+", color="tab:blue", markersize=12, markeredgewidth=1.8, label="origin")
    handles = ax.get_legend_handles_labels()[0]
    if mark_unseen(ax, found.mask):
        handles.append(Patch(label="not seen", **UNSEEN))
    if handles:
        ax.legend(handles=handles, fontsize=8, loc="upper right")
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
