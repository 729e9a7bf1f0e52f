"""The planning benchmark as the page of an experiment."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.experiments import pages
from benchmarks.experiments.planning_tables import TITLES, tables
from jshape.viz.style import Drawing

CAPTIONS = {
    "left.png": "What is left of the distance to the goal when a run has ended, measured without "
    "the camera's noise: mean over the problems and its 95 % interval. 100 % (dotted) is what was "
    "there at the start.",
    "curves.png": "The same after each action; a run that has ended stays as it is.",
    "gains.png": "What each action was predicted to gain, and gained. On the line, predictions "
    "hold; a dotted line, where there is one, is the usual error of a prediction of that action.",
    "sheet.png": "Beds as the camera sees them, higher is brighter: the start with its distance to "
    "the goal, the goal, and what each method left of the distance.",
}
"""Of the figures."""


def result(summary: Mapping[str, Any], figures: Mapping[str, Drawing]) -> pages.Result:
    """The page of a summary, as `results.conclude` makes it, with its figures by name."""
    settings = {name: value for name, value in summary["settings"].items()
                if name not in ("banks", "drawn", "methods")}  # fmt: skip
    return pages.Result(
        title="Planning for goals that another hand or no action made",
        paragraphs=words(summary["rows"]),
        rows=[_flat(row) for row in summary["rows"]],
        tables=[pages.Table(*table) for table in tables(summary["rows"])],
        pictures=[pages.Picture(name, figure, CAPTIONS[name]) for name, figure in figures.items()],
        settings=settings | {"methods": list(summary["settings"]["methods"])},
        notes=[
            *summary["notes"],
            "Every run is in steps.jsonl. `python -m benchmarks.experiments planning` takes more "
            "problems and methods, and goes on where it was stopped.",
        ],
    )


def words(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        "Each method plans from what a noisy camera sees, a simulated hand acts, and what is left "
        "of the distance to the goal is measured on what is really there. In an open loop the "
        "first plan is carried out blindly; in a closed one the bed is looked at after each action."
    ]
    loops = list(dict.fromkeys(row["loop"] for row in rows))
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if (row["kind"], row["loop"]) == (kind, loops[-1])]
        known = [row for row in mine if row["left"] is not None]
        if known:
            listed = ", ".join(f"{row['method']} {100 * row['left']:.0f} %" for row in known)
            best = min(known, key=lambda row: row["left"])["method"]
            text.append(
                f"{TITLES[kind]} ({known[0]['problems']}), {loops[-1]} loop, left of the distance: "
                f"{listed}." + (f" Least is left by {best}." if len(known) > 1 else "")
            )
    return text


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row without its families, which become columns."""
    families = {f"left_{name}": part["left"] for name, part in row["families"].items()}
    return {name: value for name, value in row.items() if name != "families"} | families
