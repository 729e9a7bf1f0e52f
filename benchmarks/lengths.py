"""How far off a stretched f_P is, beside an f_P that was fitted to paths of that very length.

    python -m benchmarks.lengths [--lengths 0.6 1 1.6] [--pairs 16] [--tested 12]

Sweeps of the simulated robot in flour.  `stretched` is fitted to paths of the hand's own length
and `lengthened`; `own` and `f_D` are fitted to as many pairs of the length itself.  All are tested
on the same other pairs, mm over the ROI of that length.
"""

import argparse

import jax
import numpy as np

from jshape.cli.tables import print_table
from jshape.data.pairs import Pairs
from jshape.data.simulate import simulate_pairs, together
from jshape.learn.fit import fit
from jshape.learn.scores import roi_errors_mm
from jshape.models.bank import Bank

ACTION, BEDS = "sweep", ("flat", "irregular")


def sweeps(seed: int, count: int, bed: str, length: float) -> Pairs:
    """`count` sweeps `length` times as long as the hand's own; no camera noise."""
    key = jax.random.key(seed)
    what = {"actions": (ACTION,), "beds": (bed,), "length": length, "noise": 0.0}
    return together(simulate_pairs(key, count, **what))


def compared(bed: str, lengths: list[float], count: int, tested: int) -> list[tuple[str, ...]]:
    """A row of the table per length."""
    trained, rows = fit(sweeps(1, count, bed, 1.0), "P"), []
    for length in lengths:
        own_pairs, test = sweeps(2, count, bed, length), sweeps(3, tested, bed, length)
        longer = trained.predictor(ACTION).lengthened(length)
        banks = {
            "f_D": fit(own_pairs, "D"),
            "own": fit(own_pairs, "P"),
            "stretched": Bank(trained.camera, (longer,), (ACTION,), "P"),
        }
        found = {
            name: roi_errors_mm(bank, test, ACTION, size=test.roi_size(ACTION))
            for name, bank in banks.items()
        }
        change = next(iter(found.values()))[1].mean()
        errors = {name: float(np.mean(error)) for name, (error, _) in found.items()}
        ratio = errors["stretched"] / errors["own"]
        numbers = (change, *errors.values(), ratio)
        rows.append((bed, f"{length:g}", *(f"{number:.2f}" for number in numbers)))
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.6, 1.0, 1.6])
    parser.add_argument("--pairs", type=int, default=16, help="to fit to")
    parser.add_argument("--tested", type=int, default=12)
    options = parser.parse_args()
    head = ("bed", "length", "change (mm)", "f_D", "own", "stretched", "stretched / own")
    rows = [compared(bed, options.lengths, options.pairs, options.tested) for bed in BEDS]
    print_table(head, [row for group in rows for row in group])


if __name__ == "__main__":
    main()
