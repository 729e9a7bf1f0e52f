"""The paper's error bars: predictors fitted to one agent's pairs and tested on either's."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.experiments import pages, studies
from benchmarks.experiments.samples import Asked, pairs_for, source
from jshape.learn import report as drawn
from jshape.learn.scores import Score

FIGURES = ("errors.png",)
KINDS = {True: ("D", "P"), False: ("D", "CR", "DCR", "P")}
"""If quick, and if not: the paper's three and f_P."""
PAIRS = {True: 8, False: 60}
"""Simulated pairs per action and agent."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Errors in mm over random partitions; with two agents also from one to the other.

    Args:
      out: folder of the result.
      asked: quick: few pairs, knock and poke, two partitions, f_D and f_P.

    Returns:
      What `results.json` holds: a row per predictor, agents and action.

    Raises:
      BadDataset: the data set cannot be read or split.
      BadFile: the folder holds something else, or cannot be written.
      UnknownName: no such kind or action.
    """
    pages.check(out, asked.overwrite, FIGURES)
    kinds = asked.kinds or KINDS[asked.quick]
    # A fit of the grasp takes as long as of all others.
    usual = ("knock", "poke") if asked.quick else None
    found, notes = studies.enough(pairs_for(asked, PAIRS[asked.quick], usual=usual))
    agents = list(dict.fromkeys(found.agent.tolist()))
    study, settings = studies.study_of(asked, found, kinds, across=len(agents) > 1)
    scores = studies.scores_of(studies.trials_of(study, "prediction", asked.progress), found)
    if len(agents) == 1:
        notes.append(f"All pairs are of {agents[0]}: nothing is tested across agents.")
    seen = studies.shown(scores)
    head, lines = drawn.scores_table(seen)
    result = pages.Result(
        title="Errors of prediction, with the same agent and across agents",
        paragraphs=words(scores, kinds, source(asked.data), study.partitions),
        rows=studies.rows_of(scores),
        tables=[pages.Table("Errors over the ROI, mm", head, lines)],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(drawn.scores_figure, seen),
                "Mean error per action over the partitions, with their standard deviation. "
                "'robot -> human': fitted to the robot's pairs, tested on the human's. Grey: how "
                "much the action changes. Lines, where there are any: the noise floor, which no "
                "predictor can beat; dotted where only an upper bound is known.",
            )
        ],
        settings=settings | {"kinds": list(kinds)},
        notes=notes,
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def words(scores: Sequence[Score], kinds: Sequence[str], where: str, partitions: int) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        f"Each predictor is fitted to three quarters of {where} and tested on the last quarter, "
        f"in {partitions} random partitions. The error is the mean distance in mm between the "
        "predicted and the true ROI after the action.",
    ]
    same = [s for s in scores if s.trained_on == s.agent]
    other = [s for s in scores if s.trained_on != s.agent]
    by_kind = {kind: studies.mean_of(same, kind) for kind in kinds}
    listed = ", ".join(f"f_{kind} {mean:.2f} mm" for kind, mean in by_kind.items())
    text.append(
        f"Fitted and tested on the same agent: {listed} (predicting no change at all: "
        f"{np.mean([s.change_mm for s in same]):.2f} mm)."
    )
    if other:
        crossed = {kind: studies.mean_of(other, kind) for kind in kinds}
        listed = ", ".join(f"f_{kind} {mean:.2f} mm" for kind, mean in crossed.items())
        worse = np.mean(list(crossed.values())) > np.mean(list(by_kind.values()))
        text.append(
            f"Fitted to one agent and tested on the other: {listed}. "
            + (
                "The hands differ in size and force, so what was learned from one is wrong about "
                "the other; the paper found the same "
                if worse
                else "Here one agent stands for the other, which the paper did not find "
            )
            + "(1.75 mm with the same agent, 2.53 mm across, on real flour)."
        )
        agents = list(dict.fromkeys(s.agent for s in same))
        each = [f"{agent} {studies.mean_of(same, agent=agent):.2f} mm" for agent in agents]
        text.append(
            "Over all predictors, by the agent that they are fitted to and tested on: "
            f"{', '.join(each)}. An agent that varies more is harder to predict."
        )
    return text
