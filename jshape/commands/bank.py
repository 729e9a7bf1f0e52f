"""`jshape train` and `jshape evaluate`."""

import argparse
from typing import Any

import numpy as np

from jshape.commands.tables import print_table
from jshape.errors import JShapeError
from jshape.store import banks, datasets, files

SCORES = ("scores.csv", "scores.png")
"""Files of an evaluation's folder."""


def train(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape train DATASET --out BANK`."""
    from jshape.learn.fit import fit

    files.check_target(options.out, options.overwrite, contents=banks.CONTENTS)
    pairs = datasets.load_pairs(options.dataset)
    bank = fit(pairs, options.kind)
    data = {
        "pairs": {name: len(mine) for name, mine in pairs.by_action()},
        "agents": list(dict.fromkeys(pairs.agent.tolist())),
        "materials": list(dict.fromkeys(pairs.material.tolist())),
    }
    banks.save_bank(
        bank, options.out, info={"data": data, "licence": options.licence},
        overwrite=options.overwrite,
    )  # fmt: skip
    if not options.json:
        print(f"bank of kind {bank.kind}: {options.out}")
        print_table(
            ("action", "pairs", "ROI (w x h)"),
            [(name, data["pairs"][name], "{}x{}".format(*bank.roi(name))) for name in bank.actions],
        )
    return {"out": str(options.out), "kind": bank.kind, "data": data, "rois": bank.rois}


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
