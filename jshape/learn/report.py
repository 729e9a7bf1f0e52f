"""Evaluations as tables (terminal, CSV, Markdown) and figures."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from jshape.errors import escaped
from jshape.learn.scores import Comparison, Score
from jshape.viz.style import own_style

COLOURS = ("tab:orange", "tab:blue", "tab:green", "tab:purple", "tab:red", "tab:brown")
"""Of predictors, in order of first appearance."""
FLOORS: tuple[dict[str, Any], ...] = (
    {"linestyle": "--", "label": "noise floor"},
    {"linestyle": ":", "label": "noise floor, at most"},
)
"""Lines of a known floor, and of one that is an upper estimate."""
Rows = list[tuple[str, ...]]


def _unique(items: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(items))


def _who(score: Score | Comparison) -> str:
    """The agent, or whose pairs were learned from to predict whose."""
    same = score.trained_on in ("", score.agent)
    return score.agent if same else f"{score.trained_on} -> {score.agent}"


def _mean(values: Iterable[float | None]) -> float | None:
    """The mean, unless one of them is unknown: means over other actions cannot be compared."""
    values = list(values)
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _floor(scores: Sequence[Score]) -> tuple[float | None, bool]:
    """The floor, mean over the actions, and whether it is only at most that."""
    mine = list({s.action: s for s in scores}.values())
    return _mean(s.floor_mm for s in mine), any(s.floor_from == "flat" for s in mine)


def _floor_text(scores: Sequence[Score]) -> str:
    floor, at_most = _floor(scores)
    return f"<= {_text(floor)}" if at_most and floor is not None else _text(floor)


def scores_table(scores: Sequence[Score]) -> tuple[tuple[str, ...], Rows]:
    """Head and rows: per action and agent, the errors of all predictors side by side, in mm.

    Where there are several, their ratio to the first's error follows.  A last row per agent holds
    the means over the actions that all predictors were tested on.
    """
    names = _unique(s.predictor for s in scores)
    head = ["action", "agent", "tested", "change (mm)", "floor (mm)"]
    head += [f"{name} (mm)" for name in names] + [f"{name} / {names[0]}" for name in names[1:]]
    cells: dict[tuple[str, str], dict[str, Score]] = {}
    for s in scores:
        # A bank that was not fitted here has no agent of its own: it stands beside all.
        cells.setdefault((s.action, _who(s)), {})[s.predictor] = s
    rows: Rows = []
    for who in _unique(who for _, who in cells):
        mine = [cell for (_, whom), cell in cells.items() if whom == who]
        rows += [_row(next(iter(c.values())).action, who, names, c) for c in mine]
        complete = [c for c in mine if len(c) == len(names)]
        if len(complete) > 1:
            rows.append(_row("mean", who, names, _averages(names, complete)))
    return tuple(head), rows


def _averages(names: Sequence[str], cells: Sequence[dict[str, Score]]) -> dict[str, Score]:
    """Means over actions of every predictor."""
    found = {}
    for name in names:
        mine = [cell[name] for cell in cells]
        mean, std, change = np.mean([(s.mean_mm, s.std_mm, s.change_mm) for s in mine], 0).tolist()
        floor, at_most = _floor(mine)
        how = "flat" if at_most else mine[0].floor_from
        count = sum(s.count for s in mine)
        found[name] = mine[0]._replace(
            count=count, mean_mm=mean, std_mm=std, change_mm=change, floor_mm=floor, floor_from=how
        )
    return found


def _row(action: str, who: str, names: Sequence[str], cell: dict[str, Score]) -> tuple[str, ...]:
    any_score = next(iter(cell.values()))
    row = [action, who, str(any_score.count), _text(any_score.change_mm), _floor_text([any_score])]
    row += [f"{cell[n].mean_mm:.2f} ± {cell[n].std_mm:.2f}" if n in cell else "-" for n in names]
    first = cell[names[0]].mean_mm if names[0] in cell else 0.0
    row += [_text(cell[n].mean_mm / first) if n in cell and first > 0 else "-" for n in names[1:]]
    return tuple(row)


def sizes_table(scores: Sequence[Score]) -> tuple[tuple[str, ...], Rows]:
    """Head and rows: mean error over the actions (mm) by agent and number of pairs fitted to."""
    names = _unique(s.predictor for s in scores)
    rows: Rows = []
    for agent in _unique(s.agent for s in scores):
        mine = [s for s in scores if s.agent == agent]
        for size in sorted({s.pairs for s in mine}):
            row = [agent, str(size) if size else "none", _floor_text(mine)]
            for name in names:
                found = [s for s in mine if (s.predictor, s.pairs) == (name, size)]
                means = (np.mean([getattr(s, of) for s in found]) for of in ("mean_mm", "std_mm"))
                row.append("{:.2f} ± {:.2f}".format(*means) if found else "")
            rows.append(tuple(row))
    return ("agent", "pairs", "floor (mm)", *(f"{name} (mm)" for name in names)), rows


def comparison_table(comparisons: Sequence[Comparison]) -> tuple[tuple[str, ...], Rows]:
    """Head and rows of paired comparisons."""
    head = ("action", "agent", "predictor", "against", "pairs", "difference (mm)", "better")
    rows = []
    for c in comparisons:
        gap, better = f"{c.difference_mm:+.3f} ± {c.error_mm:.3f}", f"{100 * c.better:.0f} %"
        rows.append((c.action, _who(c), c.predictor, c.against, str(c.count), gap, better))
    return head, rows


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(escaped, line))} |\n" for line in lines)


def scores_csv(scores: Sequence[Score]) -> str:
    """All numbers as CSV; an unknown floor is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(Score._fields)
    writer.writerows(["" if x is None else x for x in score] for score in scores)
    return stream.getvalue()


