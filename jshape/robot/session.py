"""A loop with a real robot, or one like it: everything is on disk as it happens.

A run's folder holds the goal (`goal.npy`), a look before anything (`start.png`), a frame and a line
in `steps.jsonl` per action, all that happened in `log.jsonl`, and at the end pictures and
`summary.json`.  Any end of the run stops the arm first.
"""

import contextlib
import hashlib
import io
import shlex
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from jshape.actions import PlacedAction
from jshape.camera import check_same_camera
from jshape.errors import BadFile, JShapeError, one_line
from jshape.io import files, formats, images, journal, runs
from jshape.models.bank import Bank
from jshape.planning.options import StopCriteria
from jshape.planning.plan import Plan
from jshape.robot.arms.base import stop_arm
from jshape.robot.learning import Learning, learned_from
from jshape.robot.loop import PATIENCE, Molding, Step, Stop, mold
from jshape.robot.perform import OperationResult
from jshape.robot.robot import Robot
from jshape.robot.run_actions import AT_THE_BED, START
from jshape.robot.signals import uninterrupted

GOAL, SUMMARY, PLAN = "goal.npy", "summary.json", "plan.json"
MARK, PICTURES = "plan.sha256.json", ("result.png", "steps.png")
CONTENTS = (journal.NAME, journal.LOCK, GOAL, START, SUMMARY, PLAN, MARK, *PICTURES)
"""What a session writes beside the run's own files."""

Say = Callable[[str], Any]
Draw = Callable[[Molding], Mapping[str, bytes]]


