"""The paper's robot experiment again: six goals, planned with a bank, molded by a robot that looks.

Four goals are made by the robot's hand and two by a human's, each by three actions apart from one
another on a levelled bed, as in the paper's section VII-C.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.experiments import LeftOut, pages
from benchmarks.experiments.measures import Retrieval, retrieval
from benchmarks.experiments.problems import Applied
from benchmarks.experiments.robot_page import FIGURES, curves, page_of, report, strips
from benchmarks.experiments.samples import ACTIONS, Asked
from benchmarks.experiments.twin import check_engine
from jshape import actions, sim
from jshape.camera import PAPER_BOX
from jshape.data.view import image_of_depth
from jshape.errors import UnknownName
from jshape.io import banks, files, runs
from jshape.planning.options import DEFAULT_BANK, PAPER, options
from jshape.robot.arms.mujoco import BOX
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.loop import Molding, Step, mold
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from jshape.robot.simulated import SimulatedWorld

AGENTS = ("robot", "robot", "robot", "robot", "human", "human")
"""Whose hand made the goal of each problem."""
LEVELLED = 0.001
"""Standard deviation of a bed that was levelled by hand, metres."""
TRIED: dict[str, Any] = {"stride": 8, "strengths": (0.5, 1.0, 1.6), "max_steps": 6}
"""What the loop tries, and how many actions it may take."""
MIN_GAIN_MM = 0.01
"""An action must help by more than this, about what a prediction errs by."""
ARMS = {"mujoco": "the physics twin", "sim": "the simulator's hand over the height field"}
QUICK = (0, 4)
"""Problems of a quick run: one goal of each hand."""
TRIED_QUICK: dict[str, Any] = {"max_steps": 4}
"""The same there: only the paper's places and one strength, which take less to compile."""
FILES = ("report.md", "robot.json", *pages.contents(FIGURES))
"""What is written beside the run's own files."""

