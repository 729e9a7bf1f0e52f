"""`jshape dataset from-run`."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jshape.cli.options import Writes
from jshape.errors import BadDataset, BadFile
from jshape.io import datasets, runs
from jshape.robot.learning import bank_of, bank_seeing
from jshape.robot.run_pairs import pairs_of


@dataclass(frozen=True, kw_only=True)
class DatasetRunOptions(Writes):
    """Of `jshape dataset from-run`."""

    agent: str = "robot"
    """Who or what acted: human, robot ..."""
    material: str = "unknown"
    """Material of the bed: flour, sand ..."""


def from_run(
    run: Path, out: Path, /, options: DatasetRunOptions = DatasetRunOptions()
) -> dict[str, Any]:
    """`jshape dataset from-run RUN OUT`.

    Args:
      run: Folder of a run of `jshape mold` or `jshape execute`.
      out: Folder of the new data set.
    """
    done = runs.Run.open(run)
    name = done.meta.get("bank")
    if not isinstance(name, str):
        raise BadFile(f"{run}: the run names no bank, so nothing says what its actions change")
    bank = bank_seeing(done.meta, bank_of(name), str(run))
    left_out: Counter[str] = Counter()
    pairs = list(pairs_of(done, bank, left_out))
    if not pairs:
        raise BadDataset(f"{run}: no action of the run has a look before and after it")
    whose = {"agent": options.agent, "material": options.material}
    with datasets.dataset_writer(
        out, bank.camera, done.depth_unit, overwrite=options.overwrite
    ) as add:
        for pair in pairs:
            add(**pair, **whose)
    why = "".join(f"; left out: {count} ({reason})" for reason, count in left_out.items())
    print(f"{len(pairs)} pairs: {out}{why}")
    return {"out": str(out), "pairs": len(pairs), "left_out": left_out}
