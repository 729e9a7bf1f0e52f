"""A part of the planning benchmark, for a report of all experiments."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.experiments import pages
from benchmarks.experiments.planning import LOOPS, Settings, run_planning
from benchmarks.experiments.samples import Progress, Say, silent, unheard
from jshape.io import files

CLOSED = LOOPS[1:]
SETTINGS = {
    True: Settings(problems=1, methods=("paper", "f_D-dense"), loops=CLOSED, max_steps=4),
    False: Settings(problems=3, methods=("paper", "f_D-dense", "greedy"), loops=CLOSED),
}
"""What is run: if quick, and if not."""


def run(
    out: Path,
    *,
    quick: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    say: Say = unheard,
    progress: Progress = silent,
) -> dict[str, Any]:
    """The benchmark with few problems and methods, in the closed loop.

    Args:
      out: folder of the results; one that was left unfinished goes on.
      quick: one problem of each kind, two methods, four actions.
      seed: of problems and noise.
      overwrite: begin anew, whatever is there.
      say: told each line for people.
      progress: wraps the runs to be made.

    Returns:
      What `results.json` holds.

    Raises:
      BadFile: the folder holds something else, or runs with other settings.
    """
    settings = replace(SETTINGS[quick], seed=seed)
    run_planning(out, settings, overwrite=overwrite, say=say, progress=progress)
    return files.read_json(out / pages.JSON)
