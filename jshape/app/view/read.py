"""Episodes from disk: a plan's file or folder, a run of `jshape demo`, `mold` or `execute`."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape.app.view.episode import Episode, EpisodeStep
from jshape.camera import Camera
from jshape.data.view import above, image_of_depth
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError, one_line
from jshape.io import banks, files, formats, images, journal, runs
from jshape.io.cameras import camera_from
from jshape.io.records import read_record
from jshape.models.bank import Bank
from jshape.planning.api import check_image, rollout
from jshape.planning.maps import bank_for
from jshape.planning.plan import Plan
from jshape.robot.loop import Stop
from jshape.robot.run_actions import START, ActionRecord, begun, near, same
from jshape.robot.session import GOAL, PLAN, SUMMARY

MOST_ACTIONS = 500
"""Of an episode: each keeps up to two images, 0.8 GB at the paper's size."""


def read_episode(path: str | os.PathLike, *, camera: Camera | None = None) -> Episode:
    """The episode of a plan or of a run.

    Args:
      path: `plan.json`, or a folder that holds it or `run.json`.
      camera: of the frames of a run that holds no plan and whose bank is not here.

    Raises:
      JShapeError: neither is there, or it is damaged, or nothing says what camera a run is of.
    """
    path = Path(path)
    if path.is_file():
        return episode_of_plan(Plan.from_json(path), str(path))
    if not path.is_dir():
        raise BadFile(f"{path}: no such file or folder")
    if (path / runs.DESCRIPTION).is_file():
        return _Reader(path, camera).episode()
    if (path / PLAN).is_file():
        return episode_of_plan(Plan.from_json(path / PLAN), str(path))
    raise BadFile(
        f"{path}: neither a run ({runs.DESCRIPTION}) nor a plan ({PLAN}) is in the folder"
    )


def episode_of_plan(plan: Plan, where: str = "plan") -> Episode:
    """The episode that a plan, stored with its images, predicts."""
    if plan.initial is None:
        raise JShapeError(f"{where}: the plan was stored without its images")
    _check_count(len(plan), where)
    depths = [_depth(image, plan.camera) for image in plan.images]
    d_mm = plan.distances_mm.tolist()
    steps = [EpisodeStep(seen=depths[0], seen_mm=d_mm[0])]
    for k, action in enumerate(plan):
        steps.append(EpisodeStep(None, depths[k + 1], action, d_mm[k], d_mm[k + 1]))
    title = f"plan, {_many(len(plan))}: {d_mm[0]:.3f} mm now, {d_mm[-1]:.3f} mm predicted"
    goal = None if plan.goal is None else _depth(plan.goal, plan.camera)
    return Episode(title, plan.camera, goal, tuple(steps))


