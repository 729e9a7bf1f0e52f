"""The paper's distance beside OpenCV, NumPy, Chamfer, ICP and optimal transport."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import ot

import jshape
from benchmarks import clouds, metric_memory, metric_peers, metric_pictures
from benchmarks.experiments.metric import Pair, beds, seen, timed, transported
from benchmarks.experiments.metric import seconds as seconds_or_once
from benchmarks.experiments.samples import CAMERAS, smaller
from benchmarks.metric_growth import Growth, growth
from benchmarks.metric_words import duration, ratio
from benchmarks.report import Report
from benchmarks.timing import in_turns, seconds
from jshape import metric

WIDE = replace(jshape.D435_BAZAR, width=1280, height=720, fx=433 * 1280 / 848, fy=433 * 1.5,
               u0=421 * 1280 / 848, v0=243 * 1.5)  # fmt: skip
"""The paper's D435 in pixels two thirds as wide."""
SIZES = {"120x99": smaller(jshape.PAPER_BOX, 4), **CAMERAS, "1280x720": WIDE}
SEED = 0
POINTS = (1000, 2000, 4000, 8000)
"""Of exact transport: 8000 end within 20 s with the slower solver, 16,000 do not."""
MOST = 16_000
"""Of the quicker solver on matched points: its matrix takes 2 GB."""
PAIRS = (1, 4, 16, 64, 256, 1024)
BLURS = (30.0, 10.0, 3.0, 1.0)
"""Of entropic transport, mm."""
ROUNDS = 200
"""Of entropic transport; how much mass its plan then has wrong stands in the table."""
COARSE_SIZE, COARSE = "60x50", smaller(jshape.PAPER_BOX, 8)
"""Entropic transport of all points is measured here and at 120x99; beyond, a round alone
takes half a minute."""
PROJECTIONS = 10
"""Of the sliced distance."""
SLICED = f"sliced transport, {PROJECTIONS} directions (pot)"


def run(report: Report, out: Path) -> None:
    pair = {size: seen(*beds(SEED), camera) for size, camera in SIZES.items()}
    box = pair["480x395"]
    one_pair(report, box)
    batches(report, box)
    eight_bits(report, box)
    times = [row for size in SIZES for row in at_size(pair[size], size)]
    moved = transported(box, POINTS, SEED)
    times += all_with_all(report, pair)
    sizes_table(report, times)
    report.add(f"{SLICED} / d of all", sliced(*box.clouds()) / box.d_mm, "times", tolerance=1.1)
    transport(report, box, times, moved)
    entropic(report, box)
    memory(report, box)
    figure = metric_pictures.times(times, moved, _growths(moved), len(box.clouds()[0]))
    figure.savefig(out / "distance_times.png", dpi=110)


def one_pair(report: Report, box: Pair) -> None:
    a, b = box.images
    on_device = [jnp.asarray(x) for x in (a, b)]
    took = in_turns({
        "ours": lambda: jshape.distance(a, b),
        "jax": lambda: jshape.distance(*on_device),
        "opencv": lambda: cv2.norm(a, b, cv2.NORM_L1),
        "numpy": lambda: np.abs(a - b).mean(),
    })  # fmt: skip
    report.add("distance, one pair of NumPy images", 1e6 * took["ours"], "µs")
    report.add("distance, one pair of JAX images", 1e6 * took["jax"], "µs")
    report.add("cv2.norm(NORM_L1), one pair", 1e6 * took["opencv"], "µs")
    report.add("distance / cv2.norm, NumPy images", took["ours"] / took["opencv"], "times", goal=4)
    report.add("distance / cv2.norm, JAX images", took["jax"] / took["opencv"], "times", goal=4)
    report.add("np.abs(a - b).mean()", 1e6 * took["numpy"], "µs")


