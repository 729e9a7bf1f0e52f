"""The paper's distance beside what others use: time, value, and how well each ranks.

Everything is measured in one run on the same beds; times are to be compared as ratios.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import clouds
from benchmarks.experiments import metric_figures, pages
from benchmarks.experiments.ranking import rank
from benchmarks.experiments.samples import CAMERAS, Asked
from jshape import metric, sim
from jshape.camera import Camera

FIGURES = ("times.png", "emd.png", "ranking.png")
POINTS = {True: (100, 300, 1000), False: (100, 300, 1000, 3000, 6000)}
"""Of the earth mover's distance, if quick and if not."""
ONCE = 0.5
"""What takes longer than this is timed once, seconds."""
ROUNDS = 5
"""Rounds of what is quicker; the median counts."""


class Pair(NamedTuple):
    """Two surfaces as the camera sees them, without noise."""

    camera: Camera
    images: tuple[np.ndarray, np.ndarray]
    """I = R∘L, (H, W)."""
    luminances: tuple[np.ndarray, np.ndarray]
    """(H, W), not rounded to levels."""

    def clouds(self) -> tuple[np.ndarray, np.ndarray]:
        """(H·W, 3) each, mm."""
        p, q = (cloud_mm(level, self.camera) for level in self.luminances)
        return p, q

    @property
    def d_mm(self) -> float:
        """The paper's distance, mm."""
        return float(metric.to_mm(metric.distance(*self.images), self.camera))


def cloud_mm(luminance: np.ndarray, camera: Camera) -> np.ndarray:
    """(H·W, 3) the points of a luminance image, mm."""
    return 1e3 * np.asarray(camera.points(luminance)).reshape(-1, 3)


def seen(before: sim.Bed, after: sim.Bed, camera: Camera) -> Pair:
    """Two beds as one camera sees them."""
    levels = [
        np.asarray(camera.luminance(sim.render(bed, camera), quantize=False))
        for bed in (before, after)
    ]
    first, second = (np.asarray(metric.weigh(level, camera)) for level in levels)
    return Pair(camera, (first, second), (levels[0], levels[1]))


def beds(seed: int) -> tuple[sim.Bed, sim.Bed]:
    """An irregular bed, and the same after a knock and a grasp apart from each other."""
    for_bed, for_knock, for_grasp = jax.random.split(jax.random.key(seed), 3)
    before = sim.irregular_bed(for_bed, 0.004)
    after = sim.apply_action(for_knock, before, "flour", ("knock", "robot"), (-0.09, -0.04))
    after = sim.apply_action(for_grasp, after, "flour", ("grasp", "robot"), (0.09, 0.05))
    return before, after


def seconds(call: Callable[[], Any]) -> float:
    """Median time of a call after a first one, which compiles and warms up; long ones run once."""
    start = time.perf_counter()
    call()
    once = time.perf_counter() - start
    if once > ONCE:
        return once
    calls = max(1, round(0.02 / max(once, 1e-7)))
    found = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(calls):
            call()
        found.append((time.perf_counter() - start) / calls)
    return float(np.median(found))


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Time and value of d, Chamfer, ICP and the earth mover's distance, and how they rank.

    Args:
      out: folder of the result.
      asked: quick: two image sizes, few points, few sequences.

    Returns:
      What `results.json` holds; rows have a column `part`: "time", "emd" or "ranking".

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    pages.check(out, asked.overwrite, FIGURES)
    before, after = beds(asked.seed)
    sizes = list(CAMERAS)[: 2 if asked.quick else 3]
    rows: list[dict[str, Any]] = []
    for size in sizes:
        asked.say(f"timing at {size}")
        rows += timed(seen(before, after, CAMERAS[size]), size)
    asked.say("earth mover's distance with more and more points")
    small = seen(before, after, CAMERAS["480x395"])
    rows += transported(small, POINTS[asked.quick], asked.seed)
    many, steps = (4, 4) if asked.quick else (20, 6)
    asked.say(f"ranking {many} molding sequences of {steps} actions")
    ranked, curves = rank(asked.seed, many, steps, asked.progress)
    rows += ranked
    settings = {"sizes": sizes, "points": POINTS[asked.quick], "sequences": many, "actions": steps,
                "seed": asked.seed, "trees": clouds.installed(clouds.TREES),
                "movers": clouds.installed(clouds.MOVERS)}  # fmt: skip
    result = metric_figures.result(rows, curves, settings, FIGURES)
    return pages.write(result, out, overwrite=asked.overwrite)


def timed(pair: Pair, size: str) -> list[dict[str, Any]]:
    """A row per method that uses all points."""
    p, q = pair.clouds()
    trees = clouds.installed(clouds.TREES)
    best = trees[-1]
    plain_mm = 1e3 * float(pair.camera.z_max - pair.camera.z_min) / pair.camera.top
    calls: dict[str, tuple[Callable[[], Any], Callable[[], float | None]]] = {
        "d": (lambda: metric.distance(*pair.images), lambda: pair.d_mm),
        "depth difference": (
            lambda: np.abs(pair.luminances[0] - pair.luminances[1]).mean(),
            lambda: plain_mm * float(np.abs(pair.luminances[0] - pair.luminances[1]).mean()),
        ),
        "making the two clouds": (pair.clouds, lambda: None),
    }
    for tree in trees:
        chamfer = partial(clouds.chamfer, p, q, tree)
        calls[f"Chamfer ({tree})"] = chamfer, chamfer
    found = []
    for name, (call, value) in calls.items():
        found.append(_row(size, name, len(p), seconds(call), value()))
    start = time.perf_counter()
    matching = clouds.icp(p, q, best)
    took = time.perf_counter() - start
    found.append(_row(size, f"ICP ({best})", len(p), took, matching.distance))
    for row in found:
        row["times_d"] = row["seconds"] / found[0]["seconds"]
    found[-1]["rounds"] = matching.rounds
    return found


def _row(size: str, name: str, points: int, took: float, value: float | None) -> dict[str, Any]:
    return {"part": "time", "size": size, "method": name, "points": points,
            "seconds": took, "value_mm": value}  # fmt: skip


def transported(pair: Pair, points: tuple[int, ...], seed: int) -> list[dict[str, Any]]:
    """The earth mover's distance of N points: the same pixels of both images, and drawn at random.

    Beside each, d over the same pixels, the Chamfer distance of the same points, and d of all.
    """
    rng = np.random.default_rng([seed, 4])
    p, q = pair.clouds()
    movers = clouds.installed(clouds.MOVERS)
    matched = np.linalg.norm(p - q, axis=1)
    for mover in movers:  # what loads a package is not its time
        clouds.emd(p[:2], q[:2], mover)
    found = []
    for count in points:
        even = clouds.spread(pair.camera.shape, count)
        drawn = clouds.drawn(rng, p, len(even)), clouds.drawn(rng, q, len(even))
        chosen = {"same pixels": ((p[even], q[even]), even), "random": (drawn, None)}
        for choice, ((few_p, few_q), index) in chosen.items():
            for mover in movers:
                start = time.perf_counter()
                value = clouds.emd(few_p, few_q, mover)
                row = {
                    "part": "emd", "size": "{1}x{0}".format(*pair.camera.shape),
                    "method": f"EMD ({mover})", "choice": choice, "points": len(even),
                    "seconds": time.perf_counter() - start, "value_mm": value,
                    "d_same_pixels_mm": None if index is None else float(matched[index].mean()),
                    "chamfer_mm": clouds.chamfer(few_p, few_q), "d_mm": pair.d_mm,
                }  # fmt: skip
                found.append(row)
    return found
