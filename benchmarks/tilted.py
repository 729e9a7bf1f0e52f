"""Closed loops seen from an angle: what is left of the distance, against the same from above.

    python -m benchmarks.tilted --kinds shape sequence relief --problems 12 --out bench/tilted

`shape`: goals that no action made (those of the planning benchmark, measured sand and dough too,
where they are there); `sequence`: from the first frame to the last of the sequences of the
material-point method; `relief`: beds with more relief than the paper's, with a picture each.  All
in the simulator, with its noisy camera.  All looks become one map of the box, so that only the
looks differ.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from benchmarks.experiments.problems import Problem, shape_problems
from benchmarks.experiments.recorded import mpm_problems
from benchmarks.relief import BEDS, picture, relief_problems
from benchmarks.report import markdown
from benchmarks.sim_against_mpm import default_data
from jshape import metric, sim
from jshape.camera import D435_BAZAR, Camera
from jshape.data.fusion import Look, seen_from
from jshape.data.looks import camera_over
from jshape.data.simulate import bed_of_depth
from jshape.data.simulate import look as simulated_look
from jshape.data.view import image_of_depth, look_of
from jshape.height_map import as_frame
from jshape.io.banks import load_bank
from jshape.planning.maps import bank_for
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.loop import Molding, mold
from jshape.robot.simulated import SimulatedWorld
from jshape.viz.style import png

VIEWS = {
    "from above": (0,),
    "30 degrees": (30,),
    "45 degrees": (45,),
    "two at 30 degrees": (-30, 30),
}
"""Tilts of the cameras of each view, degrees about u."""
AWAY = 0.5
"""Metres from each camera to the bed's middle."""
KINDS = ("shape", "sequence", "relief")


def posed(tilt: float, away: float = AWAY) -> Camera:
    """A D435 that looks at the middle of the bed from an angle, in the simulated bed's frame."""
    a = np.radians(tilt)
    pose = np.eye(4)
    pose[1:3, 1:3] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    pose[:3, 3] = np.array([0, 0, sim.SURFACE]) - away * pose[:3, 2]
    wide = replace(D435_BAZAR, u0=423.5, v0=239.5, z_min=0.2, z_max=1.5)
    return replace(wide, pose=as_frame(pose))


class Seen:
    """A simulated world that cameras from anywhere look at; a `World` of the loop."""

    def __init__(self, world: SimulatedWorld, cameras: Sequence[Camera], target: Camera, seed: int):
        self.world, self.cameras, self.camera = world, cameras, target
        self._key = jax.random.key(seed)

    def look(self) -> np.ndarray:
        """The map's depths (H, W), metres, NaN where no camera sees."""
        looks: list[Look] = []
        for camera in self.cameras:
            self._key, key = jax.random.split(self._key)
            depth = simulated_look(key, self.world.bed, camera, frames=5)
            looks.append(look_of(depth, camera))
        return seen_from(looks, self.camera)

    def act(
        self, action: str, position, strength: float = 1.0, yaw: float = 0.0, length: float = 1.0
    ) -> None:
        """Apply an action at pixel (u, v) of the map."""
        x, y = self.camera.at(float(position[0]), float(position[1]), 0.0)
        x, y, *_ = np.array(self.camera.pose) @ [float(x), float(y), 0.0, 1.0]
        u, v = self.world.camera.pixel(x, y, sim.SURFACE)
        self.world.act(action, (float(u), float(v)), strength, yaw, length)


def attempt(problem: Problem, tilts: Sequence[float], seed: int) -> tuple[Molding, float]:
    """A closed loop, and what it left of the problem's distance, both without noise, %."""
    straight = np.diag([1.0, -1.0, -1.0, 1.0])
    straight[2, 3] = sim.SURFACE
    goal = np.asarray(problem.camera.depth(metric.unweigh(problem.goal, problem.camera)))
    wanted = look_of(goal, problem.camera)
    target, _ = camera_over([wanted], frame=straight)
    key, camera = jax.random.key(seed), problem.camera
    world = SimulatedWorld(key, problem.bed, material=problem.material, camera=camera)
    image = image_of_depth(seen_from([wanted], target), target).image
    bank = bank_for(load_bank(DEFAULT_BANK), target)
    run = mold(Seen(world, [posed(tilt) for tilt in tilts], target, seed), image, bank)
    return run, 100 * problem.distance_mm(world.bed) / problem.distance_mm(problem.bed)


def problems_of(kind: str, count: int, data: Path) -> list[Problem]:
    """The problems of a kind, each with a bed to act in and a goal without noise."""
    if kind == "shape":
        return shape_problems(0, count, data / "real")
    if kind == "relief":
        return relief_problems()
    found = []
    for one in mpm_problems(data / "mpm"):
        depth = np.asarray(one.camera.depth(metric.unweigh(one.start, one.camera)))
        found.append(replace(one, bed=bed_of_depth(depth, one.camera), truth=one.goal))
    return found


def rows_of(kind: str, problems: list[Problem], views: Sequence[str], out: Path) -> Iterator[dict]:
    """What each problem left in each view; a picture of each bed with relief."""
    for number, problem in enumerate(problems):
        runs = {}
        for view in BEDS[problem.name][2] if kind == "relief" else views:
            runs[view] = run, left = attempt(problem, VIEWS[view], number)
            row = {"kind": kind, "problem": problem.name, "view": view, "left": left}
            yield row | {
                "actions": len(run.steps),
                "seen": 100 * float(np.isfinite(run.depths[0]).mean()),
            }
        if kind == "relief":
            name = problem.name.split(",")[0]
            (out / f"tilted_{name}.png").write_bytes(png(picture(problem.name, runs)))


def table(rows: list[dict]) -> str:
    """What was left (%), by how many actions and how much of the bed was seen, as Markdown.

    A line for each problem and a column for each view, the means of each kind below.
    """
    views = list(dict.fromkeys(row["view"] for row in rows))
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        those = [row for row in rows if row["kind"] == kind]
        for problem in dict.fromkeys(row["problem"] for row in those):
            at = {row["view"]: row for row in those if row["problem"] == problem}
            cells = [_cell(**at[view]) if view in at else "" for view in views]
            lines.append((problem, *cells))
        left = {v: [row["left"] for row in those if row["view"] == v] for v in views}
        means = [f"{np.mean(left[v]):.1f} (of {len(left[v])})" if left[v] else "" for v in views]
        lines.append((f"mean ({kind})", *means))
    return markdown(("left, %", *views), lines)


def _cell(left: float, actions: int, seen: float, **_: str) -> str:
    return f"{left:.1f} ({actions} actions, {seen:.1f}% seen)"


def main(words: Sequence[str] | None = None) -> int:
    """The table of all views."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--problems", type=int, default=12, help="shapes")
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=list(VIEWS)[:2],
                        help="of shapes and sequences")  # fmt: skip
    parser.add_argument("--data", type=Path, default=default_data().parent,
                        help="folder with real/ and mpm/")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("bench/tilted"), help="folder")
    asked = parser.parse_args(words)
    asked.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict] = []
    for kind in asked.kinds:
        problems = problems_of(kind, asked.problems, asked.data)
        for row in rows_of(kind, problems, asked.views, asked.out):
            rows.append(row)
            print(json.dumps(row), flush=True)
            (asked.out / "tilted.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
