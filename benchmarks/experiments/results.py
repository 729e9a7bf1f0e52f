"""The folder of a benchmark: runs as they come, and in the end tables and figures of all."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.experiments import measures, pages, planning_page
from benchmarks.experiments import planning_tables as drawn
from benchmarks.experiments.problems import Problem
from jshape import metric, sim
from jshape.errors import BadFile, one_line
from jshape.io import files, folders, runs
from jshape.learn.report import markdown
from jshape.models.bank import Bank

FIGURES = ("left.png", "curves.png", "gains.png", "sheet.png")
FILES = ("summary.json", "report.md", *pages.contents(FIGURES))
"""What is written beside the runs when all are done."""
WHAT = "experiment planning"


def check(out: Path, overwrite: bool) -> bool:
    """Whether runs are there to go on with: call it before long work.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    if (out / runs.DESCRIPTION).is_file() and not overwrite:
        folders.check_writable(out)
        return True
    folders.check_target(out, overwrite, contents=(*runs.CONTENTS, *FILES))
    return False


def opened(out: Path, settings: Mapping[str, Any], overwrite: bool) -> runs.Run:
    """The folder's runs so far; a new folder if there is none, or to overwrite it.

    Raises:
      BadFile: it holds something else, or runs with other settings.
    """
    if not check(out, overwrite):
        meta = {"what": WHAT, "settings": dict(settings)}
        return runs.Run.create(out, meta, overwrite=overwrite, contents=FILES)
    record = runs.Run.open(out)
    before, now = record.meta.get("settings"), json.loads(files.json_text(dict(settings), WHAT))
    if record.meta.get("what") != WHAT or not isinstance(before, dict):
        raise BadFile(f"{out}: holds another run; choose another folder")
    differ = [name for name in now if now[name] != before.get(name)]
    if differ:
        name = differ[0]
        were = one_line(before.get(name), 60)
        raise BadFile(
            f"{out}: holds runs with other settings: {', '.join(differ)} ({name} was {were}, now "
            f"{one_line(now[name], 60)}); choose another folder, or overwrite it"
        )
    return record


def conclude(
    record: runs.Run,
    problems: Mapping[str, Sequence[Problem]],
    used: Mapping[str, Bank],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Tables and figures of all runs, into their folder; the summary.

    Args:
      record: with all runs.
      problems: of each kind.
      used: the bank of each method, for the usual errors of its predictions.
      notes: what was left out.
    """
    out, made = record.folder, record.steps
    rows = measures.summarise(made)
    failed = [f"{run['method']}, {run['loop']}, {run['problem']}: {run['note']}"
              for run in made if run["stop"] == "FAILED"]  # fmt: skip
    summary = {
        "settings": record.meta["settings"], "rows": rows, "runs": len(made),
        "notes": [*notes, measures.limits_kept(made), *failed], "out": str(out),
    }  # fmt: skip
    text = "# Planning\n"
    for title, head, body in drawn.tables(rows):
        text += f"\n## {title}\n\n{markdown(head, body)}"
    text += "".join(f"\n{note}\n" for note in summary["notes"])
    acting = [run for run in made if run["true_mm"]]
    figures = {}
    if acting:
        errors = {name: measures.errors_mm(bank) for name, bank in used.items()}
        figures = {
            "left.png": partial(
                drawn.left_figure, [row for row in rows if row["left"] is not None]
            ),
            "curves.png": partial(drawn.curves_figure, acting),
            "gains.png": partial(drawn.gains_figure, acting, errors),
            "sheet.png": partial(drawn.sheet_figure, _sheet(record, problems)),
        }
    files.write_json(out / "summary.json", summary)
    page = pages.add(planning_page.result(summary, figures), out)
    shown = [one["name"] for one in page["figures"]]
    text += "".join(f"\n![{name.removesuffix('.png')}]({name})\n" for name in shown)
    files.write_atomic(out / "report.md", text)
    return summary


def _sheet(record: runs.Run, problems: Mapping[str, Sequence[Problem]]) -> list[list[drawn.Tile]]:
    """Start, goal and what each method obtained of the problems that were kept, as depths in mm."""
    found: dict[tuple[str, int], list[drawn.Tile]] = {}
    for run in record.steps:
        if "frame" not in run:
            continue
        problem = problems[run["kind"]][run["number"]]
        where = (run["kind"], run["number"])
        if where not in found:
            assert problem.bed is not None and problem.truth is not None
            goal = problem.camera.depth(metric.unweigh(problem.truth, problem.camera))
            start = np.asarray(sim.render(problem.bed, problem.camera))
            found[where] = [
                drawn.Tile(f"{problem.name}\n{run['true_mm'][0]:.2f} mm", 1e3 * start),
                drawn.Tile("goal\n", 1e3 * np.asarray(goal)),
            ]
        left = run["true_mm"][-1] / run["true_mm"][0]
        title = f"{run['method']}\n{100 * left:.0f} %, {len(run['steps'])} actions"
        found[where].append(drawn.Tile(title, 1e3 * record.depth(run["index"])))
    return list(found.values())
