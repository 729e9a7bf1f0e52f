"""`jshape train DATASET --out BANK`."""

import argparse
from pathlib import Path
from typing import Any

from jshape.commands import arguments
from jshape.commands.tables import print_table
from jshape.store import banks, datasets, files


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


def add(commands: Any) -> None:
    """The parser of `jshape train`."""
    parser = arguments.command(commands, "train", train, "fit a bank to a data set")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--kind", default="D", help="D: the mean difference, no training needed")
    parser.add_argument("--out", type=Path, required=True, help="folder of the new bank")
    parser.add_argument("--licence", default="", help="licence of the bank, for its manifest")