def batches(report: Report, box: Pair) -> None:
    """Reading speed against copying the same bytes: a batch is read twice, copying reads, writes.

    Images of 8 bits are compared as levels, without R.
    """
    first, second = (np.repeat(x[None], PAIRS[-1], 0) for x in box.images)
    levels = [np.rint(np.repeat(x[None], PAIRS[-1], 0)).astype(np.uint8) for x in box.luminances]
    copied, lines = np.empty_like(first), []
    for count in PAIRS:
        a, b, la, lb = (x[:count] for x in (first, second, *levels))
        target = copied[:count]
        took = in_turns({
            "d": partial(jshape.distance, a, b),
            "copy": partial(np.copyto, target, a),
            "levels": partial(jshape.distance, la, lb),
        }, rounds=3)  # fmt: skip
        speed = {name: 2 * a.nbytes / took[name] / 1e9 for name in ("d", "copy")}
        lines.append(
            (count, *(f"{1e6 * took[n] / count:.3g}" for n in ("d", "levels")),
             f"{speed['d']:.3g}", f"{speed['copy']:.3g}", f"{speed['d'] / speed['copy']:.2f}")
        )  # fmt: skip
        if count == 256:
            report.add("copy bandwidth (read + write)", speed["copy"], "GB/s")
            report.add("distance, 256 pairs in one call, reading", speed["d"], "GB/s")
            share = speed["d"] / speed["copy"]
            report.add("the same against the copy bandwidth", share, "times", goal=0.5, more=True)
    head = ("pairs", "float32: µs per pair", "8-bit levels, without R: µs per pair",
            "float32: GB/s", "copying: GB/s", "share")  # fmt: skip
    report.table("Many pairs of 480x395 in one call", head, lines)


def eight_bits(report: Report, box: Pair) -> None:
    """What luminances rounded to the paper's 256 levels cost, and how far d is off."""
    camera = box.camera
    whole = [np.rint(level).astype(np.uint8) for level in box.luminances]

    def rounded() -> Any:
        return metric.distance(*(metric.weigh(level, camera) for level in whole))

    took = in_turns({
        "ready": lambda: metric.distance(*box.images),
        "rounded": rounded,
        "levels": lambda: metric.distance(*whole),
    })  # fmt: skip
    report.add("d of two I that are there", 1e6 * took["ready"], "µs")
    report.add("d of two 8-bit luminances, weighing them too", 1e6 * took["rounded"], "µs")
    report.add("mean difference of two 8-bit luminances, without R", 1e6 * took["levels"], "µs")
    off = abs(float(metric.to_mm(rounded(), camera)) - box.d_mm)
    report.add("d of 8-bit luminances is off by", 1e3 * off, "µm", tolerance=2)
    level = 1e6 * float(camera.z_max - camera.z_min) / camera.top
    report.add("one level of the depth", level, "µm", tolerance=1.001)


def at_size(pair: Pair, size: str) -> list[dict[str, Any]]:
    """A row per method that uses all points at one size."""
    rows = timed(pair, size)
    p, q = pair.clouds()
    a, b = pair.images
    calls: dict[str, Callable[[], Any]] = {
        "cv2.norm(NORM_L1)": lambda: cv2.norm(a, b, cv2.NORM_L1),
        "np.abs(a - b).mean()": lambda: np.abs(a - b).mean(),
    }
    if size in CAMERAS:
        calls[SLICED] = partial(sliced, p, q)
    own = rows[0]["seconds"]
    for name, call in calls.items():
        took = seconds_or_once(call)
        rows.append({"size": size, "method": name, "points": len(p), "seconds": took,
                     "times_d": took / own, "value_mm": None})  # fmt: skip
    return rows


def sliced(p: np.ndarray, q: np.ndarray) -> float:
    """Sliced transport of two clouds, mm."""
    return float(ot.sliced_wasserstein_distance(p, q, n_projections=PROJECTIONS, p=1, seed=SEED))


