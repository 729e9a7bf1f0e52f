"""The paper's robot experiment again: six goals, planned with a bank, molded by a robot that looks.

Four goals are made by the robot's hand and two by a human's, each by three actions apart from one
another on a levelled bed, as in the paper's section VII-C.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from jshape import actions, metric, sim
from jshape.camera import PAPER_BOX
from jshape.data.view import image_of_depth
from jshape.errors import UnknownName
from jshape.experiments.measures import Retrieval, retrieval
from jshape.experiments.problems import Applied
from jshape.experiments.samples import ACTIONS
from jshape.planning import DEFAULT_BANK
from jshape.robot.arms.names import BOX
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.loop import Molding, Step, mold
from jshape.robot.robot import Robot
from jshape.robot.simulated import SimulatedWorld
from jshape.store import banks, files, runs
from jshape.store.procedures import load_hand
from jshape.viz import pictures
from jshape.viz.scores import markdown

AGENTS = ("robot", "robot", "robot", "robot", "human", "human")
"""Whose hand made the goal of each problem."""
LEVELLED = 0.001
"""Standard deviation of a bed that was levelled by hand, metres."""
TRIED: dict[str, Any] = {"stride": 8, "strengths": (0.5, 1.0, 1.6), "max_steps": 6}
"""What the loop tries, and how many actions it may take."""
MIN_GAIN_MM = 0.01
"""An action must help by more than this: below it the camera's noise decides."""
ARMS = ("mujoco", "sim")
FILES = ("report.md", "robot.json", "robot.png", "curves.png")
"""What is written beside the run's own files."""

Say = Callable[[str], Any]


def run_robot(
    out: Path,
    *,
    arm: str = "mujoco",
    bank_name: str | None = None,
    seed: int = 0,
    overwrite: bool = False,
    say: Say = print,
) -> dict[str, Any]:
    """Mold the six goals; tables and pictures into a folder.

    Args:
      out: folder.
      arm: "mujoco", the physics twin, or "sim", the hand over the height field.
      bank_name: bundled bank or folder; None is the default.
      seed: of beds, goals and noise.
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
    rows, stories = [], []
    least = MIN_GAIN_MM / float(metric.to_mm(1.0, bank.camera))
    for number, agent in enumerate(AGENTS):
        bed, wanted, applied = problem(seed, number, agent)
        with _robot(arm, wanted, seed + len(AGENTS) + number) as other:
            goal = image_of_depth(other.look(), bank.camera, where="goal").image
        names = ", ".join(f"{a.action} at {tuple(a.position)}" for a in applied)
        say(f"problem {number + 1}, a goal made by a {agent}: {names}")
        with _robot(arm, bed, seed + number) as robot:
            result = mold(
                robot, goal, bank, min_gain=least, patience=2, watch=True,
                on_step=lambda step, depth: say(_line(step)), **TRIED,
            )  # fmt: skip
        found = retrieval(applied, result.first_plan, bank.camera)
        row = _row(number, agent, applied, result, found)
        run.append(row, result.depths[-1])
        rows.append(row)
        stories.append(result)
        say(f"   stopped: {result.stop}")
    content = {"arm": arm, "rows": rows}
    files.write_json(out / "robot.json", content)
    files.write_atomic(out / "report.md", report(content))
    files.write_atomic(out / "robot.png", pictures.png(strips(stories)))
    files.write_atomic(out / "curves.png", pictures.png(curves(stories)))
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
    from jshape.robot.twin import make_twin

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


def report(content: dict[str, Any]) -> str:
    """The six problems as Markdown."""
    head = ("problem", "goal by", "applied", "carried out", "d before, then after each action (mm)",
            "first plan predicted", "retrieved")  # fmt: skip
    rows = [
        (
            str(row["problem"]), row["goal_by"], ", ".join(a["action"] for a in row["applied"]),
            ", ".join(row["actions"]), " → ".join(f"{d:.2f}" for d in row["obtained_mm"]),
            f"{row['predicted_mm'][-1]:.2f}", f"{100 * row['retrieved']:.0f} %",
        )
        for row in content["rows"]
    ]  # fmt: skip
    pictures_ = "![initial, wanted, predicted, obtained](robot.png)\n\n![d](curves.png)\n"
    return f"# Six robot experiments ({content['arm']})\n\n{markdown(head, rows)}\n{pictures_}"


def strips(stories: list[Molding]) -> Figure:
    """Per problem I0, I*, the image predicted by the first plan, and the one obtained."""
    camera = stories[0].first_plan.camera
    figure = Figure(figsize=(11, 2.3 * len(stories)), layout="constrained")
    axes = figure.subplots(len(stories), 4, squeeze=False)
    for line, story in zip(axes, stories, strict=True):
        first = story.first_plan
        shown = {
            "initial": story.images[0],
            "wanted": story.goal,
            f"predicted, {first.distances_mm[-1]:.2f} mm": first.images[-1],
            f"obtained, {story.distances_mm[-1]:.2f} mm": story.images[-1],
        }
        for ax, (title, image) in zip(line, shown.items(), strict=True):
            ax.imshow(pictures.height_mm(image, camera), cmap="gray", vmin=0, vmax=32)
            ax.set_title(title, fontsize=9)
            ax.set_xticks([])
            ax.set_yticks([])
    return figure


def curves(stories: list[Molding]) -> Figure:
    """The distance to the goal after each action, predicted and obtained, per problem."""
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    axes = figure.subplots(-(-len(stories) // 3), 3, squeeze=False).ravel()
    for k, (ax, story) in enumerate(zip(axes, stories, strict=False)):
        pictures.draw_curve(ax, story.first_plan.distances_mm, story.distances_mm)
        ax.set_title(f"problem {k + 1}, goal by a {AGENTS[k]}", fontsize=9)
    figure.supylabel("distance to the goal (mm)", fontsize=10)
    for ax in axes[len(stories) :]:
        ax.set_axis_off()
    return figure


def _line(step: Step) -> str:
    u, v = step.position
    return (
        f"   {step.action:5s} x{step.strength:4.2f} ({u:3d},{v:4d})  {step.before_mm:.3f} -> "
        f"{step.predicted_mm:.3f} predicted, {step.obtained_mm:.3f} obtained"
    )
