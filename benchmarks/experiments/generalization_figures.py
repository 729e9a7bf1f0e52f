"""Figures of predictors in situations that they were not made for."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.open_loop import Outcome
from benchmarks.experiments.shaping_figures import Row, rows_figure

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


def examples_figure(examples: Mapping[str, Sequence[Outcome]], names: Sequence[str]) -> Figure:
    """A problem of each situation: I0, I*, what two predictors' plans predict, and d.

    Args:
      examples: per situation what each predictor made of it.
      names: of the two predictors.
    """
    rows = []
    for situation, told in examples.items():
        shown = [next(one for one in told if one.method.where == name) for name in names]
        first = shown[0].plan
        images = {"initial": first.images[0], "wanted": first.goal} | {
            f"{name} predicts {one.plan.distances_mm[-1]:.2f} mm": one.plan.images[-1]
            for name, one in zip(names, shown, strict=True)
        }
        rows.append(Row(situation, images, names, shown))
    return rows_figure(rows)