def all_with_all(report: Report, pair: Mapping[str, Pair]) -> list[dict[str, Any]]:
    """All points with all, in blocks, at sizes where it ends in seconds."""
    coarse = seen(*beds(SEED), COARSE)
    rows = []
    for method, size, small in (
        ("Chamfer (JAX, all with all)", "120x99", pair["120x99"]),
        ("Chamfer (JAX, all with all)", "240x198", pair["240x198"]),
        ("entropic transport, one round", COARSE_SIZE, coarse),
        ("entropic transport, one round", "120x99", pair["120x99"]),
    ):
        p, q = small.clouds()
        own = seconds(partial(metric.distance, *small.images), least=0.05)
        if exact := method.startswith("Chamfer"):
            call = partial(metric_peers.chamfer, p, q)
        else:
            call = partial(metric_peers.sinkhorn, p, q, BLURS[-1], 1)
        value = float(jax.tree.leaves(call())[0])  # compiles
        took = seconds_or_once(partial(_done, call))
        rows.append({"size": size, "method": method, "points": len(p), "seconds": took,
                     "times_d": took / own, "value_mm": value})  # fmt: skip
        if exact:
            off = abs(value / clouds.chamfer(p, q) - 1)
            report.add(f"Chamfer at {size}, JAX against scipy, share of it", off, "", goal=1e-4)
    return rows


def sizes_table(report: Report, times: list[dict[str, Any]]) -> None:
    """Time of every method at every size, and as a multiple of d's in the same table if it is."""
    of = {(row["method"], row["size"]): row for row in times}
    methods = list(dict.fromkeys(row["method"] for row in times))

    def cell(method: str, size: str) -> str:
        if (row := of.get((method, size))) is None:
            return "-"
        d = of.get(("d", size))
        times = row["times_d"] if d is None else row["seconds"] / d["seconds"]
        return f"{duration(row['seconds'])} ({ratio(times)})"

    sizes = (COARSE_SIZE, *SIZES)
    lines = [(m, *(cell(m, size) for size in sizes)) for m in methods]
    name = "Time of one comparison of all points, and (as a multiple of d's)"
    report.table(name, ("method", *sizes), lines)


def transport(
    report: Report, box: Pair, times: list[dict[str, Any]], moved: list[dict[str, Any]]
) -> None:
    """The two goals, measured in turns, and exact transport of ever more points."""
    p, q = box.clouds()
    trees = {n: row for row in times if (n := row["method"]).startswith("Chamfer (")
             and row["size"] == "480x395" and "JAX" not in n}  # fmt: skip
    tree = min(trees, key=lambda name: trees[name]["seconds"])[len("Chamfer (") : -1]
    same = clouds.spread(box.camera.shape, POINTS[-1])
    few_p, few_q = p[same], q[same]
    quickest = min((r for r in moved if r["points"] == len(same)), key=lambda r: r["seconds"])
    mover = quickest["method"][5:-1]
    took = in_turns({
        "d": lambda: metric.distance(*box.images),
        "chamfer": lambda: clouds.chamfer(p, q, tree),
        "emd": lambda: clouds.emd(few_p, few_q, mover),
    }, rounds=3)  # fmt: skip
    report.add(f"fastest exact Chamfer ({tree}), all {len(p):,} points / d",
               took["chamfer"] / took["d"], "times", goal=500, more=True)  # fmt: skip
    name = f"EMD ({mover}), only {len(same):,} of {len(p):,} points / d of all"
    report.add(name, took["emd"] / took["d"], "times", goal=2000, more=True)

    most = clouds.spread(box.camera.shape, MOST)
    large = seconds_or_once(lambda: clouds.emd(p[most], q[most], mover))
    report.add(f"the same of {len(most):,} points", large / took["d"], "times")
    report.add("cost matrix of all points, float32", 4 * len(p) ** 2 / 1e9, "GB", tolerance=1.001)
    growths = _growths(moved)
    lines = [
        (row["method"], row["choice"], f"{row['points']:,}", duration(row["seconds"]),
         ratio(row["seconds"] / took["d"]), f"{row['value_mm']:.3f}",
         "-" if row["d_same_pixels_mm"] is None else f"{row['d_same_pixels_mm']:.3f}",
         f"{row['d_mm']:.3f}")
        for row in moved
    ]  # fmt: skip
    lines += [
        (method, choice, f"{len(p):,} (extrapolated, N^{fit.exponent:.2f})",
         duration(fit.at(len(p))), ratio(fit.at(len(p)) / took["d"]), "-", "-", "-")
        for (method, choice), fit in growths.items()
    ]  # fmt: skip
    head = ("method", "points are", "N", "time", "time / d of all", "EMD (mm)",
            "d over them (mm)", "d of all (mm)")  # fmt: skip
    report.table("Exact earth mover's distance of N of the points at 480x395", head, lines)
    matched = [r["value_mm"] / r["d_same_pixels_mm"] for r in moved if r["d_same_pixels_mm"]]
    report.add("EMD of the same pixels / d over them, worst", max(matched), "times",
               tolerance=1.001)  # fmt: skip
    drawn = [r["value_mm"] / r["d_mm"] for r in moved if r["points"] == len(same)
             and r["choice"] == "random"]  # fmt: skip
    report.add(f"EMD of {len(same):,} random points / d of all", drawn[0], "times", tolerance=1.1)


