"""How fast a bank learns from a run's own actions, replayed pair by pair in random orders.

    python -m benchmarks.online --data MPM [--noisy] [--orders 5] [--drift]

`MPM` holds `pairs/GROUP`.  The banks are of another hand, material or engine.  Each
order's first 25 pairs are the run; errors, mm over the ROI, are on all others.  `fitted` is the
start adapted to the 25 pairs all at once (`jshape.fit(pairs, "P", start=bank)`); numbers behind
"after" are errors times that bank's, their mean over orders and the standard deviation.
`worst` is the largest error after any look, times that of the start on the same pairs.

With `--drift` the hand and the material change after 20 looks; errors on later pairs of the new
ones are times those of the start, of the run / of one that begins with the change.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import console
from jshape import load_bank, load_pairs
from jshape.cli.tables import print_table
from jshape.data.pairs import Pairs
from jshape.errors import BadFile
from jshape.learn.fit import fit
from jshape.learn.lessons import Lesson, hand_of, lessons_of
from jshape.learn.online import Evidence
from jshape.models.bank import Bank

STARTS = (
    ("flat_flour_human", "pressed-flour-robot"),
    ("irregular_sand_human", "pressed-flour-human"),
    ("irregular_sand_human", "pressed-flour-robot"),
    ("irregular_flour_robot", "pressed-flour-robot"),
    ("flat_flour_robot", "pressed-flour-human"),
    ("flat_flour_robot", "pressed-flour-robot"),
)
"""(group of pairs, bank to begin with)."""
RUN, LOOKS = 25, (1, 2, 4, 8, 16, 25)
DRIFTS = (
    ("irregular_sand_human", "flat_flour_robot", "pressed-flour-robot"),
    ("flat_flour_robot", "irregular_sand_human", "pressed-flour-human"),
    ("irregular_flour_robot", "flat_flour_human", "pressed-flour-robot"),
)
"""(pairs before the change, pairs after it, bank to begin with)."""
BEFORE, AFTER = 20, (0, 2, 4, 8, 16)


def errors(bank: Bank, lessons: list[Lesson]) -> float:
    """Mean error over lessons, mm."""
    hands = [hand_of(bank, name) for name in bank.actions]
    return float(np.mean([one.error_mm(hands[one.action]) for one in lessons]))


def replayed(bank: Bank, pairs: Pairs, order: np.ndarray) -> tuple[dict[Any, float], list[float]]:
    """Errors by number of looks, "start" and "fitted"; and the seconds of each update."""
    run, later = (pairs.select(part) for part in (order[:RUN], order[RUN:]))
    held_out = lessons_of(bank, later)
    fitted = fit(run, "P", start=only(bank, run.actions))
    hands = tuple(
        (fitted if name in fitted.actions else bank).predictor(name) for name in bank.actions
    )
    found: dict[Any, float] = {"start": errors(bank, held_out)}
    found["fitted"] = errors(replace(bank, predictors=hands), held_out)
    evidence, seconds = Evidence(bank), []
    for count, lesson in enumerate(lessons_of(bank, run), 1):
        began = time.perf_counter()
        evidence = evidence.note(lesson)
        now = evidence.bank
        seconds.append(time.perf_counter() - began)
        found[count] = errors(now, held_out)
    return found, seconds


def only(bank: Bank, names: tuple[str, ...]) -> Bank:
    """The bank with some of its actions."""
    return Bank(bank.camera, tuple(map(bank.predictor, names)), names, bank.kind)


def drifts(options: argparse.Namespace) -> None:
    """Print the table of `DRIFTS`."""
    rows, rng = [], np.random.default_rng(0)
    for first, then, start in DRIFTS:
        bank = load_bank(start)
        old, new = (lessons_of(bank, _pairs(options, group, bank)) for group in (first, then))
        found = []
        for _ in range(options.orders):
            order = rng.permutation(len(new))
            run, held_out = ([new[k] for k in part] for part in (order[:16], order[16:]))
            both = [Evidence(bank), Evidence(bank)]
            for k in rng.permutation(len(old))[:BEFORE]:
                both[0] = both[0].note(old[k])
            base = errors(bank, held_out)
            row = [[errors(one.bank, held_out) / base for one in both]]
            for lesson in run:
                both = [one.note(lesson) for one in both]
                row.append([errors(one.bank, held_out) / base for one in both])
            found.append([row[n] for n in AFTER])
        mean = np.mean(found, 0)
        rows.append((first, then, start, *(f"{a:.2f} / {b:.2f}" for a, b in mean)))
    print_table(("before", "after", "bank", *(f"{n} looks after" for n in AFTER)), rows)


def _pairs(options: argparse.Namespace, group: str, bank: Bank) -> Pairs:
    folder = options.data / ("pairs_noisy" if options.noisy else "pairs") / group
    if not folder.is_dir():
        raise BadFile(f"{folder}: is no folder of pairs")
    pairs = load_pairs(folder)
    return pairs.select(np.isin(pairs.action, bank.actions))


def measure(options: argparse.Namespace) -> None:
    """Print the table of `STARTS`."""
    if options.drift:
        return drifts(options)
    rows, seconds = [], []
    for group, start in STARTS:
        bank = load_bank(start)
        pairs = _pairs(options, group, bank)
        rng, found = np.random.default_rng(0), []
        for k in range(options.orders):
            errors_by, took = replayed(bank, pairs, rng.permutation(len(pairs)))
            found.append(errors_by)
            seconds += took
            print(f"{group} from {start}: order {k + 1} of {options.orders}", file=sys.stderr)
        ratios = {n: [one[n] / one["fitted"] for one in found] for n in LOOKS}
        worst = max(one[n] / one["start"] for one in found for n in range(1, RUN + 1))
        mean = {n: float(np.mean([one[n] for one in found])) for n in ("start", "fitted")}
        rows.append(
            (
                group,
                start,
                f"{mean['start']:.2f}",
                f"{mean['fitted']:.2f}",
                f"{mean['start'] / mean['fitted']:.2f}",
                *(f"{np.mean(ratio):.2f} ± {np.std(ratio):.2f}" for ratio in ratios.values()),
                f"{worst:.2f}",
            )
        )
    head = ("pairs", "bank", "start", "fitted", "after 0", *(f"after {n}" for n in LOOKS), "worst")
    print_table(head, rows)
    print(
        f"an update: {np.median(seconds):.3f} s median, {np.quantile(seconds, 0.95):.3f} s of 95 %"
    )


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of pairs/GROUP")
    parser.add_argument("--noisy", action="store_true", help="pairs_noisy/GROUP instead")
    parser.add_argument("--drift", action="store_true", help="a change of hand and material")
    parser.add_argument("--orders", type=console.positive_count, default=5)
    parser.set_defaults(run=measure)
    return console.run("benchmarks.online", parser, None)


if __name__ == "__main__":
    sys.exit(main())
