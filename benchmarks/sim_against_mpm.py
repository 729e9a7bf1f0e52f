"""Compare the simulator's craters, rims and mounds with material-point samples, in millimetres.

For every pair of frames (before, after) of the samples: rebuild the bed from the frame before,
apply the same action at the same place with the agent's nominal stroke, look at the result with
the same camera, and compare with the frame after over the action's ROI.

    python -m benchmarks.sim_against_mpm --data DIR [--groups ...] [--split all|fit|held]
    python -m benchmarks.sim_against_mpm --data DIR --sequences

    python -m benchmarks.sim_against_mpm --data DIR --repetitions

The second form applies whole sequences of actions, one on top of the other, to the full box; the
third compares how much repetitions differ on a flat bed.

Columns, all means over the pairs of a row: `change` mean |after - before| of the sample (what
doing nothing would be off by), `f_D` leave-one-out error of the mean difference image, `sim` the
simulator's mean |difference| to the sample after the action; then crater depth, rim height and
affected area, sample / simulator.
"""

import argparse
import csv
import json
import os
from pathlib import Path

import cv2
import jax
import numpy as np
from scipy import ndimage

from jshape.camera import Camera
from jshape.data.simulate import bed_of_depth
from jshape.sim import ACTIONS, apply_action, position_to_xy, render

GROUPS = (
    "flat_flour_robot",
    "flat_flour_human",
    "irregular_flour_robot",
    "irregular_sand_human",
)


def default_data() -> Path:
    """Where the samples are unless told: below $JSHAPE_SHARED, or beside the repository."""
    shared = os.environ.get("JSHAPE_SHARED")
    beside = Path(__file__).resolve().parents[2] / "shared"
    return (Path(shared) if shared else beside) / "data" / "mpm"


def read_group(folder: Path) -> tuple[Camera, list[dict]]:
    """The camera and the pairs of a group; frames in metres, 0 for no reading."""
    fields = json.loads((folder / "camera.json").read_text())
    unit = fields.pop("depth_unit")
    pairs = []
    with open(folder / "pairs.csv", newline="") as file:
        for row in csv.DictReader(file):
            for name in ("prior", "posterior"):
                raw = cv2.imread(str(folder / row[name]), cv2.IMREAD_UNCHANGED)
                row[name] = raw.astype(np.float32) * unit
            for name in ("u", "v", "width", "height"):
                row[name] = int(row[name])
            pairs.append(row)
    return Camera(**fields), pairs


def rebuild(depth: np.ndarray, camera: Camera):
    """The bed under a depth image; pixels without a reading take the nearest one's."""
    nearest = ndimage.distance_transform_edt(depth <= 0, return_indices=True)[1]
    return bed_of_depth(depth[tuple(nearest)], camera)


def roi(pair: dict, image: np.ndarray) -> np.ndarray:
    """The pair's ROI of an image."""
    left, top = pair["u"] - pair["width"] // 2, pair["v"] - pair["height"] // 2
    return image[top : top + pair["height"], left : left + pair["width"]]


def shape_numbers(before: np.ndarray, after: np.ndarray) -> tuple[float, float, float]:
    """Crater depth and rim height (98th percentiles, mm) and affected area (> 2 mm, mm²)."""
    rise = (before - after) * 1000.0
    pixel = 450.0 / 433.0  # mm at the surface
    area = (np.abs(rise) > 2.0).sum() * pixel**2
    return -np.percentile(rise, 2), np.percentile(rise, 98), float(area)


def simulate(pair: dict, camera: Camera, seed: int = 0, spread: float = 0.0):
    """The rebuilt bed seen before and after the simulated action, metres."""
    bed = rebuild(pair["prior"], camera)
    xy = position_to_xy(camera, np.array([pair["u"], pair["v"]], np.float32))
    action = (pair["action"], pair["agent"])
    key = jax.random.key(seed)
    after = apply_action(key, bed, pair["material"], action, xy, spread=spread)
    return np.asarray(render(bed, camera)), np.asarray(render(after, camera))


def compare(pairs: list[dict], camera: Camera) -> dict:
    """The numbers of one row: pairs of one action of one group."""
    changes, errors, samples, simulated = [], [], [], []
    for pair in pairs:
        before, after = roi(pair, pair["prior"]), roi(pair, pair["posterior"])
        known = (before > 0) & (after > 0)
        sim_before, sim_after = (roi(pair, z) for z in simulate(pair, camera))
        changes.append(np.where(known, after - before, 0.0) * 1000.0)
        errors.append(np.abs(sim_after - after)[known].mean() * 1000.0)
        samples.append(shape_numbers(np.where(known, before, 0), np.where(known, after, 0)))
        simulated.append(shape_numbers(sim_before, sim_after))
    return dict(
        change=float(np.abs(changes).mean()),
        f_D=leave_one_out(changes),
        sim=float(np.mean(errors)),
        sample=np.mean(samples, axis=0),
        simulated=np.mean(simulated, axis=0),
        count=len(pairs),
    )


