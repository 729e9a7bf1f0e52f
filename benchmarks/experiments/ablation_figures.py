"""The components of f_P as bars."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

FIRST, LAST, STEP = "tab:orange", "tab:blue", "0.6"
"""Colours of f_D and f_P, as in the other experiments, and of what lies between them."""


def bars_figure(means: Sequence[Sequence[dict[str, Any]]], parts: Sequence[str]) -> Figure:
    """A row of panels per set of pairs and agent: components added to f_D, and left out of f_P.

    Args:
      means: per row its lines, as `ablation.mean_over_actions` gives them.
      parts: "added" and "left out", the columns.
    """
    longest = [max(sum(line["part"] == part for line in mean) for part in parts) for mean in means]
    figure = Figure(
        figsize=(11.8, 0.9 + sum(0.9 + 0.27 * n for n in longest)), layout="constrained"
    )
    axes = figure.subplots(
        len(means), len(parts), squeeze=False, gridspec_kw={"height_ratios": longest}
    )
    for row, mean in zip(axes, means, strict=True):
        ends = [line["mean_mm"] + line["std_mm"] for line in mean]
        for ax, part in zip(row, parts, strict=True):
            lines = [line for line in mean if line["part"] == part]
            _bars(ax, lines)
            ax.set_xlim(0, 1.22 * max(ends))
            ax.set_title(f"{mean[0]['set']}, {mean[0]['agent']}\n{part}", fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("mean distance over the ROI (mm)")
    return figure


def _bars(ax: Axes, lines: Sequence[dict[str, Any]]) -> None:
    """One panel: horizontal bars from above, with their numbers."""
    whole = next(line["mean_mm"] for line in lines if line["predictor"] == "f_P")
    labels = []
    for at, line in enumerate(lines):
        name, mean, std = line["predictor"], line["mean_mm"], line["std_mm"]
        colour = {"f_D": FIRST, "f_P": LAST}.get(name, STEP)
        ax.barh(at, mean, 0.7, xerr=std, capsize=2, color=colour)
        ax.text(mean + std, at, f"  {mean:.2f}", va="center", fontsize=8)
        said = line["component"] if line["step"] else f"{name}: {line['component']}"
        labels.append(f"{said} = f_P" if name == "f_P" and line["step"] else said)
    ax.axvline(whole, color=LAST, linestyle="--", linewidth=1)
    ax.set_yticks(range(len(lines)), labels, fontsize=8)
    ax.invert_yaxis()
    ax.grid(axis="x", alpha=0.3)
    ax.set_axisbelow(True)
