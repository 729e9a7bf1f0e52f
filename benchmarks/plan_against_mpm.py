"""Plan the sequences of an independent material-point simulation: what was applied, what is found.

    python -m benchmarks.plan_against_mpm --data DIR [--only seqs carry/seqs]

DIR holds the samples' `pairs/`, `pairs_noisy/`, `seqs/` and `seqs_noisy/`, and likewise `carry/`.
For every sequence the first and the last frame are planned with a bank fitted to the matching pairs
and, for the pressing actions, with the bundled one on the paper's places; sequences that move
material with all eight actions at dense places, with a stock.  Then the actions and places are
compared with those that were applied.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sim_against_mpm import default_data
from jshape import Bank, fit, load_bank, load_pairs, plan_depth
from jshape.io.images import read_depth
from jshape.planning.options import DEFAULT_BANK, PAPER, options

PAIRS_OF = {
    ("flat", "flour", "robot"): "flat_flour_robot",
    ("irregular", "flour", "robot"): "irregular_flour_robot",
    ("irregular", "sand", "human"): "irregular_sand_human",
}
"""Which pairs to fit to, by bed, material and agent of the sequence."""
SWEPT_M = 0.08
"""Length of the sweeps' path, which the samples' table does not hold."""
STOCK_CM3 = 100.0
"""So that a scoop and a pour can be found one without the other."""
NEAR = 12
"""At most so many pixels from the place applied an action at dense places counts as found: the
samples are about 1 mm per pixel."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=default_data())
    parser.add_argument("--only", nargs="+", default=["seqs", "seqs_noisy", "carry/seqs"])
    given = parser.parse_args()
    for part in given.only:
        fitted = {}
        for folder in sorted((given.data / part).iterdir()):
            sequence = json.loads((folder / "sequence.json").read_text())
            group = PAIRS_OF[sequence["surface"]["kind"], sequence["material"], sequence["agent"]]
            applied = [(a["action"], *a["position"]) for a in sequence["applied"]]
            print(f"{part}/{folder.name}: applied {_text(applied)}")
            frames = [read_depth(folder / f"{k}.png", depth_unit=1e-4) for k in (0, len(applied))]
            if group not in fitted:
                fitted[group] = _fitted(given.data, part, group)
            near, banks = 0, {"fitted": fitted[group]}
            how = options(PAPER, positions=sequence["positions"], out_of_bounds="drop")
            if part.startswith("carry"):
                near, how = NEAR, options(stock_cm3=STOCK_CM3)
            else:
                banks["bundled"] = load_bank(DEFAULT_BANK)
            for name, bank in banks.items():
                _report(name, plan_depth(*frames, **options(how, bank=bank)), applied, near)


def _fitted(data: Path, part: str, group: str) -> Bank:
    """A bank of the pairs of a sequence's kind; of both kinds where material is moved."""
    if not part.startswith("carry"):
        return fit(load_pairs(data / part.replace("seqs", "pairs") / group))
    one, other = (
        fit(load_pairs(data / folder / group), kind="P") for folder in ("pairs", "carry/pairs")
    )
    predictors = [
        replace(hand, path=SWEPT_M) if name == "sweep" else hand
        for name, hand in zip(other.actions, other.predictors, strict=True)
    ]
    return replace(
        one,
        actions=one.actions + other.actions,
        predictors=(*one.predictors, *predictors),
        errors_mm=np.concatenate([np.asarray(bank.errors_mm) for bank in (one, other)]),
        intervals=np.concatenate([np.asarray(bank.intervals) for bank in (one, other)]),
    )


def _report(name: str, found: Any, applied: list[tuple], near: int) -> None:
    """What of the actions applied was found, within so many pixels."""
    steps = list(zip(found.actions, *found.positions.T.tolist(), strict=True))
    left = list(steps)
    for step in applied:
        same = [one for one in left if one[0] == step[0]]
        same = [one for one in same if np.hypot(one[1] - step[1], one[2] - step[2]) <= near]
        if same:
            left.remove(same[0])
    d, count = found.distances_mm, len(steps) - len(left)
    strokes = [s for a, s in zip(found.actions, found.strokes, strict=True) if a == "sweep"]
    swept = "".join(f"; swept by ({u:.0f}, {v:.0f}) pixels" for u, v in strokes)
    print(
        f"  {name:7s} {_text(steps)}; d {d[0]:.3f} -> {d[-1]:.3f} mm; "
        f"{count} of {len(applied)} found, {len(left)} besides{swept}",
        flush=True,
    )


def _text(steps: list[tuple]) -> str:
    return ", ".join(f"{name} ({u}, {v})" for name, u, v in steps)


if __name__ == "__main__":
    main()
