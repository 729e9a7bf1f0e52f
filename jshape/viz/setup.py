"""The picture of a set-up: the bed in the camera's own image, and its height map."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jshape.height_map import HeightMap
from jshape.viz.map_axes import UNSEEN, mark_unseen
from jshape.viz.maps import draw_map
from jshape.viz.style import own_style


@own_style()
def setup_figure(depth: np.ndarray, bed: np.ndarray, found: HeightMap, title: str) -> Figure:
    """Depths with the bed's outline, and the bed from above.

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
    draw_map(figure, above, found)
    figure.suptitle(title, fontsize=10)
    return figure
