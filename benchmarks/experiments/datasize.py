"""Errors against the number of pairs that a predictor is fitted to."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.experiments import pages, studies
from benchmarks.experiments.samples import Asked, pairs_for, source
from jshape.learn import report as drawn
from jshape.learn.scores import Score

FIGURES = ("sizes.png",)
SIZES = (5, 10, 25, 50, 75)
"""The paper's training-set sizes (Fig. dataSize)."""
PAIRS = {True: 14, False: 100}
"""Simulated pairs per action and agent: three quarters are the largest training set."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Errors with 5, 10, 25, 50 and 75 pairs per action; the same pairs are tested every time.

    Args:
      out: folder of the result.
      asked: quick: few pairs, two partitions, two sizes.

    Returns:
      What `results.json` holds: a row per predictor, agent, action and size.

    Raises:
      BadDataset: the data set cannot be read or split, or has none of the sizes.
      BadFile: the folder holds something else, or cannot be written.
      UnknownName: no such kind or action.
    """
    pages.check(out, asked.overwrite, FIGURES)
    kinds, usual = asked.kinds or ("D", "P"), ("poke",) if asked.quick else None
    found = pairs_for(asked, PAIRS[asked.quick], usual=usual, agents=("robot",))
    found, notes = studies.enough(found)
    kept, left_out = studies.sizes_within(found, asked.sizes or SIZES)
    study, settings = studies.study_of(asked, found, kinds, sizes=kept)
    scores = studies.scores_of(studies.trials_of(study, "datasize", asked.progress), found)
    seen = studies.shown(scores)
    head, lines = drawn.sizes_table(seen)
    result = pages.Result(
        title="Errors of prediction against the size of the training set",
        paragraphs=words(scores, kinds, kept, source(asked.data)),
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
        settings=settings | {"kinds": list(kinds), "sizes": kept},
        notes=[*notes, *left_out],
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


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
