"""`jshape demo`: a bed, a goal made from a copy of it, and the closed loop between, simulated."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
from cyclopts import Parameter

from jshape import sim
from jshape._typing import Array, Key
from jshape.actions import place
from jshape.cli.names import Agent, Simulates, Uses
from jshape.cli.options import Count, Seed, Writes
from jshape.cli.search_options import Searches, search_of
from jshape.cli.tables import say, write_pictures
from jshape.data.simulate import random_bed
from jshape.data.view import image_of_depth
from jshape.io import banks, files, folders, runs
from jshape.io.simulated import agent_of, material_of
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.loop import HEAD, Molding, Step, mold
from jshape.robot.simulated import SimulatedWorld
from jshape.viz import pictures

FILES = ("plan.json", "result.png", "actions.png", "steps.png", "report.md", "summary.json")
"""What the demo writes beside the run's own files."""


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Uses, Searches, Simulates, Writes):
    """Of `jshape demo`."""

    out: Path = Path("runs/demo")
    """Folder for the run."""
    actions: Count = 4
    """Number of actions that make the goal."""
    agent: Agent = "robot"
    """Hand that acts: a name or FILE.toml."""
    seed: Seed = 0
    """Of the bed, the goal and the noise."""
    open_loop: bool = False
    """Plan once, then act blindly."""
    reachable: Annotated[str | None, Parameter(parse=False)] = None  # of a frame; there is none yet


def demo(*, options: DemoOptions = DemoOptions()) -> dict[str, Any]:
    """Simulate a bed and a goal, mold the one into the other, write a run with pictures."""
    search = search_of(options)  # before anything is computed: it chooses JAX's devices
    out, bank_name = options.out, str(options.bank or DEFAULT_BANK)
    material, agent = material_of(options.material), agent_of(options.agent)
    bank = banks.load_bank(bank_name)
    folders.check_target(out, options.overwrite, contents=(*runs.CONTENTS, *FILES))
    for_bed, for_goal, for_world, for_other = jax.random.split(jax.random.key(options.seed), 4)
    bed, stock = random_bed(for_bed, "irregular", std=0.003), options.stock_cm3 or 0.0
    world, other = (
        SimulatedWorld(
            key, bed, material=material, agent=agent, camera=bank.camera, stock_cm3=stock
        )
        for key in (for_world, for_other)
    )
    made = _make_goal(for_goal, other, bank, options.actions)
    goal = image_of_depth(other.look(), bank.camera, where="goal").image
    say(f"a bed of {material.name}, and a goal made from it by: {', '.join(made)}")

    who, replan = agent if isinstance(agent, str) else agent.name, not options.open_loop
    meta = {"what": "demo", "bank": bank_name, "seed": options.seed, "goal": made, "agent": who}
    meta |= {"material": material.name, "replan": replan, "planner": options.planner}
    run = runs.Run.create(out, meta, overwrite=options.overwrite, contents=FILES)
    say(HEAD)

    def report(step: Step, depth: np.ndarray) -> None:
        run.append(asdict(step), depth)
        say(step.line(len(run)))

    result = mold(world, goal, bank, replan=replan, on_step=report, **search)
    measured = result.distances_mm
    summary: dict[str, Any] = {
        "before_mm": float(measured[0]),
        "predicted_mm": float(result.first_plan.distances_mm[-1]),
        "obtained_mm": float(measured[-1]),
        "steps": [asdict(step) for step in result.steps],
        "stop": result.stop.name,
        "goal": made,
        "bank": bank_name,
        "loop": "closed" if replan else "open",
        "planner": options.planner,
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
    """Apply `count` actions at random places, from cell to cell of a grid; says what was done.

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
    for name, picture in pictures.molding_pictures(rois)(result).items():
        files.write_atomic(out / name, picture)
    write_pictures(out, {"actions.png": partial(pictures.overlay_figure, first, rois=rois)})
