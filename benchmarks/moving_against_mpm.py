"""Compare sweeps, scoops and pours of the simulator with material-point samples and real mounds.

    python -m benchmarks.moving_against_mpm [--data DIR] [--each]
    python -m benchmarks.moving_against_mpm --mounds [--real DIR]

The first form does for the moving actions what `sim_against_mpm` does for those that press: for
every pair of frames (before, after) of the samples the nominal stroke, as strong as the pair says,
over the bed rebuilt from the frame before.  Means over the pairs of a row: `change` mean |after -
before| over the ROI, `f_D` leave-one-out error of the mean difference image (all strengths), `sim`
mean |simulator - sample|, mm; then sample / simulator: volume where the bed sank and where it rose,
what the bed holds more (negative: less, packed or taken), cm³, highest rise, mm, and the median
slope where it rose more than 3 mm, degrees.

The second pours real mounds again: as much as each map shows, onto a level bed of sand, at its
middle.  `handful` is the nominal `pour`, `wide` one that lands with a radius of `WIDE`.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from scipy import ndimage

from benchmarks.sim_against_mpm import default_data, leave_one_out, read_group, rebuild, roi
from jshape.camera import Camera
from jshape.sim import KINETIC_SAND, MOVING, apply_action, flat_bed, position_to_xy, render, stroke

GROUPS = ("flat_flour_robot", "irregular_flour_robot")
WIDE = 0.11
"""Radius with which the grains of the real mounds lie after their fall, metres: fitted."""
PIXEL = 450.0 / 433.0  # mm at the surface


def numbers(before: np.ndarray, after: np.ndarray) -> tuple[float, ...]:
    """Sunk, risen and net volume (cm³), highest rise (mm), slope of heaps (degrees)."""
    rise = (before - after) * 1000.0
    per_cm3 = PIXEL**2 / 1000.0
    risen, sunk = (np.maximum(sign * rise, 0.0).sum() * per_cm3 for sign in (1, -1))
    smooth = ndimage.uniform_filter(after * 1000.0, 5) / PIXEL  # 0.1 mm are the frames' counts
    slope = np.hypot(*np.gradient(smooth))[rise > 3.0]
    steep = float(np.degrees(np.arctan(np.median(slope)))) if slope.size else np.nan
    return float(sunk), float(risen), float(risen - sunk), float(rise.max()), steep


def compare(pairs: list[dict], camera: Camera) -> list[dict]:
    """The numbers of every pair."""
    rows = []
    for pair in pairs:
        bed = rebuild(pair["prior"], camera)
        xy = position_to_xy(camera, np.array([pair["u"], pair["v"]], np.float32))
        action, strong = (pair["action"], pair["agent"]), float(pair["strength"])
        made = apply_action(
            jax.random.key(0), bed, pair["material"], action, xy, strong, spread=0.0
        )
        frames = (pair["prior"], pair["posterior"], *(render(b, camera) for b in (bed, made)))
        before, after, sim_before, sim_after = (roi(pair, np.asarray(frame)) for frame in frames)
        known = (before > 0) & (after > 0)
        before, after = (np.where(known, z, sim_before) for z in (before, after))
        rows.append({
            "strength": strong,
            "change": (after - before) * 1000.0,
            "sim": float(np.abs(sim_after - after)[known].mean() * 1000.0),
            "sample": numbers(before, after),
            "simulated": numbers(sim_before, sim_after),
            "taken": float(made.stock) * 1e6,
        })  # fmt: skip
    return rows


def table(data: Path, each: bool) -> None:
    """Print a row for every action of every group, and every pair if `each`."""
    print(
        f"{'group':22} {'action':6} {'n':>3} {'change':>6} {'f_D':>5} {'sim':>5}   "
        f"{'sank cm³':>11} {'rose cm³':>11} {'net cm³':>11} {'taken':>6} "
        f"{'height mm':>11} {'slope °':>11}"
    )
    for group in GROUPS:
        camera, pairs = read_group(data / "carry" / "pairs" / group)
        for action in MOVING:
            rows = compare([pair for pair in pairs if pair["action"] == action], camera)
            for row in sorted(rows, key=lambda row: row["strength"]) if each else ():
                _print(group, f"{row['strength']:.2f}", [row], float("nan"))
            _print(group, action, rows, leave_one_out([row["change"] for row in rows]))


def _print(group: str, name: str, rows: list[dict], f_d: float) -> None:
    sample, simulated = (np.nanmean([r[k] for r in rows], 0) for k in ("sample", "simulated"))
    both = [f"{a:5.1f}/{b:5.1f}" for a, b in zip(sample, simulated, strict=True)]
    change, sim, taken = (
        np.mean([np.abs(r[k]).mean() for r in rows]) for k in ("change", "sim", "taken")
    )
    print(
        f"{group:22} {name:6} {len(rows):3d} {change:6.2f} {f_d:5.2f} {sim:5.2f}   "
        f"{' '.join(both[:3])} {taken:6.1f} {' '.join(both[3:])}"
    )


def mounds(real: Path) -> None:
    """Print how close poured mounds come to real ones, and both mean profiles."""
    maps = []
    for path in sorted((real / "craters").glob("compacted_*.npz")):
        with np.load(path) as file:
            maps.append((path.stem, file["depthmap"].astype(float), float(file["xres"]) / 1000.0))
    names = ("real", "handful", "wide")
    profiles: dict[str, list[np.ndarray]] = {name: [] for name in names}
    errors: dict[str, list[float]] = {name: [] for name in names}
    pour = stroke("pour")
    wide = replace(pour, radius=pour.radius.at[0].set(WIDE))
    for _, height, cell in maps:
        bed = flat_bed(0.06, size=(height.shape[1] * cell, height.shape[0] * cell), cell=cell)
        x, y = (np.asarray(axis) for axis in bed.axes())
        weight = np.where(height > 3.0, height, 0.0)
        middle = (weight.sum(0) @ x / weight.sum(), weight.sum(1) @ y / weight.sum())
        far = np.hypot(x[None] - middle[0], y[:, None] - middle[1])
        volume = height[far < 0.11].sum() * cell**2 / 1000.0
        share = volume / float(pour.load.gives * KINETIC_SAND.bulk)
        for name, tool in zip(names, (None, pour, wide), strict=True):
            made = height
            if tool is not None:
                after = apply_action(
                    jax.random.key(0), bed, KINETIC_SAND, tool, middle, share, spread=0.0
                )
                made = (np.asarray(after.height) - 0.06) * 1000.0
            errors[name].append(np.abs((made if tool else 0.0) - height)[far < 0.11].mean())
            rings = (far / 0.01).astype(int)
            sums = [np.bincount(rings.ravel(), a.ravel())[:11] for a in (made, np.ones_like(far))]
            profiles[name].append(sums[0] / sums[1])
    print(f"{len(maps)} mounds; mean |difference| within 110 mm, and mean height by distance, mm")
    print(f"{'':9} {'error':>6}  " + " ".join(f"{10 * k + 5:5d}" for k in range(11)))
    for name in names:
        shown = " ".join(f"{value:5.1f}" for value in np.mean(profiles[name], 0))
        print(f"{name:9} {np.mean(errors[name]):6.2f}  {shown}")


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=default_data())
    parser.add_argument("--real", type=Path, default=default_data().parent / "real")
    parser.add_argument("--each", action="store_true", help="every pair, too")
    parser.add_argument("--mounds", action="store_true", help="real mounds instead")
    args = parser.parse_args()
    if args.mounds:
        mounds(args.real)
    else:
        table(args.data, args.each)


if __name__ == "__main__":
    main()
