"""Plan the sequences of an independent material-point simulation: what was applied, what is found.

    python -m benchmarks.plan_against_mpm --data DIR

DIR holds the samples' `pairs/`, `pairs_noisy/`, `seqs/` and `seqs_noisy/`.  For every sequence the
first and the last frame are planned with a bank fitted to the matching pairs and with the bundled
one; then the simulated hands and places are compared with those that were applied.
"""

import argparse
import json
from pathlib import Path

from benchmarks.sim_against_mpm import default_data
from jshape import fit, load_bank, load_pairs, plan_depth
from jshape.io.images import read_depth
from jshape.planning.options import DEFAULT_BANK, PAPER, options

PAIRS_OF = {
    ("flat", "flour", "robot"): "flat_flour_robot",
    ("irregular", "flour", "robot"): "irregular_flour_robot",
    ("irregular", "sand", "human"): "irregular_sand_human",
}
"""Which pairs to fit to, by bed, material and agent of the sequence."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=default_data())
    data = parser.parse_args().data
    for noise in ("", "_noisy"):
        for folder in sorted((data / f"seqs{noise}").iterdir()):
            sequence = json.loads((folder / "sequence.json").read_text())
            kind = (sequence["surface"]["kind"], sequence["material"], sequence["agent"])
            fitted = fit(load_pairs(data / f"pairs{noise}" / PAIRS_OF[kind]))
            applied = [(a["action"], *a["position"]) for a in sequence["applied"]]
            print(f"{folder.name}{noise}: applied {_text(applied)}")
            frames = [read_depth(folder / f"{k}.png", depth_unit=1e-4) for k in (0, len(applied))]
            for name, bank in (("fitted", fitted), ("bundled", load_bank(DEFAULT_BANK))):
                found = plan_depth(
                    *frames,
                    **options(
                        PAPER, bank=bank, positions=sequence["positions"], out_of_bounds="drop"
                    ),
                )
                steps = list(zip(found.actions, *found.positions.T.tolist(), strict=True))
                missed = [step for step in applied if step not in steps]
                extra = len(steps) - (len(applied) - len(missed))
                d = found.distances_mm
                print(
                    f"  {name:7s} {_text(steps)}; d {d[0]:.3f} -> {d[-1]:.3f} mm; "
                    f"{len(applied) - len(missed)} of {len(applied)} found, {extra} besides"
                )


def _text(steps: list[tuple]) -> str:
    return ", ".join(f"{name} ({u}, {v})" for name, u, v in steps)


if __name__ == "__main__":
    main()