class _Reader:
    """Reads a run's folder, whatever of it is there."""

    def __init__(self, folder: Path, camera: Camera | None):
        self._folder, self._run = folder, runs.Run.open(folder)
        self._notes = [_ending(folder)]
        path = folder / PLAN
        self._plan = Plan.from_json(path) if path.is_file() else None
        self._bank = self._find_bank()
        self._camera = self._find_camera(camera)
        self._goal = self._find_goal()
        self._rois = {} if self._bank is None else dict(self._bank.rois)

    def episode(self) -> Episode:
        """All of it."""
        waiting = begun(self._folder / journal.NAME)
        where, rows = self._folder / runs.STEPS, self._run.steps
        _check_count(len(rows) + len(waiting), str(self._folder))
        records = [
            read_record(ActionRecord, row, f"{where}: line {k}") for k, row in enumerate(rows, 1)
        ]
        start = self._start()
        first_mm = next((done.before_mm for done in (*waiting, *records)), None)
        steps = [EpisodeStep(seen=start, seen_mm=self._start_mm(start, first_mm))]
        for k, (done, row) in enumerate(zip(records, rows, strict=True)):
            at = next((j for j, one in enumerate(waiting) if done.is_planned_as(one)), None)
            if at is not None:
                steps += self._unseen(waiting[:at], steps[-1])
                done.position, done.seconds = waiting[at].position, waiting[at].seconds
                waiting = waiting[at + 1 :]
            depth = None
            if "frame" in row:
                depth = self._checked(self._run.depth(k), str(row["frame"]))
            steps.append(self._step(done, steps[-1], depth))
        if unseen := self._unseen(waiting, steps[-1]):
            self._notes.append("the last action was begun and not looked at")
        steps += unseen
        if all(step.bed is None for step in steps):
            raise BadFile(f"{self._folder}: the run has no frame yet")
        goal = None if self._goal is None else _depth(self._goal, self._camera)
        return Episode(self._title(steps), self._camera, goal, tuple(steps), tuple(self._notes))

    def _step(self, done: ActionRecord, before: EpisodeStep, depth: Any) -> EpisodeStep:
        action = replace(done.placed, roi=self._roi(done))
        numbers = done.before_mm, done.predicted_mm, done.obtained_mm, done.effort_nm, done.seconds
        return EpisodeStep(depth, self._predicted(done, before), action, *numbers)

    def _unseen(self, waiting: list[ActionRecord], before: EpisodeStep) -> list[EpisodeStep]:
        """Actions that reached the bed, and that nobody looked at."""
        found: list[EpisodeStep] = []
        for done in waiting:
            if done.touched:
                found.append(self._step(done, before, None))
                before = found[-1]
        return found

    def _predicted(self, done: ActionRecord, before: EpisodeStep) -> np.ndarray | None:
        """(H, W) the depth that was predicted: by the plan, or by the bank from the look before.

        None where that look is not known, as after a run was resumed.
        """
        plan = self._plan
        if plan is not None and plan.initial is not None:
            for k, act in enumerate(plan, 1):
                there = act.action == done.action and near(act.position, done.position)
                if there and same(float(plan.distances_mm[k]), done.predicted_mm):
                    return _depth(plan.images[k], plan.camera)
        bank, goal = self._bank, self._goal
        if before.seen is None or not same(before.seen_mm, done.before_mm):
            return None
        if bank is None or goal is None or done.action not in bank.actions:
            return None
        image = image_of_depth(before.seen, bank.camera, max_missing=1.0).image
        goal = np.where(np.isfinite(goal), goal, image)
        ahead = rollout(image, goal, [done.placed], bank=bank)
        return _depth(ahead.images[1], bank.camera)

    def _roi(self, done: ActionRecord) -> tuple[int, int] | None:
        if done.action not in self._rois and self._plan is not None:
            self._rois = {act.action: act.roi for act in self._plan if act.roi} | self._rois
        return self._rois.get(done.action)

    def _find_bank(self) -> Bank | None:
        """The bank that the run was made with, unless it is gone."""
        name = self._run.meta.get("bank")
        try:
            if not isinstance(name, str):
                raise BadFile("the run names no bank")
            return banks.load_bank(name)
        except JShapeError as problem:
            why = one_line(problem)
            self._notes.append(f"not all that was predicted can be shown: {why}")
            return None

    def _find_camera(self, given: Camera | None) -> Camera:
        found = given if self._bank is None else self._bank.camera
        above_bed = self._run.meta.get("view")
        if isinstance(above_bed, dict):
            found = camera_from(above_bed, f"{self._folder}: the run's view")
        found = found if self._plan is None else self._plan.camera
        if found is None:
            raise BadCamera(
                f"{self._folder}: nothing says what camera the frames are of: no {PLAN} is in the "
                "folder, and the run's bank is not here; --camera-file takes a camera.json"
            )
        if self._bank is not None and isinstance(above_bed, dict):
            self._bank = bank_for(self._bank, found)
        if self._bank is not None and self._bank.camera.shape != found.shape:
            self._bank = None  # another one under the same name
        return found

    def _find_goal(self) -> np.ndarray | None:
        """(H, W) the weighed image I* that was wanted, NaN where that is not known."""
        path = self._folder / GOAL
        if path.is_file():
            goal, camera = formats.read_array(path), self._camera
            known = np.isfinite(goal) if above(camera) else np.ones(goal.shape, bool)
            checked = check_image(np.where(known, goal, 0), camera, str(path))
            return np.where(known, checked, np.float32(np.nan))
        if self._plan is not None and self._plan.goal is not None:
            return self._plan.goal
        self._notes.append("the run holds no goal")
        return None

    def _start(self) -> np.ndarray | None:
        """(H, W) metres: the first look."""
        path = self._folder / START
        if path.is_file():
            depth = images.read_depth(path, depth_unit=self._run.depth_unit)
            return self._checked(depth, START)
        initial = None if self._plan is None else self._plan.initial
        return None if initial is None else _depth(initial, self._camera)

    def _checked(self, depth: np.ndarray, name: str) -> np.ndarray:
        if depth.shape != self._camera.shape:
            raise BadImage(
                f"{self._folder / name}: {depth.shape[1]}x{depth.shape[0]} pixels; the run's "
                f"camera makes {self._camera.width}x{self._camera.height}"
            )
        return depth

    def _start_mm(self, depth: np.ndarray | None, noted_mm: float | None) -> float | None:
        """Distance of the first look to the goal: as the run noted it, if that is of this look."""
        if depth is None or self._goal is None:
            return noted_mm
        look = image_of_depth(depth, self._camera, max_missing=1.0)
        seen = look.known & np.isfinite(self._goal) if above(self._camera) else None
        goal = np.nan_to_num(self._goal)
        measured = float(metric.to_mm(metric.distance(look.image, goal, seen), self._camera))
        count_mm = 1000.0 * self._run.depth_unit  # the look was kept in whole counts
        noted = noted_mm is not None and abs(noted_mm - measured) < count_mm
        return noted_mm if noted else measured

    def _title(self, steps: list[EpisodeStep]) -> str:
        what = self._run.meta.get("what")
        what = one_line(what, 40) if isinstance(what, str) and what else "run"
        told = f"{what}, {_many(len(steps) - 1)}"
        measured = [step.seen_mm for step in steps if step.seen_mm is not None]
        if not measured:
            return told
        return f"{told}: {measured[0]:.3f} mm at the start, {measured[-1]:.3f} mm obtained"


def _check_count(actions: int, where: str) -> None:
    if actions > MOST_ACTIONS:
        raise BadFile(f"{where}: {actions} actions; at most {MOST_ACTIONS} can be shown")


def _many(actions: int) -> str:
    return "1 action" if actions == 1 else f"{actions} actions"


def _depth(image: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) metres of a weighed image I."""
    return np.asarray(camera.depth(metric.unweigh(image, camera)), np.float32)


def _ending(folder: Path) -> str:
    if not (folder / SUMMARY).is_file():
        return "the run has not ended, or was killed"
    summary = files.read_json(folder / SUMMARY)
    why, stop = summary.get("why"), str(summary.get("stop"))
    why = why or (str(Stop[stop]) if stop in Stop.__members__ else stop)
    return one_line(f"{summary.get('state', 'finished')}: {why}")
