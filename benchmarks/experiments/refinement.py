"""The paper's table of refinement: networks with and without the last step of their prediction."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments import pages, studies
from benchmarks.experiments.samples import Asked, pairs_for
from jshape.learn.scores import Score, compare

FIGURES = ("refinement.png",)
COUPLES = (("C", "CR"), ("DC", "DCR"))
"""Without and with refinement."""
COLOURS = {"C": "tab:green", "CR": "tab:green", "DC": "tab:blue", "DCR": "tab:blue",
           "D": "tab:orange"}  # fmt: skip
PAIRS = {True: 12, False: 75}


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Errors of f_C, f_CR, f_DC and f_DCR, and of f_D.

    f_C is what is inside f_CR, so each couple is one training: the difference is the refinement.

    Args:
      out: folder of the result.
      asked: quick: few pairs, one partition, tiny networks that are hardly trained.

    Returns:
      What `results.json` holds: a row per predictor, agent and action.

    Raises:
      BadDataset: the data set cannot be read or split.
      BadFile: the folder holds something else, or cannot be written.
      UnknownName: no such action.
    """
    pages.check(out, asked.overwrite, FIGURES)
    found = pairs_for(asked, PAIRS[asked.quick], usual=("poke",), agents=("robot",))
    found, notes = studies.enough(found)
    if asked.data is not None and not asked.actions:
        smallest = min(found.actions, key=lambda action: np.prod(found.roi_size(action)))
        if len(found.actions) > 1:
            notes.append(f"Only {smallest}, whose ROI is the smallest; --actions names others.")
        found = found.of(action=smallest)
    kinds = ("D", *(kind for couple in COUPLES for kind in couple))
    study, settings = studies.study_of(asked, found, kinds, few=1)
    trials = studies.trials_of(study, "refinement", asked.progress)
    scores = studies.scores_of(trials, found)
    better = {
        (c.action, c.agent, c.predictor): (c.difference_mm, c.error_mm, c.better)
        for plain, refined in COUPLES
        for c in compare([t for t in trials if t.predictor in (plain, refined)], plain)
    }
    rows = []
    for score in scores:
        line = better.get((score.action, score.agent, score.predictor), (None,) * 3)
        names = ("refined_by_mm", "refined_error_mm", "refined_better")
        rows.append(score._asdict() | dict(zip(names, line, strict=True)))
    if asked.quick:
        notes.append(
            "Quick: the networks are tiny and hardly trained, which refinement hides best."
        )
    result = pages.Result(
        title="What refinement brings to the networks",
        paragraphs=words(scores, settings["training"]),
        rows=rows,
        tables=[_table(rows)],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(_figure, scores),
                "Mean error with its standard deviation over the partitions (of one partition: "
                "over the pairs). Pale: the network alone; full: refined. Broken line: f_D, which "
                "needs no training. Dotted line: no prediction at all.",
            )
        ],
        settings=settings,
        notes=notes,
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def words(scores: Sequence[Score], options: dict[str, Any]) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        "The network f_C paints a whole ROI, also where the action changes nothing. Refinement "
        "keeps its picture where the mean change of the action is large, shifted to the right "
        "mean depth, and adds the mean change (f_D) everywhere else.",
        f"The networks have {options['width']} features in the first block (the paper's: 32) and "
        f"were trained for at most {options['epochs']} epochs (the paper's: 500).",
    ]
    for plain, refined in COUPLES:
        before, after = (studies.mean_of(scores, kind) for kind in (plain, refined))
        helps = "helps" if after < before else "does not help"
        text.append(
            f"Refinement {helps} f_{plain}: {before:.2f} mm without, {after:.2f} mm with it "
            f"({100 * (after / before - 1):+.0f} %)."
        )
    text.append(f"f_D, the mean change alone, is at {studies.mean_of(scores, 'D'):.2f} mm.")
    return text


def _table(rows: Sequence[dict[str, Any]]) -> pages.Table:
    lines = []
    for row in rows:
        by = row["refined_by_mm"]
        error = row["refined_error_mm"]
        change = "-" if by is None else f"{by:+.3f} ± {error:.3f}"
        share = "-" if by is None else f"{100 * row['refined_better']:.0f} %"
        lines.append((f"f_{row['predictor']}", row["action"], row["agent"], str(row["count"]),
                      f"{row['mean_mm']:.2f} ± {row['std_mm']:.2f}", change, share))  # fmt: skip
    head = ("predictor", "action", "agent", "tested", "error (mm)", "refinement changes it by (mm)",
            "better on")  # fmt: skip
    return pages.Table("Errors over the ROI", head, lines)


def _figure(scores: Sequence[Score]) -> Figure:
    cases = list(dict.fromkeys((s.action, s.agent) for s in scores))
    figure = Figure(figsize=(max(6.5, 1.6 + 2.6 * len(cases)), 3.8), layout="constrained")
    ax = figure.subplots()
    names = [kind for couple in COUPLES for kind in couple]
    said: set[str] = set()

    def once(label: str) -> str | None:
        return None if label in said else said.add(label) or label

    for at, (action, agent) in enumerate(cases):
        mine = {s.predictor: s for s in scores if (s.action, s.agent) == (action, agent)}
        for k, name in enumerate(names):
            ax.bar(
                at + (k - 1.5) * 0.2, mine[name].mean_mm, 0.18, yerr=mine[name].std_mm, capsize=3,
                color=COLOURS[name], alpha=1.0 if name.endswith("R") else 0.4,
                label=once(f"f_{name}"),
            )  # fmt: skip
        ends = [at - 0.45, at + 0.45]
        ax.plot(ends, [mine["D"].mean_mm] * 2, "--", color=COLOURS["D"], label=once("f_D"))
        ax.plot(ends, [mine["D"].change_mm] * 2, ":", color="0.4", label=once("no prediction"))
    one = len({agent for _, agent in cases}) == 1
    ax.set_xticks(np.arange(len(cases)),
                  [action if one else f"{action}, {agent}" for action, agent in cases])  # fmt: skip
    ax.set_ylabel("mean distance over the ROI (mm)")
    ax.set_xlim(-0.6, len(cases) - 0.4)
    ax.grid(axis="y", alpha=0.3)
    ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
