"""How near plans come to what no plan can go below, on goals that no action made.

    python -m benchmarks.limits [--bank NAME] [--steps 4 16] [--planners greedy] [--data DIR]

Of each family one goal of the planning benchmark.  Plans may gain as little as they like, so that
they take all their actions; efficiency is what one covers, of what the limit lets any plan cover.
Seconds are of the limit and of the search, compiling not counted in the latter.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import jshape
from benchmarks.console import positive_count
from benchmarks.experiments.problems import Problem, shape_problems
from jshape.cli.tables import print_table
from jshape.models.bank import Bank
from jshape.planning.limit import Limit
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.plan import Plan
from jshape.planning.search import PLANNERS

FREELY = {"min_gain_mm": 0.0, "error_margin": 0.0}
Case = tuple[Problem, int, float, Limit, dict[str, Plan]]
"""A goal and a number of actions: the limit, the seconds it took, and the plans by planner."""


def cases(
    problems: list[Problem], bank: Bank, steps: list[int], planners: list[str]
) -> Iterator[Case]:
    """All goals, with each number of actions."""
    for problem in problems:
        for most in steps:
            both, began = (problem.start, problem.goal), time.monotonic()
            found = jshape.limit(*both, bank=bank, max_steps=most)
            took = time.monotonic() - began
            how = {"bank": bank, **jshape.options(max_steps=most, **FREELY)}
            plans = {name: jshape.plan(*both, planner=name, **how) for name in planners}
            yield problem, most, took, found, plans


def left(plan: Plan) -> float:
    """The share of the distance that a plan leaves."""
    return float(plan.distances[-1] / plan.distances[0])


def of_limits(found: list[Case]) -> None:
    """Print the bounds, and what remains where and why."""
    rows = []
    for problem, most, took, limit, _ in found:
        bounds = (f"{one.left:.1%}" for one in limit.bounds)
        causes = ", ".join(f"{cause} {share:.0%}" for cause, share in limit.shares.items())
        rows.append((problem.name, f"{most}", *bounds, f"{limit.fractions:.1%}", causes or "-",
                     f"{took:.1f}"))  # fmt: skip
    head = ("goal", "actions", "window", "material", "shape", "fractions", "remains", "s")
    print_table(head, rows)


def of_planners(found: list[Case]) -> None:
    """Print what plans leave, their efficiency and seconds; and how many end below the limit."""
    rows, every = [], []
    for problem, most, _, limit, plans in found:
        for name, plan in plans.items():
            share = left(plan)
            every.append((name, share, limit.efficiency(share), plan.seconds, share < limit.left))
            of_limit = f"{share:.1%}", f"{limit.efficiency(share):.0%}"
            rows.append((problem.name, f"{most}", name, f"{limit.left:.1%}", *of_limit))
            rows[-1] += (f"{len(plan)}", f"{plan.seconds:.1f}")
    for name in dict.fromkeys(one[0] for one in every):
        mean = np.mean([one[1:4] for one in every if one[0] == name], axis=0)
        rows.append(
            ("mean", "", name, "", f"{mean[0]:.1%}", f"{mean[1]:.0%}", "", f"{mean[2]:.1f}")
        )
    print_table(("goal", "actions", "planner", "limit", "left", "efficiency", "used", "s"), rows)
    print(f"below the limit: {sum(one[-1] for one in every)} of {len(every)} plans")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bank", default=DEFAULT_BANK)
    parser.add_argument("--steps", type=positive_count, nargs="+", default=[4, 16])
    parser.add_argument("--planners", nargs="+", default=["greedy"], choices=PLANNERS)
    parser.add_argument("--data", type=Path, help="measured sand and dough")
    options = parser.parse_args()
    bank, data = jshape.load_bank(options.bank), options.data
    problems = {p.name.split()[0]: p for p in shape_problems(0, 6 if data else 4, data)}
    found = list(cases([*problems.values()], bank, options.steps, options.planners))
    of_limits(found)
    of_planners(found)


if __name__ == "__main__":
    main()
