"""The planning benchmark as tables and figures."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jshape.learn.report import Rows
from jshape.viz.overlay import COLOURS
from jshape.viz.style import own_style

TITLES = {
    "applied": "Goals that another hand made",
    "shape": "Goals that no action made",
    "mpm": "Recorded sequences of an independent simulation",
}
"""Of the kinds of problems."""
STYLES = {"open": {"alpha": 0.5, "linestyle": "--"}, "closed": {"alpha": 1.0, "linestyle": "-"}}
TALLEST = 130.0
"""Per cent at which bars and curves are cut: random actions leave several times the distance."""


class Tile(NamedTuple):
    """One picture of the contact sheet."""

    title: str
    depth_mm: np.ndarray
    """(H, W)."""


def tables(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, tuple[str, ...], Rows]]:
    """Title, head and rows of a table per kind of problems, from the rows of a summary."""
    return [
        (TITLES[kind], *_TABLES[kind]([row for row in rows if row["kind"] == kind]))
        for kind in dict.fromkeys(row["kind"] for row in rows)
    ]


def _applied(rows: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, ...], Rows]:
    head = ("method", "loop", "problems", "left, % (95 %)", "efficiency, %", "seen, %", "actions",
            "retrieved, %", "exact, %", "deep knock is one, %", *_COST)  # fmt: skip
    return head, [
        (*_start(row), *_left(row), _per_cent(row["seen_left"]), _number(row["actions"]),
         *(_per_cent(row[name]) for name in ("retrieved", "exact", "one_knock")), *_cost(row))
        for row in rows
    ]  # fmt: skip


def _shape(rows: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, ...], Rows]:
    families = list(dict.fromkeys(name for row in rows for name in row["families"]))
    head = ("method", "loop", "problems", "left, % (95 %)", "efficiency, %", "seen, %", "actions",
            *(f"{name}, %" for name in families), *_COST)  # fmt: skip
    return head, [
        (*_start(row), *_left(row), _per_cent(row["seen_left"]), _number(row["actions"]),
         *(_left(row["families"].get(name))[0] for name in families), *_cost(row))
        for row in rows
    ]  # fmt: skip


def _mpm(rows: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, ...], Rows]:
    head = ("method", "loop", "problems", "predicted left, %", "efficiency, %", "actions planned",
            "retrieved, %", "exact, %", *_COST[:1], *_COST[2:])  # fmt: skip
    return head, [
        (*_start(row), _per_cent(row["predicted_left"]), _per_cent(row["efficiency"]),
         _number(row["planned"]), _per_cent(row["retrieved"]), _per_cent(row["exact"]),
         *_cost(row)[:1], *_cost(row)[2:])
        for row in rows
    ]  # fmt: skip


_TABLES = {"applied": _applied, "shape": _shape, "mpm": _mpm}
_COST = ("first plan, s", "from look to action, s", "predictions of the first plan")


def _start(row: Mapping[str, Any]) -> tuple[str, ...]:
    failed = f" ({row['failed']} failed)" if row["failed"] else ""
    return row["method"], row["loop"], f"{row['problems']}{failed}"


def _cost(row: Mapping[str, Any]) -> tuple[str, ...]:
    many = row["evaluations"]
    return (
        _number(row["seconds"], 2), _number(row["seconds_per_look"], 2),
        "-" if many is None else f"{many:,.0f}",
    )  # fmt: skip


def _left(row: Mapping[str, Any] | None) -> tuple[str, str]:
    """What is left with its interval, and the efficiency."""
    if row is None or row["left"] is None:
        return "-", "-"
    low, high = (100 * row[name] for name in ("left_low", "left_high"))
    return f"{100 * row['left']:.1f} ({low:.1f}-{high:.1f})", _per_cent(row["efficiency"])


def _per_cent(value: float | None) -> str:
    return _number(None if value is None else 100 * value)


def _number(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


@own_style()
def left_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Bars of what is left of the distance, with 95 % intervals: a panel per kind of problems."""
    kinds, loops = (list(dict.fromkeys(row[name] for row in rows)) for name in ("kind", "loop"))
    names = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(
        figsize=(max(5.0, 0.75 * len(names) + 1) * len(kinds), 4.2), layout="constrained"
    )
    axes = figure.subplots(1, len(kinds), squeeze=False, sharey=True)[0]
    wide = 0.8 / len(loops)
    for ax, kind in zip(axes, kinds, strict=True):
        for row in (row for row in rows if row["kind"] == kind):
            left, low, high = (100 * row[name] for name in ("left", "left_low", "left_high"))
            place = loops.index(row["loop"])
            at = names.index(row["method"]) + (place - (len(loops) - 1) / 2) * wide
            colour = ("0.65", "tab:blue")[place == len(loops) - 1]
            ax.bar(at, left, wide, color=colour)
            ax.plot([at, at], [low, high], color="k", linewidth=1.2)
            ax.text(at, min(high, TALLEST - 9) + 1.5, f"{left:.0f}", ha="center", fontsize=7)
        ax.axhline(100, color="k", linewidth=0.8, linestyle=":")
        ax.set_xticks(range(len(names)), names, rotation=30, ha="right")
        many = max(row["problems"] for row in rows if row["kind"] == kind)
        ax.set_title(f"{TITLES[kind]} ({many})", fontsize=10)
        ax.grid(axis="y", alpha=0.3)
    axes[0].set_ylim(0, TALLEST)
    axes[0].set_ylabel("distance left (% of that at the start)")
    colours = ["0.65", "tab:blue"] if len(loops) == 2 else ["tab:blue"]
    marks = [Line2D([], [], color=c, linewidth=7, label=f"{loop} loop")
             for c, loop in zip(colours, loops, strict=True)]  # fmt: skip
    axes[0].legend(handles=marks, fontsize=8, loc="upper left")
    return figure


