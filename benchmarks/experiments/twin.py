"""How well the physics twin does what it is told: every action at every place of the paper.

`python -m benchmarks.experiments.twin FOLDER` writes the report.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.experiments import LeftOut, pages
from benchmarks.experiments.samples import ACTIONS, Asked
from benchmarks.experiments.twin_page import FIGURES, page_of, report
from jshape import actions, sim
from jshape._typing import Array, Key
from jshape.camera import PAPER_BOX
from jshape.errors import JShapeError
from jshape.io import files, folders
from jshape.robot.arms.mujoco import BOX, Ready, make_twin
from jshape.robot.perform import OperationResult, perform
from jshape.robot.procedure import Hand, surface_point
from jshape.robot.procedure_file import load_hand
from jshape.robot.twin import engine
from jshape.robot.twin.model import Obstacle
from jshape.robot.twin.world import Twin

HILLS = 0.005
"""Standard deviation of the bed's surface, metres."""
FILES = ("report.md", "twin.json", *pages.contents(FIGURES))
"""What is written."""
QUICK: dict[str, Any] = {"columns": 2, "rows": 1}
"""Places of a quick check."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """The check, for a report of all experiments.

    Args:
      out: folder of the result.
      asked: quick: two places.

    Returns:
      What `results.json` holds: a row per action and place.

    Raises:
      LeftOut: MuJoCo or mink is not installed, or there is nothing to draw with.
      BadFile: the folder holds something else, or cannot be written.
    """
    check_engine()
    places: dict[str, Any] = QUICK if asked.quick else {}
    check_twin(out, key=asked.seed, overwrite=asked.overwrite, say=asked.say, **places)
    return files.read_json(out / pages.JSON)


def check_engine() -> None:
    """Whether the twin can be had here.

    Raises:
      LeftOut: MuJoCo or mink is not installed, or there is nothing to draw with.
    """
    try:
        engine.mink()
        empty = engine.mujoco().MjModel.from_xml_string("<mujoco/>")
        engine.renderer(empty, 16, 16).close()
    except JShapeError as problem:
        raise LeftOut(str(problem)) from None


def check_twin(
    out: str | Path | None = None,
    *,
    key: Key[Array, ""] | int = 0,
    names: Sequence[str] = ACTIONS,
    columns: int = 5,
    rows: int = 3,
    hand: Hand | None = None,
    overwrite: bool = False,
    say: Callable[[str], object] = lambda line: None,
) -> dict[str, Any]:
    """Every action at every place of the paper's grid, each on the same fresh bed, and an obstacle.

    Args:
      out: folder for `report.md` and `twin.json`; None writes nothing.
      key: of the bed, or a seed.
      names: of the actions.
      columns: places along u.
      rows: places along v.
      hand: its procedures; None is the twin's own.
      overwrite: write into a folder that holds a check already.
      say: told a line per action and place.

    Returns:
      `actions` (a row each: number of trials and of completed ones, collisions, place errors in mm,
      efforts in Nm, least distance to a joint limit in degrees), `trials` and `obstacle`.

    Raises:
      BadFile: the folder holds something else.
      JShapeError: MuJoCo or mink is not installed.
    """
    if out is not None:
        folders.check_target(Path(out), overwrite, contents=FILES)
    hand = load_hand() if hand is None else hand
    key = jax.random.key(key) if isinstance(key, int) else key
    for_bed, for_twin = jax.random.split(key)
    bed = sim.irregular_bed(for_bed, std=HILLS, size=BOX)
    ready = make_twin(for_twin, bed, camera=PAPER_BOX, noise=0.0)
    with ready.camera as eye:
        depth = eye.depth()
    places = actions.grid(PAPER_BOX, columns, rows, margin=actions.PAPER_ROIS["grasp"])
    trials = []
    for name in names:
        for place in places:
            ready.arm.twin.put(bed)
            point = surface_point(depth, PAPER_BOX, place)
            row = {"action": name, "place": place.tolist()}
            trials.append(row | trial(ready, hand, name, point))
            say(_line(trials[-1]))
    content = {
        "actions": [summary(name, trials) for name in names],
        "obstacle": check_obstacle(hand),
        "trials": trials,
    }
    if out is not None:
        files.write_json(Path(out) / "twin.json", content)
        files.write_atomic(Path(out) / "report.md", report(content))
        pages.add(page_of(content), Path(out))
    return content


def trial(ready: Ready, hand: Hand, action: str, point: np.ndarray) -> dict[str, Any]:
    """One action at one point (camera frame, metres): what came of it."""
    arm, twin = ready.arm, ready.arm.twin
    least = np.inf
    twin.collisions.clear()

    def watch(twin: Twin) -> None:
        nonlocal least
        least = min(least, float((twin.reach.ranges - np.abs(twin.joints())).min()))

    done: list[OperationResult] = []
    before, arm.watch = arm.watch, watch
    try:
        perform(arm, hand, action, point, ready.base_camera, on_operation=done.append)
    finally:
        arm.watch = before
    touched = np.array(done[2].tool_mm)
    return {
        "operations": len(done),
        "place_error_mm": float(np.linalg.norm(touched[:2] - point[:2] * 1000.0)),
        "touched_below_surface_mm": float(touched[2] - point[2] * 1000.0),
        "ended_by_contact": [one.operation for one in done if one.contact],
        "effort_nm": {one.operation: one.effort_nm for one in done},
        "joint_margin_degrees": float(np.degrees(least)),
        "collisions": sorted(map(list, twin.collisions)),
        "deepest_change_mm": float(np.abs(_change(twin)).max() * 1000.0),
    }


def check_obstacle(hand: Hand, action: str = "poke") -> dict[str, Any]:
    """The same action where something rigid lies 8 mm below the surface, and one beside it."""
    bed = sim.flat_bed(size=BOX)
    ready = make_twin(0, bed, obstacle=Obstacle((0.05, 0.0), top=sim.DEPTH - 0.008), noise=0.0)
    rows = {}
    for where, x in (("on it", 0.05), ("beside it", -0.10)):
        ready.arm.twin.put(bed)
        point = np.array([x, 0.0, sim.SURFACE])
        rows[where] = trial(ready, hand, action, point)
    return rows


def summary(name: str, trials: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of one action over all places."""
    mine = [one for one in trials if one["action"] == name]
    errors = np.array([one["place_error_mm"] for one in mine])
    felt = {
        operation: max(one["effort_nm"][operation] for one in mine)
        for operation in ("above", "contact", "act", "up")
    }
    return {
        "action": name,
        "trials": len(mine),
        "completed": sum(one["operations"] == 6 for one in mine),
        "collisions": sum(len(one["collisions"]) for one in mine),
        "place_error_mm": {"mean": float(errors.mean()), "max": float(errors.max())},
        "contact_felt": sum("contact" in one["ended_by_contact"] for one in mine),
        "effort_nm": felt,
        "joint_margin_degrees": min(one["joint_margin_degrees"] for one in mine),
    }


def _change(twin: Twin) -> np.ndarray:
    return np.asarray(twin.bed.height) - np.asarray(twin.first.height)


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['action']:5} at {tuple(row['place'])}: {row['place_error_mm']:.2f} mm, "
        f"{row['effort_nm']['act']:.0f} Nm, {len(row['collisions'])} collisions"
    )
