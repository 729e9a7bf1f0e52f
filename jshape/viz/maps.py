"""The picture of a height map: heights on the plane, and what was not seen."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jshape.height_map import HeightMap
from jshape.viz.map_axes import UNSEEN, mark_unseen
from jshape.viz.scale import span
from jshape.viz.style import own_style

_LONG = 7.0
"""Inches of the longer side."""


@own_style()
def map_figure(found: HeightMap, title: str = "") -> Figure:
    """Heights in mm, x and y in mm as on the bed seen from above, y up.

    Args:
      found: the map.
      title: above all.
    """
    rows, columns = np.shape(found.heights)
    size = _LONG * columns / max(rows, columns), _LONG * rows / max(rows, columns)
    figure = Figure(
        figsize=(max(size[0], 2.5) + 2.2, max(size[1], 2.0) + 1.2), layout="constrained"
    )
    ax = figure.subplots()
    draw_map(figure, ax, found)
    if title:
        ax.set_title(title, fontsize=10)
    return figure


def draw_map(figure: Figure, ax: Axes, found: HeightMap) -> None:
    """Draw a map on axes of a figure."""
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
