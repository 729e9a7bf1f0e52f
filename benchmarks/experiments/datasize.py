"""Errors against the number of pairs that a predictor is fitted to."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.experiments import pages, studies
from benchmarks.experiments.samples import Progress, Say, pairs_of, silent, source, unheard
from jshape.learn import report as drawn
from jshape.learn.evaluate import candidates_of
from jshape.learn.scores import Score
from jshape.learn.study import Study

FIGURES = ("sizes.png",)
SIZES = (5, 10, 25, 50, 75)
"""The paper's training-set sizes (Fig. dataSize)."""
PAIRS = {True: 14, False: 100}
"""Simulated pairs per action and agent: three quarters are the largest training set."""


def run(
    out: Path,
    *,
    data: Path | None = None,
    quick: bool = False,
    seed: int = 0,
    kinds: Sequence[str] | None = None,
    actions: Sequence[str] | None = None,
    sizes: Sequence[int] | None = None,
    pairs: int | None = None,
    partitions: int | None = None,
    width: int | None = None,
    epochs: int | None = None,
    overwrite: bool = False,
    say: Say = unheard,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Errors with 5, 10, 25, 50 and 75 pairs per action; the same pairs are tested every time.

    Args:
      out: folder of the result.
      data: a data set; None simulates the robot's.
      quick: few pairs, two partitions, two sizes.
      seed: of simulated pairs, partitions and training.
      kinds: of banks; None is f_D and f_P.
      actions: names; None is the paper's three (one if quick), or all of a data set.
      sizes: pairs per action to fit to; those that are not there are left out and noted.
      pairs: simulated per action.
      partitions: how many.
      width: of networks.
      epochs: of networks.
      overwrite: replace an earlier result.
      say: told each line for people.
      progress: wraps what takes long.

    Returns:
      What `results.json` holds: a row per predictor, agent, action and size.

    Raises:
      BadDataset: the data set cannot be read or split, or has none of the sizes.
      BadFile: the folder holds something else, or cannot be written.
      UnknownName: no such kind or action.
    """
    pages.check(out, overwrite, FIGURES)
    kinds, count = kinds or ("D", "P"), pairs or PAIRS[quick]
    if data is None:
        actions = actions or (("poke",) if quick else None)
    agents = None if data is not None else ("robot",)
    found = pairs_of(
        data, seed=seed, count=count, actions=actions, agents=agents, progress=progress
    )
    found, notes = studies.enough(found)
    kept, left_out = studies.sizes_within(found, sizes or SIZES)
    options = studies.training(quick, width, epochs, seed)
    study = Study(
        found, candidates_of(kinds), partitions or (2 if quick else studies.PARTITIONS),
        seed=seed, sizes=kept, options=options,
    )  # fmt: skip
    say(f"{len(study)} fits to {source(data)}, {len(found)} pairs")
    scores = studies.scores_of(studies.trials_of(study, "datasize", progress), found)
    seen = studies.shown(scores)
    head, lines = drawn.sizes_table(seen)
    result = pages.Result(
        title="Errors of prediction against the size of the training set",
        paragraphs=words(scores, kinds, kept, source(data)),
        rows=studies.rows_of(scores),
        tables=[pages.Table("Mean over the actions", head, lines)],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(drawn.sizes_figure, seen),
                "Mean error over the actions against the pairs of each action that the predictor "
                "was fitted to. Bands: standard deviation over the partitions. Black "
                "line, if there is one: the noise floor, dotted where it is an upper bound.",
            )
        ],
        settings={"data": source(data), "pairs": len(found), "kinds": list(kinds), "sizes": kept,
                  "partitions": study.partitions, "seed": seed, "training": options},
        notes=[*notes, *left_out],
    )  # fmt: skip
    return pages.write(result, out, overwrite=overwrite)


def words(
    scores: Sequence[Score], kinds: Sequence[str], sizes: Sequence[int], where: str
) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        f"Predictors are fitted to {', '.join(map(str, sizes))} pairs of each action from {where}. "
        "The smaller training sets are part of the larger ones, and the pairs they are tested on "
        "stay the same."
    ]
    for kind in kinds:
        first, last = (studies.mean_of(scores, kind, pairs=size) for size in (sizes[0], sizes[-1]))
        text.append(
            f"f_{kind}: {first:.2f} mm with {sizes[0]} pairs, {last:.2f} mm with {sizes[-1]} "
            f"({100 * (last / first - 1):+.0f} %)."
        )
    if len(kinds) > 1 and len(sizes) > 1:
        base = studies.mean_of(scores, kinds[0], pairs=sizes[-1])
        for kind in kinds[1:]:
            few = [size for size in sizes if studies.mean_of(scores, kind, pairs=size) < base]
            if few:
                text.append(
                    f"f_{kind} needs {few[0]} pairs to be better than f_{kinds[0]} is with "
                    f"{sizes[-1]}."
                )
    return text
