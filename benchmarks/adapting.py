"""What learning while molding brings, in a material and of a hand that the bank does not know.

    python -m benchmarks.adapting [--problems 20] [--agent human] [--material sand] [--data REAL]

The same goals, beds and hands' slips with and without `mold(learn=)`; the bank is the default one,
of a robot in flour.  `left` is of the beds themselves, without the camera's noise, in % of the
distance at the start; `harmful` are actions after which the true distance is larger.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jshape
from benchmarks import console
from benchmarks.experiments.problems import Problem, shape_problems
from jshape.cli.tables import print_table, say
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.learning import Learning
from jshape.robot.loop import mold
from jshape.robot.simulated import SimulatedWorld
from jshape.sim import AGENTS

HEAD = (
    "goal",
    "left %",
    "learning",
    "actions",
    "learning",
    "harmful",
    "learning",
    "off mm",
    "learning",
)


class Outcome(NamedTuple):
    """What one closed loop came to."""

    left: float
    """% of the distance at the start, without noise."""
    actions: float
    harmful: float
    off_mm: float
    """Mean |predicted - obtained| drop of d, mm."""


class Watched(SimulatedWorld):
    """A world that notes the true distance after each action."""

    def __init__(self, problem: Problem, agent: str):
        how = {"material": problem.material, "camera": problem.camera, "agent": agent}
        assert problem.bed is not None
        super().__init__(jax.random.key(0), problem.bed, **how)
        self._problem, self.true_mm = problem, [problem.distance_mm(self.bed)]

    def act(self, *action: Any, **how: float) -> None:
        """As any simulated world."""
        super().act(*action, **how)
        self.true_mm.append(self._problem.distance_mm(self.bed))


def attempt(problem: Problem, bank: Bank, agent: str, learns: bool, planner: str) -> Outcome:
    """One closed loop of at most 16 actions."""
    world = Watched(problem, agent)
    learn = Learning(bank) if learns else None
    run = mold(world, problem.goal, bank, learn=learn, **jshape.options(planner=planner))
    true = np.array(world.true_mm)
    off = [abs(step.predicted_mm - step.obtained_mm) for step in run.steps]
    harmful = int((np.diff(true) > 0).sum())
    return Outcome(100 * true[-1] / true[0], len(run.steps), harmful, float(np.mean(off or [0])))


def measure(options: argparse.Namespace) -> None:
    """Print the table."""
    bank, rows, found = jshape.load_bank(options.bank), [], []
    problems = shape_problems(
        options.seed, options.problems, options.data, material=options.material
    )
    for k, problem in enumerate(problems, 1):
        pair = [
            attempt(problem, bank, options.agent, learns, options.planner)
            for learns in (False, True)
        ]
        found.append(pair)
        cells = [f"{one:.3f}" if isinstance(one, float) else f"{one}" for one in _side(*pair)]
        rows.append((problem.name, *cells))
        say(f"{k} of {len(problems)}: {'  '.join(rows[-1])}")
    mean = [Outcome(*map(float, np.mean([pair[k] for pair in found], 0))) for k in (0, 1)]
    rows.append(("mean", *(f"{one:.3f}" for one in _side(*mean))))
    print_table(HEAD, rows)
    lefts = np.array([[one.left for one in pair] for pair in found])
    gap = lefts[:, 1] - lefts[:, 0]
    error = gap.std(ddof=1) / len(gap) ** 0.5 if len(gap) > 1 else float("nan")
    print(f"left with learning minus without: {gap.mean():+.2f} ± {error:.2f} points")


def _side(one: Outcome, other: Outcome) -> list[float | int]:
    return [number for both in zip(one, other, strict=True) for number in both]


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--problems", type=console.positive_count, default=20)
    parser.add_argument("--bank", default=DEFAULT_BANK)
    parser.add_argument("--agent", default="human", choices=AGENTS)
    parser.add_argument("--material", default="sand")
    parser.add_argument("--planner", default="greedy")
    parser.add_argument("--data", type=Path, help="folder of measured sand and dough")
    parser.add_argument("--seed", type=console.seed, default=0)
    parser.set_defaults(run=measure)
    return console.run("benchmarks.adapting", parser, None)


if __name__ == "__main__":
    sys.exit(main())
