"""A loop with a real robot, or one like it: everything is on disk as it happens.

A run's folder holds the goal (`goal.npy`), a look before anything (`start.png`), a frame and a line
in `steps.jsonl` per action, all that happened in `log.jsonl`, and at the end pictures and
`summary.json`.  Whatever ends it, the arm is stopped first.
"""

import contextlib
import io
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadFile, JShapeError
from jshape.planned import Plan
from jshape.predict.bank import Bank
from jshape.robot.loop import Molding, Step, mold
from jshape.robot.procedure import Done
from jshape.robot.robot import Robot
from jshape.store import files, formats, images, journal, plans, runs

GOAL, START, SUMMARY, PLAN = "goal.npy", "start.png", "summary.json", "plan.json"
PICTURES = ("result.png", "steps.png")
CONTENTS = (journal.NAME, GOAL, START, SUMMARY, PLAN, *PICTURES)
"""What a session writes beside the run's own files."""
PATIENCE = 2
"""The loop ends when so many actions in a row did not lower the distance."""

Say = Callable[[str], Any]
Draw = Callable[[Molding], Mapping[str, bytes]]


class Session:
    """One run: started in a new folder, or gone on with in the folder of an earlier one."""

    def __init__(self, run: runs.Run, goal: np.ndarray, say: Say, resumed: bool):
        """Use `start` or `resume`."""
        self.run = run
        self.goal = goal
        """(H, W) the image wanted."""
        self._say = say
        self._resumed = resumed

    @classmethod
    def start(
        cls,
        folder: Path,
        goal: np.ndarray,
        meta: Mapping[str, Any],
        *,
        overwrite: bool = False,
        say: Say = print,
    ) -> "Session":
        """A run in a new folder.

        Raises:
          BadFile: the folder holds something and `overwrite` is False, or cannot be written.
        """
        run = runs.Run.create(folder, meta, overwrite=overwrite, contents=CONTENTS)
        content = io.BytesIO()
        np.save(content, np.asarray(goal, np.float32), allow_pickle=False)
        files.write_atomic(folder / GOAL, content.getvalue())
        return cls(run, goal, say, False)

    @classmethod
    def resume(cls, folder: Path, *, say: Say = print) -> "Session":
        """The run in a folder, to be gone on with from what the camera sees now.

        Raises:
          BadFile: no run of a robot, or a damaged one.
        """
        run = runs.Run.open(folder)
        if not (folder / GOAL).is_file():
            raise BadFile(f"{folder}: holds no {GOAL}, so it is not a run of `jshape mold`")
        return cls(run, formats.read_array(folder / GOAL), say, True)

    def mold(
        self,
        robot: Robot,
        bank: Bank,
        *,
        max_steps: int = 16,
        plan: Plan | None = None,
        confirm: Callable[[Plan], bool] | None = None,
        draw: Draw | None = None,
        **options: Any,
    ) -> dict[str, Any]:
        """Look, plan, ask, act, look again, until the loop stops.

        Args:
          robot: looks and acts; the caller closes it.
          bank: predicts.
          max_steps: most actions of the run, those before it was resumed included.
          plan: carried out action by action instead of plans made on the way.
          confirm: asked before each action; None: nobody is asked.
          draw: makes the pictures of the run.
          **options: of `jshape.robot.loop.mold`.

        Returns:
          What is in `summary.json`: distances, steps, and why it stopped.

        Raises:
          JShapeError: what ended the run; the arm is stopped, and `summary.json` says so too.
          KeyboardInterrupt: likewise.
        """
        done = len(self.run)
        if plan is not None:
            plan = plan.rest(min(done, len(plan)))
        left = max_steps - done
        if left <= 0:
            raise JShapeError(f"{self.run.folder}: all {max_steps} actions of the run are done")
        robot.told = self._operation
        operations: list[dict[str, Any]] = []
        self._operations = operations

        def ask(ahead: Plan) -> bool:
            (u, v), d = ahead.exact_positions[0].tolist(), ahead.distances_mm
            planned = {
                "action": ahead.actions[0], "position": [u, v],
                "strength": float(ahead.strengths[0]), "yaw": float(ahead.yaws[0]),
                "before_mm": float(d[0]), "predicted_mm": float(d[1]), "actions": len(ahead),
            }  # fmt: skip
            self._note("planned", **planned)
            agreed = confirm is None or confirm(ahead)
            self._note("acting" if agreed else "declined")
            operations.clear()
            return agreed

        def report(step: Step, depth: np.ndarray) -> None:
            self.run.append(step._asdict() | {"operations": list(operations)}, depth)
            self._say(
                f"{len(self.run):4d}  {step.action:5s} x{step.strength:4.2f} "
                f"({step.position[0]:3d},{step.position[1]:4d})  {step.before_mm:8.3f}  "
                f"{step.predicted_mm:9.3f}  {step.obtained_mm:9.3f}"
            )

        watched = _Watched(robot, self._looked)
        try:
            self._note("resumed" if self._resumed else "started", steps=done)
            result = mold(
                watched, self.goal, bank, max_steps=left, first=plan, replan=plan is None,
                patience=PATIENCE, watch=True, confirm=ask, on_step=report, **options,
            )  # fmt: skip
        except BaseException as problem:
            robot.arm.stop()
            self._aborted(problem)
            raise
        robot.arm.stop()
        return self._finish(result, draw)

    def _operation(self, done: Done) -> None:
        self._operations.append(done._asdict())
        self._note("operation", **done._asdict())

    def _looked(self, depth: np.ndarray) -> None:
        start = self.run.folder / START
        if not start.is_file():
            images.write_depth_png(start, depth, self.run.depth_unit)
        self._note("looked", missing=float(np.mean(~(depth > 0))))

    def _note(self, event: str, **more: Any) -> None:
        when = {"event": event, "time": datetime.now(UTC).isoformat(timespec="milliseconds")}
        journal.note(self.run.folder / journal.NAME, when | {"clock": time.monotonic()} | more)

    def _aborted(self, problem: BaseException) -> None:
        """Say what ended the run, as far as the disk still takes it."""
        interrupted = isinstance(problem, KeyboardInterrupt)
        why = "interrupted" if interrupted else " ".join(str(problem).split())
        summary = {
            "state": "interrupted" if interrupted else "aborted",
            "error": type(problem).__name__,
            "stop": why,
            "steps": list(self.run.steps),
        }
        with contextlib.suppress(JShapeError):
            self._note("aborted", error=type(problem).__name__, why=why)
        with contextlib.suppress(JShapeError):
            files.write_json(self.run.folder / SUMMARY, summary)

    def _finish(self, result: Molding, draw: Draw | None) -> dict[str, Any]:
        self._note("stopped", stop=result.stop.name)
        measured = result.distances_mm
        summary = {
            "state": "finished",
            "stop": result.stop.name,
            "why": str(result.stop),
            "before_mm": float(measured[0]),
            "predicted_mm": float(result.first_plan.distances_mm[-1]),
            "obtained_mm": float(measured[-1]),
            "steps": list(self.run.steps),
            "out": str(self.run.folder),
        }
        plans.write_plan(self.run.folder / PLAN, result.first_plan)
        for name, picture in (draw(result) if draw else {}).items():
            files.write_atomic(self.run.folder / name, picture)
        files.write_json(self.run.folder / SUMMARY, summary)
        return summary


class _Watched:
    """A robot whose looks are reported."""

    def __init__(self, robot: Robot, looked: Callable[[np.ndarray], None]):
        self.camera = robot.camera
        self.act = robot.act
        self._robot = robot
        self._looked = looked

    def look(self) -> np.ndarray:
        depth = self._robot.look()
        self._looked(depth)
        return depth