@own_style()
def curves_figure(runs: Sequence[Mapping[str, Any]]) -> Figure:
    """Mean share of the distance left over the actions; a run that has ended stays as it is."""
    kinds, names = (list(dict.fromkeys(run[key] for run in runs)) for key in ("kind", "method"))
    longest = max(len(run["true_mm"]) for run in runs)
    figure = Figure(figsize=(5.6 * len(kinds), 4.4), layout="constrained")
    axes = figure.subplots(1, len(kinds), squeeze=False, sharey=True)[0]
    for ax, kind in zip(axes, kinds, strict=True):
        for loop in dict.fromkeys(run["loop"] for run in runs):
            for k, name in enumerate(names):
                who = (kind, name, loop)
                mine = [run["true_mm"] for run in runs
                        if (run["kind"], run["method"], run["loop"]) == who]  # fmt: skip
                if not mine:
                    continue
                mean = np.mean([_carried(d, longest) for d in mine], 0)
                ax.plot(100 * mean, color=f"C{k % 10}", label=f"{name}, {loop}", **STYLES[loop])
        ax.set(xlabel="actions applied", ylim=(0, TALLEST))
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_title(TITLES[kind], fontsize=10)
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("distance left (% of that at the start)")
    lines, labels = axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", fontsize=8, ncols=4)
    return figure


def _carried(distances: Sequence[float], count: int) -> np.ndarray:
    values = np.array(distances) / distances[0]
    return np.pad(values, (0, count - len(values)), mode="edge")


@own_style()
def gains_figure(
    runs: Sequence[Mapping[str, Any]], errors_mm: Mapping[str, Mapping[str, float]]
) -> Figure:
    """Gain predicted against gain obtained of every action, a panel per method.

    Args:
      runs: with the steps of each; of two loops the last is drawn, which predicts each action from
        what it has just seen.
      errors_mm: per method and action, the usual error of one prediction (error_margin 1): an
        upright line in the action's colour, left of which a gain may be none.
    """
    loop = list(dict.fromkeys(run["loop"] for run in runs))[-1]
    names = list(dict.fromkeys(run["method"] for run in runs))
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.4 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).reshape(-1)
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    explained = ""
    for ax, name in zip(axes, names, strict=False):
        steps = [step for run in runs if (run["method"], run["loop"]) == (name, loop)
                 for step in run["steps"]]  # fmt: skip
        dotted: list[float] = []
        for action in dict.fromkeys(step["action"] for step in steps):
            mine = [step for step in steps if step["action"] == action]
            predicted, obtained = (
                [step[key] for step in mine] for key in ("predicted_gain_mm", "gain_mm")
            )
            colour = COLOURS.get(action, "0.5")
            ax.plot(predicted, obtained, ".", color=colour, markersize=4, alpha=0.6, label=action)
            if errors_mm.get(name, {}).get(action):
                dotted.append(errors_mm[name][action])
                ax.axvline(dotted[-1], color=colour, linewidth=1, linestyle=":")
        _one_to_one(ax, steps, dotted)
        explained = explained or ("\ndotted: usual error of it" if dotted else "")
        ax.set_title(f"{name} ({len(steps)} actions)", fontsize=10)
        ax.grid(alpha=0.3)
        if steps:
            ax.legend(fontsize=7, loc="lower right", framealpha=0.4)  # points may lie below it
    figure.supxlabel(f"gain predicted (mm), {loop} loop{explained}", fontsize=10)
    figure.supylabel("gain obtained (mm)", fontsize=10)
    return figure


def _one_to_one(ax: Axes, steps: Sequence[Mapping[str, Any]], upright: Sequence[float]) -> None:
    """The line of predictions that hold; axes with every gain and every upright line in them."""
    ax.axhline(0, color="k", linewidth=0.5)
    predicted, obtained = (
        [0.0, *(step[key] for step in steps)] for key in ("predicted_gain_mm", "gain_mm")
    )
    reach = max(1e-3, *predicted, *obtained, *upright)
    ax.plot([min(predicted), reach], [min(predicted), reach], color="k", linewidth=0.8)
    for values, limit in ((predicted, ax.set_xlim), (obtained, ax.set_ylim)):
        margin = 0.04 * (reach - min(values))
        limit(min(values) - margin, reach + margin)


@own_style()
def sheet_figure(rows: Sequence[Sequence[Tile]]) -> Figure:
    """Beds side by side, a row per problem on one grey scale, higher is brighter."""
    columns = max((len(row) for row in rows), default=1)
    lines = max(len(rows), 1)
    figure = Figure(figsize=(1.75 * columns, 1.85 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False)
    for ax in axes.reshape(-1):
        ax.set_axis_off()
    for line, row in zip(axes, rows, strict=False):
        low, high = np.percentile(np.stack([tile.depth_mm for tile in row[:2]]), (0.5, 99.5))
        for ax, tile in zip(line, row, strict=False):
            # Beyond the range: a level bed is not white.
            ax.imshow(tile.depth_mm[::2, ::2], cmap="gray_r", vmin=low - 3, vmax=high + 1)
            ax.set_title(tile.title, fontsize=7)
    return figure
