"""Whether the 80 % intervals of predictions hold on pairs that were held out.

    python -m benchmarks.intervals --data DIR [--only fitted] [--partitions 4]
    python -m benchmarks.intervals --only plans [--count 14]

DIR holds the independent material-point simulation: `pairs` and `pairs_noisy`, one data set a
folder.  A bank is fitted to 75 % of the pairs of each, as `jshape train` does, its intervals with
it, and tested on the rest: every pair counts the same (in the next column every pixel, so that a
grasp counts 18 times as much as a poke).

`plans`: the bundled banks plan for goals that another hand made, and that none did; each plan is
carried out in the simulator, and after each action d is measured as the camera sees the bed.
"""

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np

import jshape
from benchmarks.console import positive_count, run
from benchmarks.experiments.open_loop import seen
from benchmarks.experiments.problems import applied_problems, shape_problems
from benchmarks.sim_against_mpm import default_data
from jshape import Plan, load_bank, load_pairs, metric
from jshape.cli.tables import print_table, progress
from jshape.data.pairs import Pairs
from jshape.errors import BadFile
from jshape.learn.report import markdown
from jshape.learn.scores import roi_errors
from jshape.learn.study import split_pairs
from jshape.learn.validation import fit
from jshape.models.spread import COVERED, half_width_mm
from jshape.robot.simulated import SimulatedWorld

FOLDERS = "pairs", "pairs_noisy"
BANKS = (
    ("pressed-flour-robot", "flour", "robot"),
    ("pressed-flour-human", "flour", "human"),
    ("pressed-sand-human", "sand", "human"),
)
"""Bundled ones, the material they plan in and the hand that carries plans out."""
MAX_STEPS = 8
"""Most actions of a plan."""
SEED = 7
"""Of problems and worlds."""


def covered(pairs: Pairs, partitions: int) -> list[np.ndarray]:
    """What is found, one row per action and partition of held-out pairs.

    Their count, the pixels of their ROI, and summed over them the share of pixels that is covered
    and the mean half width in mm.
    """
    found = []
    for splits in split_pairs(pairs, partitions):
        for split in splits.values():
            with warnings.catch_warnings(action="ignore"):
                bank = fit(pairs.select(split.train), "P")
            assert bank.intervals is not None
            kept_out = pairs.select(split.test)
            for name, spread in zip(bank.actions, bank.intervals, strict=True):
                pixels = roi_errors(bank, kept_out, name).pixels_mm
                half = np.asarray(half_width_mm(spread, pixels[..., 1]))
                inside = (pixels[..., 0] <= half).mean(1)
                found.append((len(half), np.prod(bank.roi(name)), inside.sum(), half.mean(1).sum()))
    return found


def groups(data: Path) -> Iterator[tuple[str, Path]]:
    """(name, folder) of all data sets."""
    for folder in FOLDERS:
        for path in sorted((data / folder).glob("*/pairs.csv")):
            yield (
                f"{path.parent.name}{folder.removeprefix('pairs').replace('_', ', ')}",
                path.parent,
            )


def fitted(options: argparse.Namespace) -> int:
    """Coverage of the intervals of banks that are fitted here."""
    known = list(groups(options.data))
    if not known:
        raise BadFile(f"{options.data}: has no pairs; expected {' and '.join(FOLDERS)}")
    rows = []
    for name, folder in progress(known, len(known), "fitting and testing"):
        pairs = load_pairs(folder)
        count, area, inside, half = np.transpose(covered(pairs, options.partitions))
        shares = inside.sum() / count.sum(), (area * inside).sum() / (area * count).sum()
        cells = (*(f"{100 * share:.1f}" for share in shares), f"{half.sum() / count.sum():.2f}")
        rows.append((name, len(pairs), *cells))
        print(*rows[-1], file=sys.stderr, flush=True)
    head = (
        "pairs", "count", f"in {100 * COVERED:.0f} % intervals (% of a ROI)",
        "(% of all pixels)", "half an interval (mm)",
    )  # fmt: skip
    return _tell(options, head, rows)


def planned(options: argparse.Namespace) -> int:
    """Coverage of the intervals of d, and of pixels, of plans that are carried out."""
    rows, everything = [], []
    for name, material, agent in BANKS:
        bank = load_bank(name)
        half = options.count // 2
        problems = applied_problems(SEED, options.count - half, bank, material=material)
        problems += shape_problems(SEED, half, material=material)
        found = []
        for k, problem in enumerate(progress(problems, len(problems), name)):
            plan = jshape.plan(
                problem.start, problem.goal, **jshape.options(bank=bank, max_steps=MAX_STEPS)
            )
            key = jax.random.key(SEED + k)
            world = SimulatedWorld(key, problem.bed, material=material, agent=agent)
            found += _carried_out(plan, world)
        everything += found
        rows.append((name, *_cells(found)))
    head = (
        "bank", "looks", "d in its 80 % interval (%)", "half of it (mm)", "pixels of ROIs (%)",
    )  # fmt: skip
    return _tell(options, head, [*rows, ("all", *_cells(everything))])


def _carried_out(plan: Plan, world: SimulatedWorld) -> list[tuple[bool, float, float]]:
    """After each action: whether d is in its interval, half of it (mm), share of pixels."""
    found, halves = [], plan.distance_half_widths_mm
    assert halves is not None and plan.goal is not None
    for k, act in enumerate(plan, 1):
        world.act(act.action, act.position, **act.how)
        look = seen(world)
        d_mm = float(metric.to_mm(metric.distance(look, plan.goal), plan.camera))
        pixels = plan.half_widths_after(k)
        assert pixels is not None
        off = np.asarray(metric.to_mm(np.abs(look - plan.images[k]), plan.camera))
        share = float((off <= pixels)[pixels > 0].mean())
        found.append((abs(d_mm - plan.distances_mm[k]) <= halves[k], float(halves[k]), share))
    return found


def _cells(found: list[tuple[bool, float, float]]) -> tuple[int | str, ...]:
    inside, half, pixels = np.mean(found, 0)
    return len(found), f"{100 * inside:.1f}", f"{half:.2f}", f"{100 * pixels:.1f}"


def _tell(options: argparse.Namespace, head: tuple[str, ...], rows: list) -> int:
    print_table(head, rows)
    if options.out:
        options.out.write_text(f"{markdown(head, rows)}\n")
    return 0


def main(words: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description="Whether 80 %% intervals hold.")
    parser.add_argument("--data", type=Path, default=default_data())
    parser.add_argument("--only", choices=["fitted", "plans"], default="fitted")
    parser.add_argument("--count", type=positive_count, default=14, help="goals per bank")
    parser.add_argument("--partitions", type=positive_count, default=4)
    parser.add_argument("--out", type=Path, help="the table as Markdown")
    kinds = {"fitted": fitted, "plans": planned}
    parser.set_defaults(run=lambda options: kinds[options.only](options))
    return run("benchmarks.intervals", parser, words)


if __name__ == "__main__":
    raise SystemExit(main())
