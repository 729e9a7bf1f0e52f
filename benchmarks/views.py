"""Height maps of beds seen from anywhere: how far off, how much is seen, how long a look takes."""

import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import jax
import numpy as np

import jshape
from benchmarks.report import Report
from benchmarks.timing import in_turns
from jshape import Camera, HeightMap, sim
from jshape.data.depth import to_metres
from jshape.data.missing import fill_missing
from jshape.height_map import as_frame
from jshape.reproject import reproject

TILTS = (0, 15, 30, 45)
DISTANCES = (0.35, 0.6, 1.2)
SIZES = ((320, 240), (848, 480), (1280, 720))
FOCAL = 433 / 848
"""Focal length of the D435 per width of its image."""
HILLS = 0.008
"""Standard deviation of the bed's heights, metres."""
NODES = (480, 395)
PITCH = 0.00104
"""Metres between nodes: the pixels of `PAPER_BOX` at 0.45 m."""
SEQUENCE = "dev2_sand_irregular"
ERROR = 0.5
"""Median error of a map with the camera's noise that is aimed at, mm."""
FRAMES = (1, 2, 4, 8, 16, 32)
"""Frames of a resting bed that are averaged to reach it."""


@dataclass(frozen=True)
class View:
    """One row of a table."""

    tilt: int
    distance: float
    camera: Camera

    @property
    def words(self) -> tuple[str, str, str]:
        """Its first cells of the table."""
        return f"{self.tilt}", f"{self.distance:g}", f"{self.camera.width}x{self.camera.height}"


def views() -> Iterator[View]:
    """Every camera, all aimed at the middle of the bed's plane."""
    for tilt in TILTS:
        for distance in DISTANCES:
            for width, height in SIZES:
                focal, middle = FOCAL * width, ((width - 1) / 2, (height - 1) / 2)
                camera = Camera(width, height, focal, focal, *middle, 0.1, 4.0, bits=16)
                yield View(tilt, distance, replace(camera, pose=aimed(tilt, distance)))


