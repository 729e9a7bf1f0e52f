"""The picture of a set-up: the bed in the camera's own image, and its height map."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jshape.data.set_up import SetUp
from jshape.viz.map_axes import UNSEEN, mark_unseen
from jshape.viz.maps import draw_map
from jshape.viz.style import own_style


@own_style()
def setup_figure(setup: SetUp, title: str) -> Figure:
    """Depths with the bed's outline, and the bed from above."""
    figure = Figure(figsize=(13, 5), layout="constrained")
    own, above = figure.subplots(1, 2)
    look, found = setup.look, setup.map
    depth, camera = 1e3 * look.depth, look.camera
    low, high = np.nanpercentile(depth, (2, 98))
    shown = own.imshow(depth, cmap="viridis_r", vmin=low, vmax=max(high, low + 1.0),
                       interpolation="nearest")  # fmt: skip
    figure.colorbar(shown, ax=own, label="depth (mm)", shrink=0.85, extend="both")
    at = (np.arange(-1, n + 1) for n in (camera.width, camera.height))
    own.contour(*at, np.pad(setup.bed, 1), [0.5], colors="tab:orange", linewidths=1.8)
    handles = [Patch(label="the bed", facecolor="none", edgecolor="tab:orange", linewidth=1.8)]
    if mark_unseen(own, np.isfinite(depth)):
        handles.append(Patch(label="no reading", **UNSEEN))
    own.legend(handles=handles, fontsize=8, loc="upper right")
    own.set(
        xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xlabel="u", ylabel="v"
    )
    draw_map(figure, above, found)
    figure.suptitle(title, fontsize=10)
    return figure
