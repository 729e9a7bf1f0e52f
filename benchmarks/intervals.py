"""Whether the 80 % intervals of predictions hold on pairs that were held out.

    python -m benchmarks.intervals --data DIR [--only fitted] [--partitions 4]

DIR holds the independent material-point simulation: `pairs` and `pairs_noisy`, one data set a
folder.  A bank is fitted to 75 % of the pairs of each, as `jshape train` does, its intervals with
it, and tested on the rest: every pair counts the same (in the next column every pixel, so that a
grasp counts 18 times as much as a poke).
"""

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.console import positive_count, run
from benchmarks.sim_against_mpm import default_data
from jshape import load_pairs
from jshape.cli.tables import print_table, progress
from jshape.data.pairs import Pairs
from jshape.errors import BadFile
from jshape.learn.report import markdown
from jshape.learn.scores import roi_errors
from jshape.learn.study import split_pairs
from jshape.learn.validation import fit
from jshape.models.spread import COVERED, half_width_mm

FOLDERS = "pairs", "pairs_noisy"


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
            assert bank.spread is not None
            kept_out = pairs.select(split.test)
            for name, spread in zip(bank.actions, bank.spread, strict=True):
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
    print_table(head, rows)
    if options.out:
        options.out.write_text(f"{markdown(head, rows)}\n")
    return 0


def main(words: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description="Whether 80 %% intervals hold.")
    parser.add_argument("--data", type=Path, default=default_data())
    parser.add_argument("--only", choices=["fitted"])
    parser.add_argument("--partitions", type=positive_count, default=4)
    parser.add_argument("--out", type=Path, help="the table as Markdown")
    parser.set_defaults(run=fitted)
    return run("benchmarks.intervals", parser, words)


if __name__ == "__main__":
    raise SystemExit(main())
