"""Figures of molded goals: their images and distances, and the tree that was searched."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from benchmarks.experiments.open_loop import Outcome
from jshape.viz import pictures
from jshape.viz.maps import span
from jshape.viz.overlay import COLOURS

LINES = (("tab:blue", "o"), ("tab:orange", "^"), ("tab:green", "s"), ("tab:purple", "D"))
"""Of predictors in a plot of distances."""


class Candidate(NamedTuple):
    """One action that a search could take next."""

    action: str
    position: tuple[int, int]
    """(u, v) pixels."""
    distance_mm: float
    """D that is predicted after it."""
    chosen: bool
    """Greedy search takes it."""


class Row(NamedTuple):
    """One molded goal as a line of a figure."""

    name: str
    images: Mapping[str, ArrayLike]
    """Four by their titles; the first two, I0 and I*, set the grey scale."""
    who: Sequence[str]
    """What is said of each outcome."""
    outcomes: Sequence[Outcome]
    """Whose distances."""


Tree = Sequence[Sequence[Candidate]]
"""The best candidates of each step, best first; the last step is the one where nothing helps."""


def outcomes_figure(
    names: Sequence[str], shown: Sequence[Outcome], all_of: Sequence[Sequence[Outcome]]
) -> Figure:
    """Per problem I0, I*, what was predicted, what came out, and d after each action.

    Args:
      names: of the problems.
      shown: whose images.
      all_of: per problem, whose distances; "f_D, 15 places" is what is said of each.
    """
    rows = []
    for name, outcome, every in zip(names, shown, all_of, strict=True):
        plan = outcome.plan
        images = {
            "initial": plan.images[0],
            "wanted": plan.goal,
            f"predicted, {plan.distances_mm[-1]:.2f} mm": plan.images[-1],
            f"obtained, {outcome.distances_mm[-1]:.2f} mm": outcome.images[-1],
        }
        who = [f"{one.method.predictor}, {one.method.where}" for one in every]
        rows.append(Row(name, images, who, every))
    return rows_figure(rows)


def rows_figure(rows: Sequence[Row]) -> Figure:
    """A row of images and distances for each problem, one legend for all."""
    figure = Figure(figsize=(11, 1.75 * len(rows) + 0.9), layout="constrained")
    axes = figure.subplots(len(rows), 5, squeeze=False, width_ratios=(1, 1, 1, 1, 1.25))
    for line, row in zip(axes, rows, strict=True):
        camera = row.outcomes[0].plan.camera
        heights = [pictures.height_mm(np.asarray(i), camera) for i in row.images.values()]
        low, high = span(heights)
        for ax, title, height in zip(line, row.images, heights, strict=False):
            ax.imshow(height, cmap="gray", vmin=low, vmax=high)
            ax.set(xticks=[], yticks=[])
            ax.set_title(title, fontsize=9)
        line[0].set_ylabel(row.name, fontsize=9)
        line[0].set_xlabel(f"black {low:.0f}, white {high:.0f} mm", fontsize=8)
        _draw_distances(line[4], row.who, row.outcomes)
    axes[0, 4].set_title("d to the goal (mm)", fontsize=9)
    axes[-1, 4].set_xlabel("actions applied", fontsize=9)
    handles, labels = axes[0, 4].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _draw_distances(ax: Axes, names: Sequence[str], outcomes: Sequence[Outcome]) -> None:
    """Predicted (dashed) and obtained distances of each outcome."""
    for (colour, mark), who, outcome in zip(LINES, names, outcomes, strict=False):
        style = {"color": colour, "marker": mark, "markersize": 3.5, "linewidth": 1.2}
        predicted = outcome.plan.distances_mm
        ax.plot(range(len(predicted)), predicted, linestyle="--", label=f"{who}: predicted",
                markerfacecolor="white", **style)  # fmt: skip
        ax.plot(range(len(outcome.distances_mm)), outcome.distances_mm, label=f"{who}: obtained",
                **style)  # fmt: skip
    ax.set_ylim(bottom=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.tick_params(labelsize=8)
    ax.grid(alpha=0.3)


def tree_figure(names: Sequence[str], starts_mm: Sequence[float], trees: Sequence[Tree]) -> Figure:
    """The best candidates at each step with their predicted d; the path taken is bold, on top.

    Args:
      names: of the problems, one above the other.
      starts_mm: d before any action.
      trees: of the searches.
    """
    deepest = max(len(tree) for tree in trees)
    most = max(len(layer) for tree in trees for layer in tree)
    size = max(11.0, 1.75 * (deepest + 1)), len(names) * (0.42 * most + 0.55)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(names), 1, squeeze=False)[:, 0]
    for ax, name, start, tree in zip(axes, names, starts_mm, trees, strict=True):
        _label(ax, 0.0, 0.0, f"start\n{start:.2f} mm", "0.2", True)
        for step, layer in enumerate(tree):
            for rank, candidate in enumerate(layer):
                _edge(ax, step, rank, candidate)
                u, v = candidate.position
                text = f"{candidate.action} ({u}, {v})\n{candidate.distance_mm:.3f} mm"
                colour = COLOURS.get(candidate.action, "0.5")
                _label(ax, step + 1.0, -float(rank), text, colour, candidate.chosen)
            if not any(candidate.chosen for candidate in layer):
                ax.text(step + 1, 0.62, "none lowers d: stop", fontsize=7.5, ha="center",
                        va="bottom", color="0.35", style="italic")  # fmt: skip
        ax.set(xlim=(-0.45, deepest + 0.5), ylim=(0.4 - most, 1.0))
        ax.set_title(name, fontsize=9, loc="left")
        ax.set_axis_off()
    return figure


def _edge(ax: Axes, step: int, rank: int, to: Candidate) -> None:
    """A line from the path after so many steps to one of what may come next."""
    colour = COLOURS.get(to.action, "0.5") if to.chosen else "0.75"
    ax.plot([step, step + 1], [0, -rank], color=colour, linewidth=3.0 if to.chosen else 0.8,
            zorder=1)  # fmt: skip


def _label(ax: Axes, x: float, y: float, text: str, colour: str, chosen: bool) -> None:
    """A node: filled if it is on the path."""
    ax.text(
        x, y, text, ha="center", va="center", fontsize=7.5, zorder=2, linespacing=1.05,
        color="white" if chosen else "black", fontweight="bold" if chosen else "normal",
        bbox={"boxstyle": "round,pad=0.25", "linewidth": 1.0, "edgecolor": colour,
              "facecolor": colour if chosen else "white"},
    )  # fmt: skip