class Session:
    """One run: started in a new folder, or gone on with in the folder of an earlier one."""

    def __init__(self, run: runs.Run, goal: np.ndarray, say: Say, resumed: bool):
        """Use `start` or `resume`."""
        self.run = run
        self.goal = goal
        """(H, W) the image wanted, NaN where that is not known: see `loop.mold`."""
        self.seen: Callable[[np.ndarray], Any] = lambda depth: None
        """Called with each look (H, W), metres."""
        self._say = say
        self._resumed = resumed
        self._operations: list[list[dict[str, Any]]] = []  # of the actions not looked at yet
        self._learning: Learning | None = None

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
        content = io.BytesIO()
        np.save(content, np.asarray(goal, np.float32), allow_pickle=False)
        more = {GOAL: content.getvalue()}  # a run without its goal could not be resumed
        run = runs.Run.create(folder, meta, overwrite=overwrite, contents=CONTENTS, more=more)
        return cls(run, goal, say, False)

    @classmethod
    def resume(cls, folder: Path, *, say: Say = print) -> "Session":
        """The run in a folder, to be gone on with from what the camera sees now, or BadFile."""
        run = runs.Run.open(folder)
        if not (folder / GOAL).is_file() or not isinstance(run.meta.get("bank"), str):
            raise BadFile(f"{folder}: is not a run of `jshape mold` or `jshape execute`")
        return cls(run, formats.read_array(folder / GOAL), say, True)

    @property
    def done(self) -> int:
        """Actions that were done, or begun so far that the bed may have changed.

        One that was not looked at any more, since something ended the run, is not among the run's
        steps: the journal knows of it.
        """
        path, count, touched = self.run.folder / journal.NAME, 0, False
        for event in journal.events(path) if path.is_file() else []:
            if event["event"] == "acting":
                touched = False
            elif event["event"] == "operation" and event.get("operation") in AT_THE_BED:
                count += not touched
                touched = True
        return max(count, len(self.run))

    def mold(
        self,
        robot: Robot,
        bank: Bank,
        *,
        plan: Plan | None = None,
        stop: StopCriteria = StopCriteria(),
        blind: bool = False,
        adapt: bool = False,
        confirm: Callable[[Plan], bool] | None = None,
        draw: Draw | None = None,
        **search: Any,
    ) -> dict[str, Any]:
        """Bring the arm home, look, plan, ask, act, look again, until the loop stops.

        Args:
          robot: looks and acts; the caller closes it.
          bank: predicts.
          plan: carried out action by action instead of plans made on the way; all of it is checked
            before the first.
          stop: when the run ends; its `max_steps` includes actions before it was resumed.
          blind: the bed does not change, as with an arm that only says what it would do: the first
            plan is gone through, whatever is seen.
          adapt: the bank is corrected by what each action did, those before the run was resumed
            too.
          confirm: asked before each action; None: nobody is asked.
          draw: makes the pictures of the run.
          **search: other keywords of `jshape.robot.loop.mold`.

        Returns:
          What is in `summary.json`: distances, steps, and why it stopped.

        Raises:
          JShapeError, KeyboardInterrupt: what ended the run; the arm is stopped, `summary.json`
            says so too, and a note of the error says how the run goes on.
        """
        with journal.alone(self.run.folder):
            self.run = runs.Run.open(self.run.folder)  # another program may have gone on with it
            done = self.done
            if plan is not None:
                self._same_plan(plan)
                check_same_camera(bank.camera, plan.camera, "the plan's")
                plan = plan.rest(min(done, len(plan)))
            left = replace(stop, max_steps=stop.max_steps - done)
            if left.max_steps <= 0:
                return self._all_done(stop.max_steps)
            if done > len(self.run):
                unseen = done - len(self.run)
                self._say(f"begun and not looked at, so counted as done: {unseen} of the actions")
            robot.on_operation, robot.on_look = self._operation, self._looked
            search |= {"stop": left, "first": plan, "replan": plan is None and not blind}
            if adapt:
                self._learning = learned_from(self.run, bank, self._note)
                bank, search["learn"] = self._learning.bank, self._learned
                if done:
                    search["probe"] = False
            try:
                seen = len(self.run)
                self._note("resumed" if self._resumed else "started", steps=done, seen=seen)
                self._note("homing")
                robot.home()
                result = mold(
                    *(robot, self.goal, bank),
                    **search,
                    patience=None if blind else PATIENCE,
                    watch=True,
                    confirm=self._asking(robot, plan is not None, confirm),
                    on_step=self._stepped,
                )
                with uninterrupted():  # it is over: what came of it is written down
                    summary = self._finish(result, stop_arm(robot.guard))
            except BaseException as problem:
                with uninterrupted():
                    self._aborted(problem, stop_arm(robot.guard))
                meta, out = self.run.meta, ["--resume", "--out", str(self.run.folder)]
                words = ["jshape", meta.get("what", "mold"), *meta.get("words", []), *out]
                problem.add_note(f"{shlex.join(words)} goes on")
                raise
            self._draw(result, draw)
            return summary

    def _asking(
        self, robot: Robot, check: bool, confirm: Callable[[Plan], bool] | None
    ) -> Callable[[Plan], bool]:
        """What is asked before each action; with `check`, all of the first plan is tried first."""

        def ask(ahead: Plan) -> bool:
            nonlocal check
            for act in ahead if check else ():
                robot.check(act)
            check = False
            before, predicted = ahead.distances_mm[:2].tolist()
            distances = {"before_mm": before, "predicted_mm": predicted}
            self._note("planned", **asdict(ahead[0]), **distances, actions=len(ahead))
            agreed = confirm is None or confirm(ahead)
            self._note("acting" if agreed else "declined")
            if agreed:
                self._operations.append([])
            return agreed

        return ask

    def _stepped(self, step: Step, depth: np.ndarray) -> None:
        self.run.append(asdict(step) | {"operations": self._operations.pop(0)}, depth)
        self._say(step.line(len(self.run)))

    def _learned(self, act: PlacedAction, before: np.ndarray, after: np.ndarray) -> Bank:
        assert self._learning is not None
        known = self._learning.evidence.count
        bank = self._learning(act, before, after)
        if known == 0 and (said := self._learning.looks_like()):
            self._say(said)
        return bank

    def _same_plan(self, plan: Plan) -> None:
        """Keep what a plan does; BadFile: the run was begun with another plan."""
        doing = [plan.actions, plan.exact_positions.tolist(), plan.strengths.tolist()]
        doing.append(plan.yaws.tolist())
        if plan.strokes.any() or (plan.lengths != 1).any():  # runs of before have neither
            doing += [plan.lengths.tolist(), plan.strokes.tolist()]
        mark = hashlib.sha256(repr(doing).encode()).hexdigest()
        path = self.run.folder / MARK
        if not path.is_file():
            files.write_json(path, {"sha256": mark})
        elif files.read_json(path).get("sha256") != mark:
            raise BadFile(f"{self.run.folder}: the run was begun with another plan")

    def _operation(self, done: OperationResult) -> None:
        self._operations[-1].append(done._asdict())
        self._note("operation", **done._asdict())

    def _looked(self, depth: np.ndarray) -> None:
        start = self.run.folder / START
        if not start.is_file():
            images.write_depth_png(start, depth, self.run.depth_unit)
        self._note("looked", missing=float(np.mean(~(depth > 0))))
        self.seen(depth)

    def _note(self, event: str, **more: Any) -> None:
        when = {"event": event, "time": datetime.now(UTC).isoformat(timespec="milliseconds")}
        journal.note(self.run.folder / journal.NAME, when | {"clock": time.monotonic()} | more)

    def _aborted(self, problem: BaseException, broken: str | None) -> None:
        """Say what ended the run, as far as the disk still takes it; and what went on breaking."""
        interrupted = isinstance(problem, KeyboardInterrupt)
        why = "interrupted" if interrupted else one_line(problem, 2000)
        summary = {
            "state": "interrupted" if interrupted else "aborted",
            "stop": type(problem).__name__,
            "why": why if broken is None else f"{why}; {broken}",
            "steps": list(self.run.steps),
        }
        if self._learning is not None:
            summary["learned"] = self._learning.told()
        with contextlib.suppress(JShapeError):
            self._note("aborted", error=type(problem).__name__, why=why)
        with contextlib.suppress(JShapeError):
            files.write_json(self.run.folder / SUMMARY, summary)

    def _finish(self, result: Molding, broken: str | None) -> dict[str, Any]:
        """The plan, and last the summary: a run that has one which says "finished" is whole."""
        self._note("stopped", stop=result.stop.name, broken=broken)
        if not (self.run.folder / PLAN).is_file():
            result.first_plan.to_json(self.run.folder / PLAN)
        measured = result.distances_mm.tolist()
        predicted = float(result.first_plan.distances_mm[-1])
        return self._summed_up(result.stop, measured[0], predicted, measured[-1], broken)

    def _all_done(self, max_steps: int) -> dict[str, Any]:
        """Sum up a run that was ended after its last action, as by a full disk.

        Raises:
          JShapeError: it was summed up: there is nothing to go on with.
        """
        path = self.run.folder / SUMMARY
        finished = path.is_file() and files.read_json(path).get("state") == "finished"
        if finished or len(self.run) < self.done or not self.run.steps:
            more = "a larger --max-steps goes on, " * (self.run.meta.get("what") == "mold")
            raise JShapeError(
                f"{self.run.folder}: all {max_steps} actions of the run are done; {more}"
                "--overwrite replaces it"
            )
        last = self.run.steps[-1]
        obtained = last["obtained_mm"]
        return self._summed_up(Stop.MAX_STEPS, obtained, last["predicted_mm"], obtained, None)

    def _summed_up(
        self, stop: Stop, before: float, predicted: float, obtained: float, broken: str | None
    ) -> dict[str, Any]:
        steps = list(self.run.steps)
        summary = {
            "state": "finished",
            "stop": stop.name,
            "why": str(stop) if broken is None else f"{stop}; {broken}",
            "before_mm": float(steps[0]["before_mm"]) if steps else before,
            "predicted_mm": predicted,
            "obtained_mm": obtained,
            "steps": steps,
            "out": str(self.run.folder),
        }
        if self._learning is not None:
            summary["learned"] = self._learning.told()
        files.write_json(self.run.folder / SUMMARY, summary)
        return summary

    def _draw(self, result: Molding, draw: Draw | None) -> None:
        """The pictures; one that cannot be written takes nothing from the run."""
        for name, picture in (draw(result) if draw else {}).items():
            try:
                files.write_atomic(self.run.folder / name, picture)
            except BadFile as problem:
                self._say(f"without its picture: {problem}")
