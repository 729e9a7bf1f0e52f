"""Closed loops seen from an angle: what is left of the distance, against the same from above.

    python -m benchmarks.tilted --problems 4 --out bench/tilted.json

Goals that no action made (the shapes of the planning benchmark), in the simulator, with its noisy
camera.  All looks become one map of the box, so that only the looks differ.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from benchmarks.experiments.problems import Problem, shape_problems
from jshape import metric, sim
from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.looks import Look, camera_over, seen_from
from jshape.data.simulate import look as simulated_look
from jshape.data.view import image_of_depth, look_of
from jshape.height_map import as_frame
from jshape.io.banks import load_bank
from jshape.planning.maps import bank_for
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.loop import mold
from jshape.robot.simulated import SimulatedWorld

VIEWS = {
    "from above": (0,),
    "30 degrees": (30,),
    "45 degrees": (45,),
    "two at 30 degrees": (-30, 30),
}
"""Tilts of the cameras of each view, degrees about u."""
AWAY = 0.5
"""Metres from each camera to the bed's middle."""


def posed(tilt: float) -> Camera:
    """A D435 that looks at the middle of the bed from an angle, in the simulated bed's frame."""
    a = np.radians(tilt)
    pose = np.eye(4)
    pose[1:3, 1:3] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    pose[:3, 3] = np.array([0, 0, sim.SURFACE]) - AWAY * pose[:3, 2]
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

    def act(self, action: str, position, strength: float = 1.0, yaw: float = 0.0) -> None:
        """Apply an action at pixel (u, v) of the map."""
        x, y = self.camera.at(*(float(at) for at in position), 0.0)
        x, y, *_ = np.array(self.camera.pose) @ [float(x), float(y), 0.0, 1.0]
        place = PAPER_BOX.pixel(x, y, sim.SURFACE)
        self.world.act(action, tuple(float(at) for at in place), strength, yaw)


def attempt(problem: Problem, tilts: Sequence[float], seed: int = 0) -> dict[str, float]:
    """What is left of a problem's true distance, %, and how many actions were done."""
    bank = load_bank(DEFAULT_BANK)
    straight = np.diag([1.0, -1.0, -1.0, 1.0])
    straight[2, 3] = sim.SURFACE
    goal = np.asarray(PAPER_BOX.depth(metric.unweigh(problem.goal, PAPER_BOX)))
    wanted = look_of(goal, PAPER_BOX)
    target, _ = camera_over([wanted], frame=straight)
    world = Seen(
        SimulatedWorld(jax.random.key(seed), problem.bed), [posed(t) for t in tilts], target, seed
    )
    image = image_of_depth(seen_from([wanted], target), target).image
    done = mold(world, image, bank_for(bank, target))
    left = problem.distance_mm(world.world.bed) / problem.start_mm
    seen = float(np.isfinite(done.depths[0]).mean())
    return {"left": 100 * left, "steps": len(done.steps), "seen": seen}


def main(words: Sequence[str] | None = None) -> int:
    """The table of all views."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=4)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args(words)
    rows = []
    for number, problem in enumerate(shape_problems(0, asked.problems)):
        for name, tilts in VIEWS.items():
            row = {"problem": problem.name, "view": name, **attempt(problem, tilts, number)}
            rows.append(row)
            said = f"{row['left']:5.1f} % left after {row['steps']} actions, {row['seen']:.1%} seen"
            print(f"{row['problem']:12} {name:18} {said}", flush=True)
    for name in VIEWS:
        print(f"{name:18} {np.mean([r['left'] for r in rows if r['view'] == name]):.1f} % left")
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
