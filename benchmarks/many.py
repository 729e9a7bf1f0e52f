"""A hundred actions: a relief of six letters and measured sand, looking again after batches.

    python -m benchmarks.many [--steps 100] [--batches 1 4 8] [--planner NAME] [--yaws 8] ...

What is left is of the beds themselves, without the camera's noise.  Seconds are of planning: the
loop's time without the world's, compiling included.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np
from scipy import ndimage

import jshape
from benchmarks.console import positive, positive_count
from benchmarks.experiments import shapes
from benchmarks.experiments.problems import Problem, shape_problem, shape_problems
from benchmarks.relief import picture
from jshape.camera import PAPER_BOX
from jshape.cli.tables import print_table, say
from jshape.goals.reliefs import relief_of_text
from jshape.models.bank import Bank
from jshape.planning.limit import Limit
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.search import PLANNERS
from jshape.robot.loop import Molding, mold
from jshape.robot.simulated import SimulatedWorld
from jshape.viz.style import png

ROWS = "JSH", "APE"
DEPTH = 0.010
"""Of the letters, metres; they are 34 mm wide in a row of 370 mm."""
HEAD = ("goal", "a look", "actions", "looks", "left", "limit", "efficiency", "planning (s)", "stop")


def letters() -> shapes.Shape:
    """Two rows of letters, dug with slopes of at most `shapes.STEEPEST`."""
    camera = PAPER_BOX
    drawn = [np.nan_to_num(relief_of_text(row, 1.0).heights) for row in ROWS]
    pixel = shapes.pixel(camera)
    high, most = (np.array(camera.shape) - 2 * shapes.MARGIN / pixel[::-1]).astype(int)
    high = min(int(0.45 * high), *(int(most * row.shape[0] / row.shape[1]) for row in drawn))
    whole = np.zeros(camera.shape)
    for number, row in enumerate(drawn):
        wide = int(high * row.shape[1] / row.shape[0])
        top, left = camera.height // 2 + (number - 1) * int(1.1 * high), (camera.width - wide) // 2
        whole[top : top + high, left : left + wide] = cv2.resize(row, (wide, high))
    width = DEPTH / (shapes.STEEPEST * np.sqrt(2 * np.pi))  # of a step's Gaussian, metres
    dug = ndimage.gaussian_filter(DEPTH * whole, width / pixel[::-1])
    return shapes.Shape("".join(ROWS), dug.astype(np.float32))


class Timed:
    """A world that knows how long it took."""

    def __init__(self, world: SimulatedWorld):
        self._world, self.camera = world, world.camera
        self.looks, self.seconds = 0, 0.0

    def look(self) -> np.ndarray:
        """As the world's."""
        self.looks += 1
        return self._called(self._world.look)

    def act(self, *action: Any, **how: float) -> None:
        """As the world's."""
        self._called(lambda: self._world.act(*action, **how))

    def _called(self, call: Any) -> Any:
        began = time.monotonic()
        found = call()
        self.seconds += time.monotonic() - began
        return found


def attempt(
    problem: Problem, bank: Bank, limit: Limit, batch: int, planner: str, free: dict
) -> tuple[tuple[str, ...], Molding, float]:
    """A row of the table, what was done, and what it left, %."""
    key = jax.random.key(0)
    world = SimulatedWorld(key, problem.bed, material=problem.material, camera=problem.camera)
    timed, began = Timed(world), time.monotonic()
    options = jshape.options(max_steps=limit.max_steps, planner=planner, **free)
    run = mold(
        timed,
        problem.goal,
        bank,
        batch=batch,
        **options,
        on_step=lambda step, _: say(f"{batch} {step.line(0)}"),
    )
    took = time.monotonic() - began - timed.seconds
    left = problem.distance_mm(world.bed) / problem.distance_mm(problem.bed)
    of_limit = f"{limit.left:.1%}", f"{limit.efficiency(left):.0%}"
    row = (problem.name, f"{batch}", f"{len(run.steps)}", f"{timed.looks - 1}", f"{left:.1%}")
    return (*row, *of_limit, f"{took:.0f}", run.stop.name), run, 100 * left


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bank", default=DEFAULT_BANK)
    parser.add_argument("--steps", type=positive_count, default=100)
    parser.add_argument("--batches", type=positive_count, nargs="+", default=[1, 4, 8])
    parser.add_argument("--planner", default="careful", choices=PLANNERS)
    parser.add_argument("--freely", action="store_true", help="actions may gain as little as 1 um")
    parser.add_argument("--yaws", type=positive_count, help="of the hand (default: as for plan)")
    parser.add_argument("--stock-cm3", type=positive, help="material beside the bed")
    parser.add_argument("--data", type=Path, help="measured sand")
    parser.add_argument("--out", type=Path, help="folder for pictures")
    options = parser.parse_args(words)
    bank, rows = jshape.load_bank(options.bank), []
    free = {"min_gain_mm": 0.001, "error_margin": 0.0} if options.freely else {}
    given = {"yaws": options.yaws, "stock_cm3": options.stock_cm3}
    free |= {name: value for name, value in given.items() if value is not None}
    problems = [shape_problem(letters(), jax.random.key(1))]
    if options.data:
        problems += [p for p in shape_problems(0, 6, options.data) if p.name.startswith("sand")][:1]
    how = {name: one for name, one in jshape.options(**free).items() if name != "stop"}
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    for problem in problems:
        limit, runs = jshape.limit(*problem.ends, bank=bank, max_steps=options.steps, **how), {}
        for batch in options.batches:
            row, run, left = attempt(problem, bank, limit, batch, options.planner, free)
            rows.append(row)
            say("  ".join(row))
            runs[f"{batch} a look"] = run, left
        if options.out:
            name = problem.name.replace(" ", "_")
            (options.out / f"many_{name}.png").write_bytes(png(picture(problem.name, runs)))
    print_table(HEAD, rows)


if __name__ == "__main__":
    main()
