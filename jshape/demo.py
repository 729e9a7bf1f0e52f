"""The main job in simulation: a bed, a goal that another hand made, and the closed loop between."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Key
from jshape.actions import place
from jshape.data.simulate import random_bed
from jshape.data.view import image_of_depth
from jshape.io import banks, files, folders, runs
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.loop import HEAD, Molding, Step, mold
from jshape.robot.simulated import SimulatedWorld
from jshape.viz import pictures
from jshape.viz.style import drawn

FILES = ("plan.json", "result.png", "actions.png", "steps.png", "report.md", "summary.json")
"""What the demo writes beside the run's own files."""

Say = Callable[[str], Any]


def run_demo(
    out: Path,
    *,
    bank_name: str | None = None,
    seed: int = 0,
    actions: int = 4,
    material: str | sim.Material = "flour",
    agent: str | sim.Agent = "robot",
    replan: bool = True,
    search: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    say: Say = print,
) -> dict[str, Any]:
    """Simulate a bed and a goal, mold the one into the other, write a run with pictures.

    Args:
      out: folder of the run.
      bank_name: bundled bank or folder; None is the default.
      seed: another bed, goal and noise.
      actions: how many random actions make the goal from a copy of the bed.
      material: of the bed.
      agent: whose hand acts, for the goal and in the loop.
      replan: False applies the first plan blindly.
      search: keywords of `jshape.robot.loop.mold`, such as `planner`; None is the defaults.
      overwrite: replace the run that is there.
      say: called with each line for people.

    Returns:
      Distances in mm (before, predicted, obtained), steps, why it stopped, the folder.

    Raises:
      UnknownName: no such bank, material, agent or planner.
      BadFile: the folder exists or cannot be written.
    """
    bank_name = bank_name or DEFAULT_BANK
    search = dict(search or {})
    planner = search.get("planner", "greedy")
    bank = banks.load_bank(bank_name)
    folders.check_target(out, overwrite, contents=(*runs.CONTENTS, *FILES))
    for_bed, for_goal, for_world, for_other = jax.random.split(jax.random.key(seed), 4)
    bed = random_bed(for_bed, "irregular", std=0.003)
    material = sim.read_material(material)
    world, other = (
        SimulatedWorld(key, bed, material=material, agent=agent, camera=bank.camera)
        for key in (for_world, for_other)
    )
    made = _make_goal(for_goal, other, bank, actions)
    goal = image_of_depth(other.look(), bank.camera, where="goal").image
    say(f"a bed of {material.name}, and a goal made from it by: {', '.join(made)}")

    who = agent if isinstance(agent, str) else agent.name
    meta = {"what": "demo", "bank": str(bank_name), "seed": seed, "goal": made, "agent": who}
    meta |= {"material": material.name, "replan": replan, "planner": planner}
    run = runs.Run.create(out, meta, overwrite=overwrite, contents=FILES)
    say(HEAD)

    def report(step: Step, depth: np.ndarray) -> None:
        run.append(step._asdict(), depth)
        say(step.line(len(run)))

    result = mold(world, goal, bank, replan=replan, on_step=report, **search)
    measured = result.distances_mm
    summary: dict[str, Any] = {
        "before_mm": float(measured[0]),
        "predicted_mm": float(result.first_plan.distances_mm[-1]),
        "obtained_mm": float(measured[-1]),
        "steps": [step._asdict() for step in result.steps],
        "stop": result.stop.name,
        "goal": made,
        "bank": str(bank_name),
        "loop": "closed" if replan else "open",
        "planner": planner,
        "out": str(out),
    }
    _write(out, result, summary, bank.rois)
    say(f"stopped: {result.stop}")
    say(
        "distance to the goal: {before_mm:.3f} mm before, {predicted_mm:.3f} mm predicted by the "
        "first plan ({} actions), {obtained_mm:.3f} mm obtained ({} actions)".format(
            len(result.first_plan), len(result.steps), **summary
        )
    )
    say(f"pictures and report: {out}")
    return summary


def _make_goal(key: Key[Array, ""], world: SimulatedWorld, bank: Bank, count: int) -> list[str]:
    """Apply `count` actions at random places, one in each cell of a grid; says what was done.

    The places are not the planner's: a goal need not lie on its grid.
    """
    names = [name for name in bank.actions if name in sim.actions_of(world.agent)]
    rng = np.random.default_rng(jax.random.bits(key, (4,)).tolist())
    grid = np.array([3, 2])
    cells = rng.permutation(grid.prod())
    made = []
    for k in range(count):
        action, cell = names[k % len(names)], int(cells[k % len(cells)])
        at = np.array([cell % grid[0], cell // grid[0]]) + 0.5
        centre = at * (bank.camera.width, bank.camera.height) / grid
        anywhere = np.rint(centre + rng.uniform(-25, 25, 2)).astype(int)
        inside = place(bank.camera, {action: anywhere[None]}, bank.rois, "shift")[action][0]
        u, v = (int(x) for x in inside)
        world.act(action, (u, v))
        made.append(f"{action} at ({u}, {v})")
    return made


def _write(
    out: Path, result: Molding, summary: dict[str, Any], rois: dict[str, tuple[int, int]]
) -> None:
    """Pictures, the first plan and a report into the run's folder."""
    first = result.first_plan
    first.to_json(out / "plan.json")
    rows = "\n".join(
        f"| {k + 1} | {s.action} | {s.position[0]}, {s.position[1]} | {s.strength:.2f} | "
        f"{s.before_mm:.3f} | {s.predicted_mm:.3f} | {s.obtained_mm:.3f} |"
        for k, s in enumerate(result.steps)
    )
    report = f"""# Demo

The goal was made from a copy of the bed by: {", ".join(summary["goal"])}.

Distance to the goal: {summary["before_mm"]:.3f} mm before, {summary["predicted_mm"]:.3f} mm \
predicted by the first plan, {summary["obtained_mm"]:.3f} mm obtained.

| step | action | u, v | strength | before (mm) | predicted (mm) | obtained (mm) |
|---|---|---|---|---|---|---|
{rows}

Stopped: {result.stop}.

![the whole story](result.png)
![the first plan](actions.png)
![what the camera saw](steps.png)
"""
    files.write_atomic(out / "report.md", report)
    files.write_json(out / "summary.json", summary)
    overlay = partial(pictures.overlay_figure, first, rois=rois)
    for name, picture in {
        **pictures.molding_pictures(rois)(result),
        **drawn({"actions.png": overlay}),
    }.items():
        files.write_atomic(out / name, picture)
