"""What a plan costs as the image, the candidates and the steps grow."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import jshape
from benchmarks.plan_as_authors import authors_way
from benchmarks.planning import smooth_bank
from benchmarks.problems import Problem, made_problem, scaled, sized
from benchmarks.report import Report
from jshape.actions import PAPER_ROIS, PAPER_Z
from jshape.models.bank import Bank
from jshape.planning.candidates import dense_positions
from jshape.planning.options import DEFAULT_BANK

Lines = Mapping[str, Sequence[tuple[float, float]]]
"""Of each line its points (size, seconds)."""

LOOKS = {
    "the authors' way": ("tab:red", "s"),
    "the authors' way, tuned": ("tab:orange", "D"),
    "reference twin": ("tab:gray", "v"),
    "jshape, f_D": ("tab:blue", "o"),
    "jshape, f_P": ("tab:green", "^"),
}
"""Colour and marker of each line."""
PIXELS = "pixels of the image"


def curves(report: Report, out: Path) -> None:
    """Costs as the image, the candidates and the steps grow; the paper's three actions."""
    pressed = jshape.load_bank(DEFAULT_BANK)
    names = tuple(PAPER_ROIS)
    pressed = replace(
        pressed, actions=names, errors_mm=None, intervals=None,
        predictors=tuple(pressed.predictor(name) for name in names),
    )  # fmt: skip
    box = jshape.PAPER_BOX
    first: dict[str, float] = {}
    panels: dict[tuple[str, str], dict[str, list[tuple[float, float]]]] = {}
    rows = []

    def measure(panel, size, label, problems: dict[str, Problem], steps: int, slow: Sequence[str]):
        calls: dict[str, Callable[[], object]] = {}
        for name, problem in problems.items():
            calls[name] = lambda p=problem: p.ours(steps)
            first[f"{name}, {label}"] = once(calls[name])
        flat = problems["jshape, f_D"]
        others = {
            "the authors' way": lambda: authors_way(flat, steps),
            "the authors' way, tuned": lambda: authors_way(flat, steps, tuned=True),
            "reference twin": lambda: flat.twin(steps),
        }
        calls |= {name: call for name, call in others.items() if name in slow}
        took = in_rounds(calls, most=0.5)
        for name, seconds in took.items():
            panels.setdefault(panel, {}).setdefault(name, []).append((size, seconds))
        rows.append((label, *(f"{1e3 * took[n]:.3g}" if n in took else "" for n in LOOKS)))

    everyone = tuple(LOOKS)[:3]
    panel = ("45 candidates, 1 step", PIXELS)
    for width, height, times in ((240, 198, 0.5), (480, 395, 1), (848, 480, 1), (1280, 720, 1.5)):
        camera = scaled(box, width, height, times)
        rois = sized(PAPER_ROIS, times)
        banks = {"jshape, f_D": smooth_bank(rois, camera),
                 "jshape, f_P": pressed.seen_by(camera, PAPER_Z)}  # fmt: skip
        problems = {
            name: made_problem(bank, _places(bank, (5, 3)), 4) for name, bank in banks.items()
        }
        slow = everyone if width < 1280 else everyone[:2]
        label = f"{width}x{height}, 45 candidates, 1 step"
        measure(panel, width * height, label, problems, 1, slow)

    flat = smooth_bank(PAPER_ROIS)
    panel = ("480x395, 1 step", "candidates")
    # Each number of candidates is compiled anew: f_P, whose line is flat at first, at three.
    for grid, slow, ground in (
        ((5, 1), 3, False), ((5, 3), 3, True), ((7, 5), 3, False), ((21, 15), 2, True),
        (None, 0, True),
    ):  # fmt: skip
        banks = {"jshape, f_D": flat} | ({"jshape, f_P": pressed} if ground else {})
        problems = {
            name: made_problem(bank, _places(bank, grid), 4) for name, bank in banks.items()
        }
        count = problems["jshape, f_D"].count
        label = f"480x395, {count} candidates, 1 step"
        measure(panel, count, label, problems, 1, everyone[:slow])

    panel = ("480x395, 45 candidates", "steps")
    problems = {
        name: made_problem(bank, _places(bank, (5, 3)), 24, strengths=(0.6, 1.4))
        for name, bank in (("jshape, f_D", flat), ("jshape, f_P", pressed))
    }
    for steps in (1, 2, 4, 8, 16):
        slow = everyone if steps <= 4 else everyone[:2]
        measure(panel, steps, f"480x395, 45 candidates, max_steps {steps}", problems, steps, slow)

    draw(panels, out / "authors_growth.png")
    report.table("Costs as they grow, ms.", ("plan", *LOOKS), rows)
    label = "848x480, 45 candidates, 1 step"  # planned nowhere before
    compiled = first[f"jshape, f_D, {label}"]
    report.add("the first plan of a new image size, compiling: f_D", compiled, "s")
    report.add("the same: f_P", first[f"jshape, f_P, {label}"], "s")
    third = {name: points[2][1] for name, points in panels["45 candidates, 1 step", PIXELS].items()}
    saved = third["the authors' way"] - third["jshape, f_D"]
    report.add("such plans of f_D until compiling has paid against the authors' way",
               compiled / saved, "")  # fmt: skip