Say = Callable[[str], Any]


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """The six goals in the physics twin, or where it cannot be had with the simulator's hand.

    Args:
      out: folder of the result.
      asked: quick: two goals, with the simulator's hand.

    Returns:
      What `results.json` holds: a row per problem.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    arm, notes = "sim" if asked.quick else "mujoco", []
    if arm == "mujoco":
        try:
            check_engine()
        except LeftOut as problem:
            arm, notes = "sim", [f"The simulator's hand stands in for the twin: {problem}"]
    more: dict[str, Any] = {"quick": asked.quick, "overwrite": asked.overwrite, "notes": notes}
    run_robot(out, arm=arm, seed=asked.seed, say=asked.say, **more)
    return files.read_json(out / pages.JSON)


def run_robot(
    out: Path,
    *,
    arm: str = "mujoco",
    bank_name: str | None = None,
    seed: int = 0,
    quick: bool = False,
    notes: Sequence[str] = (),
    overwrite: bool = False,
    say: Say = print,
) -> dict[str, Any]:
    """Mold the six goals; tables and pictures into a folder.

    Args:
      out: folder.
      arm: "mujoco", the physics twin, or "sim", the hand over the height field.
      bank_name: bundled bank or folder; None is the default.
      seed: of beds, goals and noise.
      quick: two problems, and few candidates.
      notes: for the page.
      overwrite: replace what is there.
      say: told each line for people.

    Returns:
      A row per problem: distances before, predicted and after each action, and what was retrieved.

    Raises:
      UnknownName: no such arm or bank.
      JShapeError: MuJoCo is not installed; whatever a robot raises.
    """
    if arm not in ARMS:
        raise UnknownName("arm", arm, ARMS)
    bank = banks.load_bank(bank_name or DEFAULT_BANK)
    run = runs.Run.create(
        out, {"what": "robot", "arm": arm, "bank": str(bank_name or DEFAULT_BANK), "seed": seed},
        overwrite=overwrite, contents=FILES,
    )  # fmt: skip
    rows, outcomes = [], []
    tried = TRIED_QUICK if quick else TRIED
    for number in QUICK if quick else range(len(AGENTS)):
        agent = AGENTS[number]
        bed, wanted, applied = problem(seed, number, agent)
        with _robot(arm, wanted, seed + len(AGENTS) + number) as other:
            goal = image_of_depth(other.look(), bank.camera, where="goal").image
        names = ", ".join(f"{a.action} at {tuple(a.position)}" for a in applied)
        say(f"problem {number + 1}, a goal made by a {agent}: {names}")
        with _robot(arm, bed, seed + number) as robot:
            result = mold(
                robot, goal, patience=2, watch=True, on_step=lambda step, depth: say(_line(step)),
                **options(PAPER, bank=bank, min_gain_mm=MIN_GAIN_MM, **tried),
            )  # fmt: skip
        found = retrieval(applied, result.first_plan, bank.camera)
        row = _row(number, agent, applied, result, found)
        run.append(row, result.depths[-1])
        rows.append(row)
        outcomes.append(result)
        say(f"   stopped: {result.stop}")
    content = {"arm": arm, "rows": rows}
    files.write_json(out / "robot.json", content)
    files.write_atomic(out / "report.md", report(content))
    titles = [f"problem {row['problem']}, goal by a {row['goal_by']}" for row in rows]
    names = [f"{row['problem']}, by a {row['goal_by']}" for row in rows]
    figures = partial(strips, outcomes, names), partial(curves, outcomes, titles)
    settings = {name: run.meta[name] for name in ("arm", "bank", "seed")} | {"tried": tried}
    notes = [*notes, f"An action must help by more than {MIN_GAIN_MM} mm."]
    pages.add(page_of(rows, ARMS[arm], figures, settings, notes), out)
    return content


def problem(seed: int, number: int, agent: str) -> tuple[sim.Bed, sim.Bed, list[Applied]]:
    """A levelled bed, the bed that is wanted, and what made it from a copy of the first."""
    rng = np.random.default_rng([seed, number])
    for_bed, for_hand = jax.random.split(jax.random.key(int(rng.integers(2**31))))
    bed = sim.irregular_bed(for_bed, std=LEVELLED, size=BOX)
    other = SimulatedWorld(for_hand, bed, agent=agent)
    places = actions.grid(PAPER_BOX, 5, 3)
    columns = rng.permutation(3) * 2  # apart: no two of the five columns side by side
    applied = []
    for action, column in zip(rng.permutation(ACTIONS), columns, strict=True):
        u, v = places[int(rng.integers(3)) * 5 + column].tolist()
        other.act(str(action), (u, v))
        applied.append(Applied(str(action), (u, v), 1.0, 0.0))
    return bed, other.bed, applied


def _robot(arm: str, bed: sim.Bed, seed: int) -> Robot:
    """A robot of one of `ARMS` over a bed."""
    if arm == "sim":
        for_world, for_eye = jax.random.split(jax.random.key(seed))
        world = SimulatedWorld(for_world, bed)
        return Robot(simulated_camera(world, for_eye), SimulatedArm(world), load_hand(), PAPER_BOX)
    from jshape.robot.arms.mujoco import make_twin

    made = make_twin(seed, bed, camera=PAPER_BOX)
    return Robot(made.camera, made.arm, load_hand(), PAPER_BOX, base_camera=made.base_camera)


def _row(
    number: int, agent: str, applied: list[Applied], result: Molding, found: Retrieval
) -> dict[str, Any]:
    return {
        "problem": number + 1,
        "goal_by": agent,
        "applied": [{"action": a.action, "position": list(a.position)} for a in applied],
        "planned": list(result.first_plan.actions),
        "predicted_mm": [float(d) for d in result.first_plan.distances_mm],
        "obtained_mm": [float(d) for d in result.distances_mm],
        "actions": [step.action for step in result.steps],
        "retrieved": found.retrieved,
        "exact": bool(found.exact),
        "stop": result.stop.name,
    }


def _line(step: Step) -> str:
    u, v = step.position
    return (
        f"   {step.action:5s} x{step.strength:4.2f} ({u:3d},{v:4d})  {step.before_mm:.3f} -> "
        f"{step.predicted_mm:.3f} predicted, {step.obtained_mm:.3f} obtained"
    )
