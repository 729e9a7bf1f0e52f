"""The picture of a limit: what is wanted, what remains at best, and why it cannot be reached."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.ndimage import gaussian_filter

from jshape.viz.maps import in_mm, mark_unseen
from jshape.viz.style import own_style

COLOURS = {
    "needs material": "#56b4e9",
    "too few actions": "#009e73",
    "too steep": "#d55e00",
    "too narrow": "#cc79a7",
    "out of reach": "#f0e442",
}
"""Of causes; told apart by the colour-blind (Okabe and Ito)."""
BLUR = 3.0
"""Pixels over which the outline of what is wanted is blurred: noise has none."""


@own_style()
def limit_figure(found: Any) -> Figure:
    """What a `Limit` knows, seen from above: three maps and its bounds in words."""
    seen = found.seen
    most = max(float(np.percentile(np.abs(found.wanted_mm), 99.8)), 0.1)
    figure = Figure(figsize=(14.5, 4.9), layout="constrained")
    before, after, why = figure.subplots(1, 3, sharex=True, sharey=True)
    scale: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
    for ax, field, text in (
        (before, found.wanted_mm, f"the bed now - the goal: {found.distance_mm:.2f} mm on average"),
        (after, found.remains_mm, f"fractions of actions leave {found.fractions:.0%} of that"),
    ):
        shown = field if seen is None else np.where(seen, field, np.nan)
        drawn = ax.imshow(shown, interpolation="nearest", **scale)
        ax.set_title(text, fontsize=11)
    figure.colorbar(drawn, ax=[before, after], label="too high: red, + (mm)", shrink=0.8)
    _draw_causes(why, found)
    for ax in (before, after, why):
        mark_unseen(ax, seen)
        if found.camera.orthographic:
            in_mm(ax, found.camera)
        else:
            ax.set(xlabel="u", ylabel="v")
    figure.suptitle(found.words, fontsize=12)
    return figure


def _draw_causes(ax: Axes, found: Any) -> None:
    """Where something remains, coloured by cause, over the outline of what is wanted."""
    colours = ListedColormap(list(COLOURS.values()))
    wanted = np.abs(gaussian_filter(found.wanted_mm, BLUR)) > 0.5
    ax.imshow(np.where(wanted, 0.8, 0.95), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    causes = np.ma.masked_equal(found.causes, 0)
    ax.imshow(causes, cmap=colours, vmin=0.5, vmax=len(COLOURS) + 0.5, interpolation="nearest")
    shares = found.shares
    handles = [
        Patch(color=colour, label=f"{cause}: {shares[cause]:.0%}")
        for cause, colour in COLOURS.items()
        if cause in shares
    ]
    handles.append(Patch(color="0.8", label="to be changed"))
    ax.figure.legend(handles=handles, fontsize=9, loc="outside lower right", ncols=len(handles))
    ax.set_title("where more than 0.5 mm remains, and why", fontsize=11)