def aimed(tilt: float, distance: float) -> tuple[tuple[float, ...], ...]:
    """The pose, in the bed's frame, of a camera tilted about its u axis, so many degrees."""
    angle = np.radians(tilt)
    pose = np.eye(4)
    pose[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = (0.0, 0.0, sim.SURFACE) - distance * pose[:3, 2]
    return as_frame(pose)


def truth_of(bed: sim.Bed) -> HeightMap:
    """The bed as its map should be, above the level `sim.SURFACE` below the origin."""
    frame = np.diag([1.0, -1.0, -1.0, 1.0])
    frame[2, 3] = sim.SURFACE
    x, y = (PITCH * (np.arange(n) - (n - 1) / 2) for n in NODES)
    straight = Camera(*NODES, 1 / PITCH, 1 / PITCH, -x[0] / PITCH, -y[0] / PITCH, 0.1, 4.0,
                      orthographic=True)  # fmt: skip
    heights = sim.SURFACE - np.asarray(sim.render(bed, straight))[::-1]
    return HeightMap(heights, PITCH, (float(x[0]), float(y[0])), None, as_frame(frame))


def simulated_bed() -> sim.Bed:
    """A bed with hills, and one knock of a hand."""
    bed = sim.irregular_bed(jax.random.key(0), HILLS)
    return sim.apply_action(jax.random.key(1), bed, sim.FLOUR, "knock", (0.03, -0.02))


def material_point_bed() -> sim.Bed | None:
    """The surface of a bed of the material-point simulation, if it is there."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("JSHAPE_SHARED", beside)) / "data" / "mpm" / "seqs" / SEQUENCE
    if not folder.is_dir():
        return None
    last = sorted(folder.glob("*.png"), key=lambda path: int(path.stem))[-1]
    unit = json.loads((folder / "camera.json").read_text())["depth_unit"]
    counts = cv2.imread(str(last), cv2.IMREAD_UNCHANGED)
    depth, camera = to_metres(counts, unit, str(last)), jshape.PAPER_BOX
    cell, (columns, rows) = 0.001, (480, 390)
    straight = Camera(columns, rows, 1 / cell, 1 / cell, (columns - 1) / 2, (rows - 1) / 2,
                      0.1, 4.0, orthographic=True)  # fmt: skip
    whole, _ = fill_missing(depth, limit=1.0, where=str(last))
    span = np.array([whole.min() - 0.005, whole.max() + 0.005], np.float32)
    seen = np.array(reproject(whole, camera, straight, span))
    whole, _ = fill_missing(seen, limit=1.0, where=str(last))
    return sim.loose_bed(sim.Z_FLOOR - whole, cell)


def off(found: HeightMap, truth: HeightMap) -> tuple[float, float, float]:
    """Median and 99th percentile of the error, mm, and the share of the nodes that is known."""
    error = 1e3 * np.abs(np.asarray(found.heights) - np.asarray(truth.heights))[found.mask]
    return float(np.median(error)), float(np.percentile(error, 99)), float(found.mask.mean())


def frames_needed(bed: sim.Bed, view: View, truth: HeightMap) -> tuple[int, float]:
    """The least of `FRAMES` whose mean is within `ERROR`, and its median error, mm."""
    clean, count, median = sim.render(bed, view.camera), 0, np.inf
    for count in FRAMES:
        keys = jax.random.split(jax.random.key(3), count)
        noisy = np.stack([np.asarray(sim.sensor(key, clean)) for key in keys])
        median, *_ = off(jshape.heightmap(noisy, view.camera, like=truth), truth)
        if median <= ERROR:
            break
    return count, median


def run(report: Report, out: Path) -> None:
    """A table for each bed; the times are of the simulated one."""
    head = ("tilt", "metres", "pixels", "error: median", "99 %", "seen", "with noise: median",
            "99 %", "seen")  # fmt: skip
    beds = {"the simulator's bed": simulated_bed(), "a material-point bed": material_point_bed()}
    measured, timed = {}, "the simulator's bed"
    for name, bed in beds.items():
        if bed is None:
            print(f"{name}: not here (set JSHAPE_SHARED to the folder that holds data/)")
            continue
        truth, rows = truth_of(bed), []
        for view in views():
            clean = np.asarray(sim.render(bed, view.camera))
            noisy = np.asarray(sim.sensor(jax.random.key(2), clean))
            errors = [
                off(jshape.heightmap(depth, view.camera, like=truth), truth)
                for depth in (clean, noisy)
            ]
            cells = [(f"{m:.3f}", f"{p:.2f}", f"{s:.1%}") for m, p, s in errors]
            times = _times(noisy, view, truth) if name == timed else ()
            rows.append((*view.words, *cells[0], *cells[1], *(f"{1e3 * t:.1f}" for t in times)))
            measured[name, view.words] = *errors, *times
        extra = ("look, ms of CPU", "reproject, ms of CPU") if name == timed else ()
        report.table(f"Errors (mm) of height maps of {name}", head + extra, rows)
    _sum_up(report, {words: row for (name, words), row in measured.items() if name == timed})
    bed = simulated_bed()
    for view in views():
        if view.tilt == 30 and view.camera.width == 848:
            count, median = frames_needed(bed, view, truth_of(bed))
            report.add(f"30 degrees, {view.distance:g} m, mean of {count} frames: median", median,
                       "mm", goal=ERROR)  # fmt: skip


def _times(noisy: np.ndarray, view: View, truth: HeightMap) -> tuple[float, float]:
    """CPU seconds of a whole look, 16-bit counts to map, and of `reproject` in it."""
    counts = np.asarray(sim.to_uint16(noisy))
    target = truth.camera()
    depth = np.where(noisy > 0, noisy, np.float32(np.nan))
    span = np.array([target.z_min, target.z_max], np.float32)
    calls = {
        "look": lambda: jshape.heightmap(counts, view.camera, depth_unit=1e-4, like=truth).heights,
        "reproject": lambda: reproject(depth, view.camera, target, span),
    }
    times = in_turns(calls, least=0.5, rounds=7, clock=time.process_time)
    return times["look"], times["reproject"]


def _sum_up(report: Report, rows: dict) -> None:
    """The rows that have goals, of 30 degrees."""
    tilted = {words: row for words, row in rows.items() if words[0] == "30"}
    report.add("30 degrees, noise-free, the worst median", max(r[0][0] for r in tilted.values()),
               "mm", goal=0.15, tolerance=1.2)  # fmt: skip
    near = [row[1][0] for words, row in tilted.items() if words[1] == f"{DISTANCES[0]:g}"]
    report.add(f"30 degrees, {DISTANCES[0]} m, with noise, the worst median", max(near), "mm",
               goal=ERROR, tolerance=1.2)  # fmt: skip
    usual = [row[2] for words, row in rows.items() if words[2] == "848x480"]
    report.add("a look of 848x480, the slowest, CPU", 1e3 * max(usual), "ms", goal=20)
