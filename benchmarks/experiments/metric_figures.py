"""The page of the metric experiment: its words, tables and figures."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from benchmarks.experiments.pages import Picture, Result, Table

COLOURS = {"d": "tab:orange", "depth difference": "tab:olive", "making the two clouds": "0.6",
           "Chamfer": "tab:blue", "ICP": "tab:purple", "EMD": "tab:red"}  # fmt: skip
Rows = Sequence[Mapping[str, Any]]


def result(
    rows: Rows,
    curves: Mapping[str, np.ndarray],
    settings: Mapping[str, Any],
    names: Sequence[str],
) -> Result:
    """All of the page.

    Args:
      rows: of the parts "time", "emd" and "ranking".
      curves: (sequences, steps + 1) values of each distance, mm.
      settings: what was run.
      names: of the three figures' files.
    """
    times, moved, ranked = (
        [row for row in rows if row["part"] == part] for part in ("time", "emd", "ranking")
    )
    pictures = [
        Picture(
            names[0], partial(times_figure, times, moved),
            "Time of one comparison against the number of points. d reads two images that are "
            "there; the others compare two clouds that are there (making them is the grey line).",
        ),
        Picture(
            names[1], partial(emd_figure, moved),
            "What the earth mover's distance and Chamfer say of the same two beds, with more and "
            "more points. Broken line: d of all pixels. Points drawn at random from each cloud "
            "lie beside each other, not on each other, so the distance between neighbouring "
            "points is added; it goes away slowly, as the cost of exact transport explodes.",
        ),
        Picture(
            names[2], partial(ranking_figure, curves),
            "Distance to the goal along simulated molding sequences, as a share of its start: "
            "mean and standard deviation over the sequences. A good distance falls with every "
            "action and ends near 0, where the goal is seen again with other noise.",
        ),
    ]  # fmt: skip
    return Result(
        title="The distance between depth images beside Chamfer, ICP and the earth mover",
        paragraphs=words(times, moved, ranked),
        rows=rows,
        tables=[times_table(times), emd_table(moved), ranking_table(ranked)],
        pictures=pictures,
        settings=settings,
        notes=[
            "Times are of one machine that may have done other work: compare them as ratios "
            "within a size. Calls longer than half a second were timed once.",
            "ICP moves the whole cloud before it measures, so it answers another question: how "
            "far apart two shapes are at best, not where they are. The number of actions left "
            "is what the rankings are held against; it favours none of the distances.",
        ],
    )


def words(times: Rows, moved: Rows, ranked: Rows) -> list[str]:
    """What is seen, from the numbers."""
    size = "480x395" if any(row["size"] == "480x395" for row in times) else times[-1]["size"]
    here = [row for row in times if row["size"] == size]
    own = here[0]
    chamfer = min((r for r in here if r["method"].startswith("Chamfer")), key=_seconds)
    icp = next(row for row in here if row["method"].startswith("ICP"))
    text = [
        "The paper compares depth images pixel by pixel: the pixel is the match between the two "
        "point clouds. Chamfer, ICP and the earth mover's distance (EMD) look for a match first.",
        f"At {size} d takes {_duration(own['seconds'])}. The fastest exact Chamfer "
        f"({chamfer['method'][9:-1]}, all {chamfer['points']:,} points) takes "
        f"{chamfer['times_d']:,.0f} times as long, {icp['rounds']} rounds of nearest-neighbour "
        f"matching (ICP) {icp['times_d']:,.0f} times.",
        f"The value: d says {own['value_mm']:.3f} mm, Chamfer {chamfer['value_mm']:.3f} mm and "
        f"ICP {icp['value_mm']:.3f} mm. The nearest point is never farther than the one of the "
        "same pixel, so Chamfer and ICP say less than d, and no longer what has to move.",
    ]
    same = [row for row in moved if row["choice"] == "same pixels"]
    gap = max(abs(row["value_mm"] / row["d_same_pixels_mm"] - 1) for row in same)
    within = "to rounding" if gap < 1e-4 else f"within {100 * gap:.2g} %"
    drawn = [row for row in moved if row["choice"] == "random"]
    last = [row for row in drawn if row["points"] == drawn[-1]["points"]]
    last = min(last, key=_seconds)
    text.append(
        f"EMD of the same pixels in both clouds is d over these pixels {within}, from "
        f"{same[0]['points']} to {same[-1]['points']} points. "
        f"With {last['points']} points drawn from each cloud it says {last['value_mm']:.2f} mm "
        f"where d is {last['d_mm']:.2f} mm: the rest is the spacing of the points. "
        f"The faster of the exact solvers ({last['method'][5:-1]}) takes "
        f"{_duration(last['seconds'])} for that, {last['seconds'] / own['seconds']:,.0f} times "
        "d of all pixels."
    )
    best = max(ranked, key=lambda row: row["kendall"])
    ours = ranked[0]
    text.append(
        f"Along the sequences d falls with {100 * ours['falls']:.0f} % of the actions (Kendall's "
        f"tau with the actions left: {ours['kendall']:.3f}), and {100 * ours['left_at_goal']:.0f} "
        "% of it is left at the goal, which is noise. "
        + (
            "None ranks better, though those of matched or of all points rank nearly as well; "
            "points drawn at random do not."
            if best["kendall"] <= ours["kendall"]
            else f"Best ranks: {best['method']}, with a tau of {best['kendall']:.3f}."
        )
    )
    return text


def _seconds(row: Mapping[str, Any]) -> float:
    return row["seconds"]


def _duration(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def _value(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def times_table(rows: Rows) -> Table:
    """All points, every size."""
    lines = [
        (row["method"], row["size"], f"{row['points']:,}", _duration(row["seconds"]),
         f"{row['times_d']:,.1f}", _value(row["value_mm"]))
        for row in rows
    ]  # fmt: skip
    head = ("method, all points", "size", "points", "time", "time / d", "value (mm)")
    return Table("Time and value", head, lines)


def emd_table(rows: Rows) -> Table:
    """Same pixels and random points, with N."""
    lines = [
        (row["method"], row["choice"], f"{row['points']:,}", _duration(row["seconds"]),
         _value(row["value_mm"]), _value(row["d_same_pixels_mm"]), _value(row["chamfer_mm"]),
         _value(row["d_mm"]))
        for row in rows
    ]  # fmt: skip
    head = ("method", "points are", "points", "time", "EMD (mm)", "d, same pixels (mm)",
            "Chamfer, same points (mm)", "d, all pixels (mm)")  # fmt: skip
    return Table("Earth mover's distance with N points", head, lines)


def ranking_table(rows: Rows) -> Table:
    """One line per distance."""
    lines = [
        (row["method"], f"{row['kendall']:.3f}", f"{row['kendall_least']:.2f}",
         f"{100 * row['falls']:.0f} %", f"{row['start_mm']:.2f}", f"{row['goal_mm']:.2f}",
         f"{100 * row['left_at_goal']:.0f} %")
        for row in rows
    ]  # fmt: skip
    head = ("distance", "Kendall's tau", "least tau", "actions that lower it", "at the start (mm)",
            "at the goal (mm)", "left at the goal")  # fmt: skip
    return Table("How each ranks molding sequences", head, lines)


def _colour(name: str) -> str:
    """Of a method, or of what it begins with."""
    begins = (c for known, c in COLOURS.items() if known != "d" and name.startswith(known))
    return COLOURS["d"] if name == "d" else next(begins, "k")


def times_figure(times: Rows, moved: Rows) -> Figure:
    """Time against the number of points, both logarithmic."""
    figure = Figure(figsize=(8.2, 4.6), layout="constrained")
    ax = figure.subplots()
    lines: dict[str, list[Mapping[str, Any]]] = {}
    for row in [*times, *(row for row in moved if row["choice"] == "same pixels")]:
        lines.setdefault(row["method"], []).append(row)
    for name, mine in lines.items():
        dashed = "scipy" in name and len([n for n in lines if n[:4] == name[:4]]) > 1
        ax.plot(
            [row["points"] for row in mine], [row["seconds"] for row in mine],
            "s--" if dashed else "o-", color=_colour(name), label=name, markersize=4,
        )  # fmt: skip
    ax.set(xscale="log", yscale="log", xlabel="points of each cloud (pixels of each image)",
           ylabel="time of one comparison (s)")  # fmt: skip
    ax.grid(alpha=0.3)
    ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def emd_figure(moved: Rows) -> Figure:
    """Value against the number of points, for both choices of points."""
    figure = Figure(figsize=(8.2, 4.2), layout="constrained")
    ax = figure.subplots()
    mover = moved[-1]["method"]
    styles = {"same pixels": "o-", "random": "s--"}
    for choice, style in styles.items():
        mine = [row for row in moved if (row["choice"], row["method"]) == (choice, mover)]
        at = [row["points"] for row in mine]
        said = "the same pixels" if choice == "same pixels" else "random points"
        for name, key in (("EMD", "value_mm"), ("Chamfer", "chamfer_mm")):
            ax.plot(at, [row[key] for row in mine], style, color=_colour(name),
                    label=f"{name}, {said}", markersize=5)  # fmt: skip
    ax.axhline(moved[0]["d_mm"], color=COLOURS["d"], linestyle=":", linewidth=2,
               label="d, all pixels")  # fmt: skip
    ax.set(xscale="log", xlabel="points of each cloud", ylabel="distance (mm)")
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def ranking_figure(curves: Mapping[str, np.ndarray]) -> Figure:
    """A panel per distance: its share of the start over the actions that are left."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    columns = 4
    axes = figure.subplots(-(-len(curves) // columns), columns, sharex=True, sharey=True).reshape(
        -1
    )
    for ax, (name, values) in zip(axes, curves.items(), strict=False):
        share = values / values[:, :1]
        left = np.arange(values.shape[1])[::-1]
        ax.plot(left, share.T, color="0.8", linewidth=0.8)
        ax.errorbar(left, share.mean(0), share.std(0), color=_colour(name), capsize=2,
                    marker="o", markersize=4)  # fmt: skip
        ax.set_title(name, fontsize=9)
        ax.grid(alpha=0.3)
        ax.set_xlabel("actions left")
        ax.tick_params(labelbottom=True)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    for ax in axes[len(curves) :]:
        ax.set_axis_off()
    axes[0].invert_xaxis()
    axes[0].set_ylim(bottom=0)
    for ax in axes[: len(curves) : columns]:
        ax.set_ylabel("share of the start")
    return figure
