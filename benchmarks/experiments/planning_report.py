"""A part of the planning benchmark, for a report of all experiments."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.experiments import pages
from benchmarks.experiments.planning import LOOPS, Settings, run_planning
from benchmarks.experiments.samples import Asked
from jshape.io import files

CLOSED = LOOPS[1:]
SETTINGS = {
    True: Settings(problems=1, methods=("paper", "f_D-dense"), loops=CLOSED, max_steps=4),
    False: Settings(problems=3, methods=("paper", "f_D-dense", "greedy"), loops=CLOSED),
}
"""What is run: if quick, and if not."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """The benchmark with few problems and methods, in the closed loop.

    Args:
      out: folder of the result.
      asked: quick: one problem of each kind, two methods, four actions.

    Returns:
      What `results.json` holds.

    Raises:
      BadFile: the folder holds something else, or runs with other settings.
    """
    settings = replace(SETTINGS[asked.quick], seed=asked.seed)
    run_planning(out, settings, overwrite=asked.overwrite, say=asked.say, progress=asked.progress)
    return files.read_json(out / pages.JSON)
