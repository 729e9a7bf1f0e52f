"""Figures of the parts `distances` and `ranking`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.metric_growth import Growth

COLOURS = {"d": "tab:orange", "cv2": "0.3", "np.": "0.5", "depth": "tab:olive", "making": "0.65",
           "Chamfer": "tab:blue", "ICP": "tab:purple", "EMD": "tab:red",
           "sliced": "tab:pink", "entropic": "tab:brown"}  # fmt: skip


def times(
    rows: Sequence[Mapping[str, Any]],
    moved: Sequence[Mapping[str, Any]],
    growths: Mapping[tuple[str, str], Growth],
    pixels: int,
) -> Figure:
    """Time against pixels for every method; dotted to `pixels` where it is extrapolated."""
    lines: dict[str, list[tuple[int, float]]] = {}
    for row in rows:
        lines.setdefault(row["method"], []).append((row["points"], row["seconds"]))
    for row in moved:
        name = f"{row['method']}, {row['choice']}"
        lines.setdefault(name, []).append((row["points"], row["seconds"]))
    figure = Figure(figsize=(9.6, 6.2), layout="constrained")
    ax = figure.subplots()
    ends = []
    for name, line in lines.items():
        at, took = np.array(sorted(line)).T
        ax.plot(at, took, _style(name) + "-", color=_colour(name), markersize=4, linewidth=1.5)
        ends.append((float(took[-1]), float(at[-1]), name))
    for (method, choice), fit in growths.items():
        name = f"{method}, {choice}"
        at = max(n for n, _ in lines[name])
        ax.plot([at, pixels], [fit.at(at), fit.at(pixels)], ":", color=_colour(name))
        ax.plot(pixels, fit.at(pixels), "o", markerfacecolor="white", color=_colour(name))
        ends = [(fit.at(pixels), float(pixels), n) if n == name else (t, x, n) for t, x, n in ends]
    ax.set(xscale="log", yscale="log", xlabel="points of each cloud, pixels of each image",
           ylabel="time of one comparison (s)")  # fmt: skip
    ax.grid(alpha=0.3)
    _labels(ax, ends)
    return figure


def ranking(
    curves: Mapping[str, np.ndarray], greedy: Sequence[Mapping[str, Any]], random: float
) -> Figure:
    """Left: distances along sequences.  Right: actions that greedy finds, against its time.

    `random` is the share that is found by choosing at random, the dotted line.
    """
    figure = Figure(figsize=(9.6, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, values in curves.items():
        share = (values / values[:, :1]).mean(0)
        left.plot(np.arange(len(share)), share, _style(name) + "-", color=_colour(name),
                  label=name, markersize=5)  # fmt: skip
    left.set(xlabel="actions of the sequence applied", ylabel="distance, share of the start",
             ylim=(0, None))  # fmt: skip
    left.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9)
    for row in greedy:
        right.plot(1e3 * row["seconds"], 100 * row["retrieved"], _style(row["method"]),
                   color=_colour(row["method"]), markersize=8)  # fmt: skip
    right.axhline(100 * random, color="0.6", linestyle=":")
    right.set(xscale="log", xlabel="time of comparing the candidates of a step (ms)",
              ylabel="applied actions that are found (%)", ylim=(0, 105))  # fmt: skip
    right.grid(alpha=0.3)
    return figure


def _style(name: str) -> str:
    return "s" if "random" in name or "scipy" in name else "^" if "same" in name else "o"


def _colour(name: str) -> str:
    begins = (c for known, c in COLOURS.items() if known != "d" and name.startswith(known))
    return COLOURS["d"] if name == "d" else next(begins, "k")


def _labels(ax: Any, ends: Sequence[tuple[float, float, str]]) -> None:
    """Names right of the axes, moved apart, with a thin line from where each curve ends."""
    low, high = (np.log10(x) for x in ax.get_ylim())
    gap = (high - low) / 27
    place = -np.inf
    for took, at, name in sorted(ends):
        place = max(np.log10(took), place + gap)
        ax.annotate(
            name, (at, took), (1.03, (place - low) / (high - low)), textcoords="axes fraction",
            fontsize=9, color=_colour(name), va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": _colour(name), "alpha": 0.35, "linewidth": 0.7},
        )  # fmt: skip