def _places(bank: Bank, grid: tuple[int, int] | None) -> dict[str, np.ndarray]:
    """The same grid for all actions; None is every third pixel."""
    if grid is None:
        return dense_positions(bank, 3)
    at = jshape.grid(bank.camera, *grid, margin=bank.largest_roi)
    return dict.fromkeys(bank.actions, at)


def in_rounds(
    calls: Mapping[str, Callable[[], object]],
    *,
    rounds: int = 7,
    most: float = 1.0,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median seconds of each call, in rounds that take turns; what is compiled must be warm.

    Unlike `timing.in_turns` for calls of very different length: one that has taken `most` seconds
    leaves the others alone.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            if sum(times[name]) < most:
                times[name].append(once(call, clock))
    return {name: float(np.median(taken)) for name, taken in times.items()}


def once(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one call."""
    start = clock()
    call()
    return clock() - start


def draw(panels: Mapping[tuple[str, str], Lines], path: Path) -> None:
    """Cost curves: log-log, each line labelled at its end.

    Args:
      panels: lines by (title, label of the horizontal axis).
      path: of the PNG to write.
    """
    figure = Figure(figsize=(5.2 * len(panels), 4.6), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, ((title, label), lines) in zip(axes, panels.items(), strict=True):
        for name, points in lines.items():
            colour, marker = LOOKS[name]
            sizes, seconds = np.array(points).T
            ax.loglog(sizes, 1e3 * seconds, color=colour, marker=marker, ms=5, lw=1.6)
        sizes = sorted({size for points in lines.values() for size, _ in points})
        ax.set_xlim(sizes[0] / 1.3, sizes[-1] * (sizes[-1] / sizes[0]) ** 0.55)
        ax.set_xticks(sizes, [f"{size:,.0f}" for size in sizes], rotation=40, ha="right")
        ax.minorticks_off()
        ax.set_title(title, fontsize=10)
        ax.set_xlabel(label)
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("a whole plan (ms)")
    for ax, lines in zip(axes, panels.values(), strict=True):  # the common scale is known now
        _label_ends(ax, lines)
    figure.savefig(path, dpi=110)


def _label_ends(ax, lines: Lines) -> None:
    """Each line's name beside its last point, moved apart where two would overlap."""
    low, high = np.log10(ax.get_ylim())
    least, below = (high - low) / 20, -np.inf
    for name in sorted(lines, key=lambda name: lines[name][-1][1]):
        size, seconds = lines[name][-1]
        at = max(np.log10(1e3 * seconds), below + least)
        below = at
        ax.annotate(
            name, (size, 10**at), (7, 0), textcoords="offset points",
            color=LOOKS[name][0], fontsize=8.5, va="center",
        )  # fmt: skip