def leave_one_out(changes: list[np.ndarray]) -> float:
    """Mean |difference| between each change and the mean of the others."""
    changes = np.stack(changes)
    others = (changes.sum(0) - changes) / (len(changes) - 1)
    return float(np.abs(changes - others).mean())


def repetitions(data: Path, draws: int = 4) -> None:
    """How much repetitions on a flat bed differ: leave-one-out error, sample and simulator."""
    print(f"{'group':22} {'action':6} {'sample':>7} {'sim':>6}   leave-one-out error, mm")
    for group in GROUPS[:2]:
        camera, pairs = read_group(data / "pairs" / group)
        for action in ACTIONS:
            chosen = [p for p in pairs if p["action"] == action]
            rows = [[roi(p, p["posterior"]) - roi(p, p["prior"]) for p in chosen]]
            for draw in range(draws):
                seen = [simulate(p, camera, 100 * draw + k, 1.0) for k, p in enumerate(chosen)]
                rows.append([roi(p, b - a) for p, (a, b) in zip(chosen, seen, strict=True)])
            valid = [(roi(p, p["posterior"]) > 0) & (roi(p, p["prior"]) > 0) for p in chosen]
            errors = [
                leave_one_out([1000.0 * d * ok for d, ok in zip(row, valid, strict=True)])
                for row in rows
            ]
            print(f"{group:22} {action:6} {errors[0]:7.2f} {np.mean(errors[1:]):6.2f}")


def split_of(pairs: list[dict], split: str) -> list[dict]:
    """`fit`: what the constants were fitted to (all flat, every other irregular); `held`: rest."""
    chosen = []
    for k, pair in enumerate(pairs):
        fitted = pair["group"].startswith("flat") or k % 2 == 0
        if split == "all" or fitted == (split == "fit"):
            chosen.append(pair)
    return chosen


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=default_data())
    parser.add_argument("--groups", nargs="+", default=GROUPS)
    parser.add_argument("--actions", nargs="+", default=ACTIONS)
    parser.add_argument("--split", choices=("all", "fit", "held"), default="all")
    parser.add_argument("--noisy", action="store_true", help="use the frames with camera noise")
    parser.add_argument("--sequences", action="store_true", help="whole sequences instead")
    parser.add_argument("--repetitions", action="store_true", help="how much repetitions differ")
    args = parser.parse_args()
    if args.repetitions:
        repetitions(args.data)
        return
    if args.sequences:
        sequences(args.data)
        return
    print(
        f"{'group':22} {'action':6} {'n':>3} {'change':>7} {'f_D':>6} {'sim':>6}   "
        f"{'crater mm':>13} {'rim mm':>13} {'area mm²':>13}"
    )
    for group in args.groups:
        folder = args.data / ("pairs_noisy" if args.noisy else "pairs") / group
        camera, pairs = read_group(folder)
        for pair in pairs:
            pair["group"] = group
        rows = []
        for action in args.actions:
            chosen = split_of([p for p in pairs if p["action"] == action], args.split)
            if len(chosen) < 2:
                continue
            row = compare(chosen, camera)
            rows.append(row)
            _print(group, action, row)
        if rows:
            mean = {k: np.mean([r[k] for r in rows], axis=0) for k in rows[0]}
            mean["count"] = sum(r["count"] for r in rows)
            _print(group, "mean", mean)


def sequences(data: Path) -> None:
    """Whole sequences: error over the full box after every action, without looking in between."""
    print(f"{'sequence':22} {'after':>18} {'change':>7} {'sim':>6}   mean over the box, mm")
    for folder in sorted((data / "seqs").iterdir()):
        fields = json.loads((folder / "camera.json").read_text())
        unit = fields.pop("depth_unit")
        camera, told = Camera(**fields), json.loads((folder / "sequence.json").read_text())
        frames = [
            cv2.imread(str(folder / f"{k}.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) * unit
            for k in range(len(told["applied"]) + 1)
        ]
        bed = rebuild(frames[0], camera)
        for step, frame in zip(told["applied"], frames[1:], strict=True):
            xy = position_to_xy(camera, np.array(step["position"], np.float32))
            action = (step["action"], told["agent"])
            bed = apply_action(jax.random.key(0), bed, told["material"], action, xy, spread=0.0)
            known = (frame > 0) & (frames[0] > 0)
            change = np.abs(frame - frames[0])[known].mean() * 1000.0
            error = np.abs(np.asarray(render(bed, camera)) - frame)[known].mean() * 1000.0
            print(f"{folder.name:22} {step['action']:>18} {change:7.2f} {error:6.2f}")


def _print(group: str, action: str, row: dict) -> None:
    pairs = zip(row["sample"], row["simulated"], (1, 1, 0), strict=True)
    shapes = " ".join(f"{a:6.{d}f}/{b:6.{d}f}" for a, b, d in pairs)
    print(
        f"{group:22} {action:6} {row['count']:3d} {row['change']:7.2f} {row['f_D']:6.2f} "
        f"{row['sim']:6.2f}   {shapes}"
    )


if __name__ == "__main__":
    main()
