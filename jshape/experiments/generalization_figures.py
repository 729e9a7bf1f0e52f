"""Figures of predictors in situations that they were not made for."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jshape.experiments.carried import Story
from jshape.experiments.shaping_figures import draw_distances
from jshape.viz import pictures

COLOURS = ("tab:gray", "tab:blue", "tab:olive", "tab:orange", "tab:red")
"""Of predictors, in their order."""


def left_figure(
    rows: Sequence[Mapping[str, Any]], situations: Sequence[str], names: Sequence[str]
) -> Figure:
    """Bars per situation and predictor: plans that are what was applied, and what is left of d.

    Args:
      rows: of the result.
      situations: in order.
      names: of the predictors, in order.
    """
    figure = Figure(figsize=(11, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    width = 0.85 / len(names)
    at = np.arange(len(situations), dtype=float)
    for k, (name, colour) in enumerate(zip(names, COLOURS, strict=False)):
        x = at + (k - (len(names) - 1) / 2) * width
        found, obtained, predicted = (
            [_mean(rows, what, situation, name) for situation in situations]
            for what in ("exact", "obtained_left", "predicted_left")
        )
        above.bar(x, found, 0.92 * width, color=colour, label=name)
        below.bar(x, obtained, 0.92 * width, color=colour)
        said = "predicted" if k == 0 else None
        below.plot(x, predicted, "_", color="black", markersize=11, label=said)
    above.set(ylabel="exact plans (%)", ylim=(0, 105))
    below.set_ylabel("left of d (%)")
    below.axhline(100, color="0.4", linewidth=0.8, linestyle=":")
    below.set_xticks(at, situations)
    below.set_ylim(bottom=0)
    for ax in (above, below):
        ax.grid(axis="y", alpha=0.3)
        ax.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=len(names) + 1, fontsize=9)
    return figure


def _mean(rows: Sequence[Mapping[str, Any]], what: str, situation: str, name: str) -> float:
    """In per cent."""
    mine = [r[what] for r in rows if (r["situation"], r["name"]) == (situation, name)]
    return 100 * float(np.mean(mine)) if mine else float("nan")


def examples_figure(examples: Mapping[str, Sequence[Story]], names: Sequence[str]) -> Figure:
    """A problem of each situation: I0, I*, what two predictors' plans predict, and d.

    Args:
      examples: per situation what each predictor made of it.
      names: of the two predictors.
    """
    figure = Figure(figsize=(11, 1.75 * len(examples) + 0.9), layout="constrained")
    axes = figure.subplots(len(examples), 5, squeeze=False, width_ratios=(1, 1, 1, 1, 1.25))
    for line, (situation, told) in zip(axes, examples.items(), strict=True):
        shown = [next(one for one in told if one.entry.where == name) for name in names]
        first = shown[0].plan
        images = {"initial": first.images[0], "wanted": first.goal} | {
            f"{name} predicts {one.plan.distances_mm[-1]:.2f} mm": one.plan.images[-1]
            for name, one in zip(names, shown, strict=True)
        }
        heights = [pictures.height_mm(np.asarray(i), first.camera) for i in images.values()]
        low, high = np.percentile(heights[:2], (0.5, 99.5))
        high = max(high, low + 5)
        for ax, title, height in zip(line, images, heights, strict=False):
            ax.imshow(height, cmap="gray", vmin=low, vmax=high)
            ax.set(xticks=[], yticks=[])
            ax.set_title(title, fontsize=9)
        line[0].set_ylabel(situation, fontsize=9)
        line[0].set_xlabel(f"black {low:.0f}, white {high:.0f} mm", fontsize=8)
        draw_distances(line[4], names, shown)
    axes[0, 4].set_title("d to the goal (mm)", fontsize=9)
    axes[-1, 4].set_xlabel("actions applied", fontsize=9)
    handles, labels = axes[0, 4].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return figure
