"""Studies of predictors as experiments run them: trials, scores as rows, and what is left out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.experiments.components import Trials
from benchmarks.experiments.samples import Asked, Progress, source
from jshape.data.pairs import Pairs
from jshape.errors import BadDataset
from jshape.learn.evaluate import candidates_of
from jshape.learn.noise_floor import noise_floor
from jshape.learn.scores import Score, Trial, summarise
from jshape.learn.study import Study, fewest

PARTITIONS = 4
"""The paper's, of 75 % to fit to and 25 % to test on."""
LEAST_PAIRS = 4
"""Of an action and agent, to fit to and to test."""
NETWORK: Mapping[str, Any] = {"width": 8, "epochs": 40, "learning_rate": 5e-4, "patience": 0}
"""How the networks are trained unless one says otherwise: small, for minutes on a CPU."""
QUICK: Mapping[str, Any] = {**NETWORK, "width": 4, "epochs": 12}


def partitions_of(asked: Asked, few: int = 2) -> int:
    """How many partitions are asked for, or the usual number: `few` if quick."""
    return asked.partitions or (few if asked.quick else PARTITIONS)


def study_of(
    asked: Asked, pairs: Pairs, kinds: Sequence[str], *, few: int = 2, **more: Any
) -> tuple[Study, dict[str, Any]]:
    """The study of some kinds of bank, networks trained as usual or as asked for; its settings."""
    given = {"seed": asked.seed, "width": asked.width, "epochs": asked.epochs}
    training = {**(QUICK if asked.quick else NETWORK)}
    training |= {name: value for name, value in given.items() if value is not None}
    what: Any = {"partitions": partitions_of(asked, few), "seed": asked.seed}
    study = Study(pairs, candidates_of(kinds), options=training, **what, **more)
    asked.say(f"{len(study)} fits to {source(asked.data)}, {len(pairs)} pairs")
    settings = {"data": source(asked.data), "pairs": len(pairs), "training": training, **what}
    return study, settings


def trials_of(study: Study | Trials, what: str, progress: Progress) -> list[Trial]:
    """All trials of a study; `progress` wraps its steps."""
    return [trial for found in progress(study, len(study), what) for trial in found]


def scores_of(trials: Sequence[Trial], pairs: Pairs) -> list[Score]:
    """Means and standard deviations over the partitions, with the noise floor where it is known."""
    return summarise(trials, noise_floor(pairs))


def rows_of(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Scores as rows of a result."""
    return [score._asdict() for score in scores]


def mean_of(scores: Sequence[Score], predictor: str | None = None, **where: Any) -> float:
    """Mean error in mm of the scores with a predictor and other fields; NaN if there are none."""
    wanted = where if predictor is None else where | {"predictor": predictor}
    mine = [s.mean_mm for s in scores if all(getattr(s, k) == v for k, v in wanted.items())]
    return float(np.mean(mine)) if mine else float("nan")


def sizes_within(pairs: Pairs, wanted: Sequence[int]) -> tuple[list[int], list[str]]:
    """Sizes that every action has, rising, and a note about those that are left out.

    Raises:
      BadDataset: none of them.
    """
    least, action, agent = fewest(pairs)
    kept = sorted({size for size in wanted if size <= least})
    left_out = ", ".join(str(size) for size in sorted(set(wanted) - set(kept)))
    why = f"{action} of {agent} has {least} pairs to fit to beside those for testing"
    if not kept:
        raise BadDataset(
            f"training sets of {left_out} pairs per action: {why}; ask for sizes of at most {least}"
        )
    return kept, [f"Training sets of {left_out} pairs are left out: {why}."] if left_out else []


def shown(scores: Sequence[Score]) -> list[Score]:
    """The same with the predictors as the paper names them: f_D for "D"."""
    return [score._replace(predictor=f"f_{score.predictor}") for score in scores]


def enough(pairs: Pairs, least: int = LEAST_PAIRS) -> tuple[Pairs, list[str]]:
    """The pairs without actions that an agent has fewer than `least` of, and notes about them.

    Raises:
      BadDataset: nothing is left.
    """
    keep, notes = np.ones(len(pairs), bool), []
    for agent, action in dict.fromkeys(zip(pairs.agent.tolist(), pairs.action.tolist(),
                                           strict=True)):  # fmt: skip
        mine = (pairs.agent == agent) & (pairs.action == action)
        if mine.sum() < least:
            keep &= ~mine
            notes.append(f"{action} of {agent} is left out: {mine.sum()} pairs are too few.")
    if not keep.any():
        raise BadDataset(f"no action has {least} pairs of one agent")
    return pairs.select(keep), notes
