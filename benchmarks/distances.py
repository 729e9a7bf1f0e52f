"""The paper's distance beside OpenCV, NumPy, Chamfer and the earth mover's distance."""

from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import ot
from pykdtree.kdtree import KDTree

import jshape
from benchmarks.report import Report
from benchmarks.timing import seconds


def run(report: Report, out: Path) -> None:
    camera = jshape.PAPER_BOX
    rng = np.random.default_rng(0)
    la, lb = (
        cv2.GaussianBlur(rng.uniform(0, 255, camera.shape).astype(np.float32), (0, 0), 8)
        for _ in range(2)
    )
    a, b = (np.asarray(jshape.weigh(x, camera)) for x in (la, lb))

    ours = seconds(lambda: jshape.distance(a, b))
    on_device = [jnp.asarray(x) for x in (a, b)]
    ours_jax = seconds(lambda: jshape.distance(*on_device))
    opencv = seconds(lambda: cv2.norm(a, b, cv2.NORM_L1))
    report.add("distance, one pair of NumPy images", 1e6 * ours, "µs")
    report.add("distance, one pair of JAX images", 1e6 * ours_jax, "µs")
    report.add("cv2.norm(NORM_L1), one pair", 1e6 * opencv, "µs")
    report.add("distance / cv2.norm, NumPy images", ours / opencv, "times", goal=4)
    report.add("distance / cv2.norm, JAX images", ours_jax / opencv, "times", goal=4)
    report.add("np.abs(a - b).mean()", 1e6 * seconds(lambda: np.abs(a - b).mean()), "µs")

    many_a, many_b = (jnp.asarray(np.repeat(x[None], 256, 0)) for x in (a, b))
    source = np.asarray(many_a)
    copied = np.empty_like(source)
    copy = 2 * source.nbytes / seconds(lambda: np.copyto(copied, source), least=1.0) / 1e9
    batch = 2 * source.nbytes / seconds(lambda: jshape.distance(many_a, many_b), least=1.0) / 1e9
    report.add("copy bandwidth (read + write)", copy, "GB/s")
    report.add("distance, 256 pairs in one call, reading", batch, "GB/s")
    report.add("the same against the copy bandwidth", batch / copy, "times", goal=0.5, more=True)

    cloud_a, cloud_b = (np.asarray(camera.points(x)).reshape(-1, 3) for x in (la, lb))

    def chamfer() -> float:
        there, _ = KDTree(cloud_b).query(cloud_a)
        back, _ = KDTree(cloud_a).query(cloud_b)
        return float(there.mean() + back.mean()) / 2

    report.add("Chamfer (pykdtree) / distance, all points", seconds(chamfer) / ours, "times")
    few_a, few_b = (
        np.asarray(camera.points(x)).reshape(*camera.shape, 3)[::10, ::10].reshape(-1, 3)
        for x in (la, lb)
    )
    weight = np.full(len(few_a), 1 / len(few_a))

    def emd() -> float:
        return float(ot.emd2(weight, weight, ot.dist(few_a, few_b, "euclidean")))

    name = f"exact EMD (POT) of {len(few_a)} points / distance of all"
    report.add(name, seconds(emd, least=0.1, repeats=1) / ours, "times")
