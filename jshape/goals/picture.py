"""The picture of a goal: the bed, what is wanted of it, what changes, and a cut through it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jshape.goals import Goal
from jshape.viz.maps import mark_unseen, span
from jshape.viz.style import own_style

CONTOURS = 1.0
"""Contour lines are drawn this far apart, mm; wider on changes of more than six lines."""
LABELLED = 0.02
"""Regions of less than this share of what all move have no label."""


@own_style()
def goal_figure(goal: Goal, title: str = "") -> Figure:
    """Bed, goal and change from above, y up, and a cut-away profile where it changes most."""
    bed = goal.bed
    x, y = (1e3 * sign * axis for sign, axis in zip((1, -1), bed.axes(), strict=True))
    seen = bed.seen
    now, wanted, change = (
        np.where(seen, 1e3 * k, np.nan) for k in (bed.height, goal.height, goal.change)
    )
    low, high = span([now, wanted])
    most = max(float(np.nanmax(np.abs(change))), 0.1)
    half = bed.cell * 500
    extent = x[0] - half, x[-1] + half, y[-1] - half, y[0] + half
    (x0, y0), (x1, y1) = (1e3 * k for k in bed.view())
    # Where nothing changes, a row that was seen.
    row = int(np.argmax(np.where(seen, np.abs(goal.change) + 1e-9, 0.0).sum(1)))

    figure = Figure(figsize=(13.5, 6.3), layout="constrained")
    axes = figure.subplot_mosaic(
        [["bed", "goal", "change"], ["cut", "cut", "cut"]], height_ratios=[2.1, 1.0]
    )
    for name, field in (("bed", now), ("goal", wanted)):
        drawn = axes[name].imshow(field, cmap="gray", vmin=low, vmax=high, extent=extent)
    figure.colorbar(drawn, ax=axes["goal"], label="height above the level (mm)", shrink=0.7)
    drawn = axes["change"].imshow(-change, cmap="RdBu_r", vmin=-most, vmax=most, extent=extent)
    figure.colorbar(drawn, ax=axes["change"], label="too high, to sink: red, + (mm)", shrink=0.7)
    apart = CONTOURS * max(np.ceil(most / 6), 1.0)
    lines = apart * (np.arange(int(most / apart + 0.5)) + 0.5)  # off the level floors and tops
    if lines.size:
        axes["change"].contour(
            x, y, np.nan_to_num(change), levels=[*-lines[::-1], *lines], colors="k",
            linewidths=0.5, negative_linestyles="solid",
        )  # fmt: skip
    _draw_regions(axes["change"], goal)
    titles = {
        "bed": "the bed now",
        "goal": "the goal",
        "change": f"the bed now - the goal, a line every {apart:g} mm\n"
        "in the boxes: cm³ to take (-) and to bring (+)",
    }
    for name, text in titles.items():
        ax = axes[name]
        ax.set(xlim=(x0, x1), ylim=(-y1, -y0), xlabel="x (mm)")
        ax.set_title(text, fontsize=11)
        mark_unseen(ax, seen | ~bed.inside)
        ax.axhline(y[row], color="tab:green", linewidth=1.2, linestyle="--")
    axes["bed"].set_ylabel("y (mm)")
    said = f"cut along the dashed line, y = {y[row]:.0f} mm; heights are stretched"
    axes["cut"].set_title(said, fontsize=11, loc="left")
    _draw_cut(axes["cut"], goal, row, x, (x0, x1))
    if title:
        figure.suptitle(title)
    return figure


def _draw_regions(ax: Axes, goal: Goal) -> None:
    """The volume of each large region, cm³, where it is highest or deepest."""
    found = goal.transport
    least = LABELLED * (found.take_cm3 + found.bring_cm3)
    for regions, sign, colour in ((found.take, "-", "darkred"), (found.bring, "+", "navy")):
        for region in regions:
            if region.volume_cm3 < least:
                continue
            x, y = (1e3 * k for k in region.point)
            label = ax.text(x, -y, f"{sign}{region.volume_cm3:.{region.volume_cm3 < 9.95:d}f}",
                            color=colour, fontsize=9, ha="center", va="center")  # fmt: skip
            label.set_bbox({"facecolor": "white", "edgecolor": colour, "alpha": 0.85, "pad": 1.5})


def _draw_cut(ax: Axes, goal: Goal, row: int, x: np.ndarray, span: tuple[float, float]) -> None:
    """Bed, goal and what was asked for along one row of the map."""
    bed = goal.bed
    now, then, asked = (
        np.where(bed.seen[row], 1e3 * k[row], np.nan)
        for k in (bed.height, goal.height, bed.height + goal.wanted)
    )
    bottom = np.nanmin([now, then, asked]) - 4.0
    ax.fill_between(x, bottom, then, color="0.85", linewidth=0)
    ax.plot(x, asked, ":", color="tab:red", linewidth=1.3, label="asked for")
    ax.plot(x, now, color="0.45", linewidth=1.3, label="the bed now")
    ax.plot(x, then, color="tab:blue", linewidth=1.8, label="the goal")
    top = np.nanmax([now, then, asked]) + 3.0
    ax.set(xlim=span, ylim=(bottom, top), xlabel="x (mm)", ylabel="height (mm)")
    ax.grid(alpha=0.3)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=9, frameon=False)