@own_style()
def scores_figure(scores: Sequence[Score]) -> Figure:
    """Bars of the error per action and predictor (mean, std), the change and the noise floor.

    One panel per agent, or per couple of agents where one learns for the other.
    """
    names, panels = _unique(s.predictor for s in scores), _unique(_who(s) for s in scores)
    actions = _unique(s.action for s in scores)
    columns = min(2, len(panels))
    lines = -(-len(panels) // columns)
    wide = max(4.0, 1.5 + 0.35 * len(actions) * (len(names) + 1.5))
    figure = Figure(figsize=(columns * wide, 3.4 * lines + 0.4), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False, sharey=True).reshape(-1)
    bar = 0.8 / (len(names) + 1)
    for ax, panel in zip(axes, panels, strict=False):
        mine = [s for s in scores if _who(s) == panel]
        for k, name in enumerate(["change by the action", *names]):
            found = [s for s in mine if k == 0 or s.predictor == name]
            found = list({s.action: s for s in found}.values())
            at = [actions.index(s.action) + (k - len(names) / 2) * bar for s in found]
            if k == 0:
                ax.bar(at, [s.change_mm for s in found], bar, color="0.85", label=name)
                continue
            mean, std = [s.mean_mm for s in found], [s.std_mm for s in found]
            style = {"color": COLOURS[(k - 1) % len(COLOURS)], "capsize": 2}
            ax.bar(at, mean, bar, yerr=std, label=f"error of {name or 'the bank'}", **style)
        for action, s in {s.action: s for s in mine if s.floor_mm is not None}.items():
            x, style = actions.index(action), FLOORS[s.floor_from == "flat"]
            ax.plot([x - 0.45, x + 0.45], [s.floor_mm] * 2, color="k", linewidth=1.2, **style)
        ax.set_xticks(range(len(actions)), actions)
        ax.set_title(panel, fontsize=10)
        ax.grid(axis="y", alpha=0.3)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for ax in axes[: len(panels) : columns]:
        ax.set_ylabel("mean distance over the ROI (mm)")
    known = {}
    for ax in axes:
        known |= dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    entry = 0.7 + 0.08 * max(map(len, known))  # inches that the longest takes at this size
    across = max(columns * wide, entry + 0.3)
    figure.set_size_inches(across, figure.get_figheight())
    ncols = min(3, max(1, int((across - 0.2) / entry)))
    style = {"loc": "outside lower center", "fontsize": 9, "ncols": ncols}
    figure.legend(known.values(), known.keys(), **style)
    return figure


@own_style()
def sizes_figure(scores: Sequence[Score]) -> Figure:
    """Error, mean over the actions, against the number of pairs fitted to; one panel per agent.

    What was not fitted (0 pairs) is a horizontal line; so is the noise floor where it is known for
    every action.  Bands are the mean standard deviation over the partitions.
    """
    names, agents = _unique(s.predictor for s in scores), _unique(s.agent for s in scores)
    figure = Figure(figsize=(5.2 * len(agents), 4.2), layout="constrained")
    axes = figure.subplots(1, len(agents), squeeze=False, sharey=True)[0]
    for ax, agent in zip(axes, agents, strict=True):
        mine = [s for s in scores if s.agent == agent]
        for k, name in enumerate(names):
            _curve(ax, [s for s in mine if s.predictor == name], name, COLOURS[k % len(COLOURS)])
        floor, at_most = _floor(mine)
        if floor is not None:
            ax.axhline(floor, color="k", linewidth=1.2, **FLOORS[at_most])
        sizes = sorted({s.pairs for s in mine if s.pairs})
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(sizes))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticklabels([str(size) for size in sizes])
        ax.set_xlabel("pairs per action fitted to")
        ax.set_title(agent, fontsize=10)
        ax.grid(alpha=0.3)
        ax.legend(fontsize=9)
    axes[0].set_ylabel("mean error over the ROI and the actions (mm)")
    axes[0].set_ylim(bottom=0)  # last: it stops all panels from growing with what is drawn
    return figure


def _curve(ax: Axes, scores: Sequence[Score], name: str, colour: str) -> None:
    """One predictor's error over the sizes."""
    sizes = sorted({s.pairs for s in scores})
    mean, std = (
        np.array([np.mean([getattr(s, of) for s in scores if s.pairs == n]) for n in sizes])
        for of in ("mean_mm", "std_mm")
    )
    if sizes == [0]:
        ax.axhline(float(mean[0]), color=colour, linestyle="-.", label=name)
    elif sizes:
        ax.plot(sizes, mean, "o-", color=colour, label=name)
        ax.fill_between(sizes, mean - std, mean + std, color=colour, alpha=0.15, linewidth=0)
