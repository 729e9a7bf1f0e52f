"""How near plans come to what no plan can go below, on goals that no action made.

    python -m benchmarks.limits [--bank NAME] [--steps 4 16] [--data DIR]

Of each family one goal of the planning benchmark.  `greedy` may gain as little as it likes, so that
it takes all its actions; efficiency is what it covers, of what the limit lets any plan cover.
"""

import argparse
import time
from pathlib import Path

import jshape
from benchmarks.experiments.problems import Problem, shape_problems
from jshape.cli.tables import print_table
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK

FREELY = {"min_gain_mm": 0.0, "error_margin": 0.0}


def compared(problem: Problem, bank: Bank, steps: int) -> tuple[str, ...]:
    """A row of the table."""
    began = time.monotonic()
    found = jshape.limit(problem.start, problem.goal, bank=bank, max_steps=steps)
    took = time.monotonic() - began
    how = jshape.options(max_steps=steps, **FREELY)
    plan = jshape.plan(problem.start, problem.goal, bank=bank, **how)
    left = float(plan.distances[-1] / plan.distances[0])
    bounds = (f"{one.left:.1%}" for one in found.bounds)
    covered = f"{found.efficiency(left):.0%}"
    causes = ", ".join(f"{cause} {share:.0%}" for cause, share in found.shares.items())
    return (problem.name, f"{steps}", *bounds, f"{found.fractions:.1%}", f"{left:.1%}", covered,
            causes or "-", f"{took:.1f}")  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bank", default=DEFAULT_BANK)
    parser.add_argument("--steps", type=int, nargs="+", default=[4, 16])
    parser.add_argument("--data", type=Path, help="measured sand and dough")
    options = parser.parse_args()
    bank, data = jshape.load_bank(options.bank), options.data
    problems = {p.name.split()[0]: p for p in shape_problems(0, 6 if data else 4, data)}
    head = ("goal", "actions", "window", "material", "shape", "fractions", "greedy", "efficiency",
            "remains", "s")  # fmt: skip
    print_table(head, [compared(p, bank, k) for p in problems.values() for k in options.steps])


if __name__ == "__main__":
    main()