def entropic(report: Report, box: Pair) -> None:
    """Entropic transport beside exact, as the entropy's weight falls."""
    p, q = box.clouds()
    rng = np.random.default_rng(SEED)
    own = seconds(lambda: metric.distance(*box.images))
    same = clouds.spread(box.camera.shape, POINTS[0])
    choices = {
        "same pixels": (p[same], q[same]),
        "random": tuple(clouds.drawn(rng, cloud, len(same)) for cloud in (p, q)),
    }
    lines = []
    for choice, (few_p, few_q) in choices.items():
        exact = clouds.emd(few_p, few_q, "pot")
        metric_peers.sinkhorn(few_p, few_q, BLURS[0], ROUNDS)[0].block_until_ready()  # compiles
        for blur in BLURS:
            start = time.perf_counter()
            found = metric_peers.sinkhorn(few_p, few_q, blur, ROUNDS)
            way, astray = (float(x) for x in found)
            took = time.perf_counter() - start
            lines.append((choice, f"{blur:g}", f"{way:.3f}", f"{exact:.3f}",
                          f"{100 * astray:.2g} %", ratio(took / own)))  # fmt: skip
            if (choice, blur) == ("same pixels", BLURS[-1]):
                report.add("entropic / exact EMD, same pixels, least blur", way / exact, "times",
                           tolerance=1.01)  # fmt: skip
    head = ("points are", "blur (mm)", "its way (mm)", "exact EMD (mm)", "mass astray",
            "time / d of all")  # fmt: skip
    name = f"Entropic transport (JAX, log domain, {ROUNDS} rounds) of {len(same):,} points"
    report.table(name, head, lines)


def memory(report: Report, box: Pair) -> None:
    """What images and clouds take, and what a call takes beside them."""
    p, q = box.clouds()
    image = box.images[0]
    report.add("image, 8 bits", image.size / 1e6, "MB", tolerance=1)
    report.add("image I, float32", image.nbytes / 1e6, "MB", tolerance=1)
    report.add("point cloud, float32", p.nbytes / 1e6, "MB", tolerance=1)
    if not metric_memory.available():
        return
    same = clouds.spread(box.camera.shape, POINTS[2])
    lines = []
    for method in metric_memory.CALLS:
        inputs = {"d": box.images, "EMD (pot)": (p[same], q[same])}.get(method, (p, q))
        peak = metric_memory.peak_bytes(method, *inputs) / 1e6
        points = image.size if method == "d" else len(inputs[0])
        lines.append((method, f"{points:,}", f"{sum(x.nbytes for x in inputs) / 1e6:.3g}",
                      f"{peak:.3g}"))  # fmt: skip
        report.add(f"peak memory of {method}, {points:,} points", peak, "MB", tolerance=1.5)
    head = ("method", "points", "both inputs (MB)", "peak of a call beside them (MB)")
    report.table("Memory", head, lines)


def _growths(moved: list[dict[str, Any]]) -> dict[tuple[str, str], Growth]:
    """Of each solver and choice of points."""
    lines: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in moved:
        lines.setdefault((row["method"], row["choice"]), []).append(row)
    return {
        name: growth([r["points"] for r in mine], [r["seconds"] for r in mine])
        for name, mine in lines.items()
    }


def _done(call: Callable[[], Any]) -> None:
    jax.block_until_ready(call())
