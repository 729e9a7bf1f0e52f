"""`jshape evaluate DATASET`."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from jshape.commands import arguments
from jshape.commands.tables import print_table
from jshape.errors import JShapeError
from jshape.store import banks, datasets, files

SCORES = ("scores.csv", "scores.png")
"""Files of an evaluation's folder."""


def evaluate(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape evaluate DATASET`."""
    from jshape.learn import evaluate as evaluation

    if options.bank is not None and (options.kind or options.partitions):
        raise JShapeError("--kind and --partitions are for fitting; with --bank nothing is fitted")
    if options.out is not None:
        files.check_target(options.out, options.overwrite, contents=SCORES)
    pairs = datasets.load_pairs(options.dataset)
    if options.bank is not None:
        how = f"bank {options.bank} on all pairs; std over the pairs"
        scores = evaluation.evaluate(banks.load_bank(options.bank), pairs)
    else:
        kind, partitions = options.kind or "D", options.partitions or 4
        how = f"f_{kind}, {partitions} random 75/25 partitions per agent; std over their means"
        scores = evaluation.cross_validate(pairs, kind, partitions=partitions, seed=options.seed)
    mean = float(np.mean([s.mean_mm for s in scores]))
    result = {"how": how, "mean_mm": mean, "scores": [s._asdict() for s in scores]}
    if options.out is not None:
        from jshape.viz import pictures

        with files.atomic_folder(options.out, options.overwrite, contents=SCORES) as folder:
            lines = [",".join(evaluation.Score._fields)]
            lines += [",".join(str(x) for x in score) for score in scores]
            files.write_atomic(folder / "scores.csv", "\n".join(lines) + "\n")
            files.write_atomic(folder / "scores.png", pictures.png(pictures.scores_figure(scores)))
    if not options.json:
        print(how)
        print_table(
            ("action", "agent", "tested", "error (mm)", "std (mm)", "change (mm)"),
            [(s.action, s.agent, s.count, f"{s.mean_mm:.3f}", f"{s.std_mm:.3f}",
              f"{s.change_mm:.3f}") for s in scores],
        )  # fmt: skip
        print(f"mean error: {mean:.3f} mm")
    return result


def add(commands: Any) -> None:
    """The parser of `jshape evaluate`."""
    parser = arguments.command(
        commands,
        "evaluate",
        evaluate,
        "prediction errors in mm: of a bank, or over random partitions of the data set",
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--bank", default=None, help="test this bank on the whole data set")
    parser.add_argument("--kind", default=None, help="kind to fit to each partition (D)")
    parser.add_argument(
        "--partitions", type=arguments.positive_count, default=None, help="how many (4)"
    )
    parser.add_argument("--seed", type=arguments.seed, default=0)
    parser.add_argument("--out", type=Path, help="folder for the table and a picture")
