"""f_P on real mounds and craters, each left out in turn, beside the mean map of the others.

    python -m benchmarks.real_effects [--data DIR]

DIR holds maps of how one drop of grains changed a level bed of sand (`*.npz`: `depthmap` in mm,
positive is raised, `xres` its pitch in mm).  Each is centred on its effect and cut to `SIDE` nodes.
`mean` is the leave-one-out error of the mean map, `scaled` that of the mean map times the factor
that fits best, known from the map itself; `f_P` that of f_P fitted to the others, told
nothing; `amount` is told how much was moved, as its strength: what lies higher than before,
as a share of the others' mean.  A robot knows how much it pours; nobody says how far grains fell.
All in mm, over the whole cut.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from benchmarks.sim_against_mpm import default_data
from jshape.camera import PAPER_BOX
from jshape.learn.first_guess import Shown, begin
from jshape.learn.imprint import STEP, absolute_error, descend, steps_for
from jshape.models.orthographic import OrthographicGrid

GROUPS = {
    "mounds on firm sand": ("compacted", 1, 99),
    "small craters": ("fluidized", 2, 8),
    "large craters": ("fluidized", 26, 37),
}
"""Kind of map, and the first and last number: they were dropped in turn, from unknown heights."""
SIDE = 101
"""Nodes of a cut: 0.28 m, two to three times as wide as what a drop changes."""
LEVEL = 0.45
"""Depth of the level bed, metres."""


def maps_of(folder: Path, kind: str, first: int, last: int) -> tuple[np.ndarray, float]:
    """Centred changes (n, SIDE, SIDE), metres lower, and their pitch in metres."""
    found, pitch = [], 0.0
    for number in range(first, last + 1):
        if not (path := folder / f"{kind}_{number}.npz").exists():
            continue
        with np.load(path) as file:
            raised, pitch = file["depthmap"].astype(float), 1e-3 * float(file["xres"])
        # Single nodes of one map are off by centimetres.
        smooth = np.abs(ndimage.gaussian_filter(ndimage.median_filter(raised, 5), 2))
        weight = np.where(smooth > 0.35 * smooth.max(), smooth, 0.0)
        off = np.array(ndimage.center_of_mass(weight)) - (np.array(raised.shape) - 1) / 2
        moved = ndimage.shift(raised, -off, order=1, mode="nearest")
        ahead = (len(raised) - SIDE) // 2
        found.append(-1e-3 * moved[ahead : ahead + SIDE, ahead : ahead + SIDE])
    return np.array(found, np.float32), pitch


def left_out(lower: np.ndarray, pitch: float, amount: np.ndarray) -> float:
    """Leave-one-out error of f_P whose strengths are the amounts (n,), mm."""
    camera = replace(PAPER_BOX, z_min=LEVEL - 0.2, z_max=LEVEL + 0.2)
    shape = lower.shape[1:]
    grid = OrthographicGrid(camera, jnp.float32(LEVEL), jnp.float32(pitch), shape, shape[::-1])
    level, errors = np.full(shape, LEVEL, np.float32), []
    for one in range(len(lower)):
        others = np.arange(len(lower)) != one
        usual = amount[others].mean()
        strength = jnp.asarray(amount[others] / usual, jnp.float32)
        before = np.broadcast_to(level, lower[others].shape)
        seen = jnp.ones(before.shape, jnp.float32)
        shown = Shown(jnp.asarray(before), jnp.asarray(before + lower[others]), seen, strength)
        first, fixed, alike = begin(grid, shown)
        way = steps_for(len(before), alike), STEP, fixed, alike
        found = descend(absolute_error, first, shown, jax.random.key(0), *way)
        change = np.asarray(found.change(level, np.float32(amount[one] / usual)))
        errors.append(1e3 * np.abs(change - lower[one]).mean())
    return float(np.mean(errors))


def row_of(lower: np.ndarray, pitch: float) -> tuple[str, ...]:
    """A row of the table."""
    count, whole = len(lower), lower.sum(0)
    means = [(whole - one) / (count - 1) for one in lower]
    scales = [(one * m).sum() / (m * m).sum() for one, m in zip(lower, means, strict=True)]
    mean, scaled = (
        1e3
        * np.mean([np.abs(one - k * m).mean() for one, m, k in zip(lower, means, by, strict=True)])
        for by in (np.ones(count), scales)
    )
    raised = np.maximum(-lower, 0.0).sum((1, 2))
    told = left_out(lower, pitch, np.ones(count)), left_out(lower, pitch, raised)
    change = 1e3 * np.abs(lower).mean()
    ratios = (f"{error / mean:.2f}" for error in told)
    return (f"{count}", *(f"{x:.2f}" for x in (change, mean, scaled, *told)), *ratios)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    real = default_data().parent / "real" / "craters"
    parser.add_argument("--data", type=Path, default=real)
    options = parser.parse_args(arguments)
    head = ("n", "change", "mean", "scaled", "f_P", "amount", "f_P/mean", "amount/mean")
    print(f"{'maps':20}", *(f"{name:>11}" for name in head))
    for name, which in GROUPS.items():
        row = row_of(*maps_of(options.data, *which))
        print(f"{name:20}", *(f"{cell:>11}" for cell in row), flush=True)


if __name__ == "__main__":
    main()
