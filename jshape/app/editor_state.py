"""What is edited: a bed, a goal that is drawn, a plan; all in the image of the bank's camera.

No browser here: the page calls these methods and draws what they leave.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jshape.actions import PlacedAction
from jshape.app.goal_state import GoalState
from jshape.app.plan_job import PlanJob
from jshape.camera import Camera, check_camera, differing
from jshape.data.view import View, cut_out, image_of_depth, view_above, view_like
from jshape.errors import BadCamera, JShapeError, quoted
from jshape.io import folders, formats, images, points
from jshape.io.cameras import write_camera
from jshape.io.frames import frame_of, source_of
from jshape.models.bank import Bank
from jshape.planning import problem
from jshape.planning.api import plan, rollout
from jshape.planning.maps import bank_for, over_bed
from jshape.planning.options import (
    DEFAULT_BANK,
    YAWS,
    Constraints,
    SearchSpace,
    StopCriteria,
    options,
)
from jshape.planning.plan import Plan
from jshape.robot.learning import bank_of
from jshape.robot.robot import Robot

DEPTH_UNIT = 0.0001
"""Metres per count of a goal that is written."""
CONTENTS = ("now.png", "goal.png", "camera.json", "plan.json")
"""What `EditorState.save` writes."""


@dataclass
class EditorState(GoalState):
    """One person's work."""

    bank_name: str = DEFAULT_BANK
    bank: Bank = field(init=False)
    plan: Plan | None = None
    """From the bed to the goal."""
    planner: str = "greedy"
    """Which search."""
    max_steps: int = StopCriteria.max_steps
    """Most actions of a plan, or of a run that plans anew."""
    yaws: int = YAWS
    """Yaw angles of the hand that are tried where the bank can turn it."""
    lengths: tuple[float, ...] = tuple(SearchSpace.lengths)
    """Lengths of the hand's path that are tried where an action has one, times the trained one."""
    carries: bool = True
    """Whether a scoop and a pour are tried as one, where the bank has both."""
    stock_cm3: float | None = None
    """Material beside the bed, cm³; None: no stock."""
    search: PlanJob | None = None
    """The search for a plan that goes on now."""
    advice: str = ""
    """Why the last plan is empty."""
    selected: int = 0
    """How many of the plan's actions are looked at as done."""
    revision: int = 0
    """Grows where bed, goal or bank change: what was found for them no longer holds."""
    _view: View | None = None  # how a bed of a file was seen
    _loaded: Bank = field(init=False, repr=False)  # for its own camera

    def __post_init__(self) -> None:
        self.bank = self._loaded = bank_of(self.bank_name)

    @property
    def camera(self) -> Camera:
        """The bank's."""
        return self.bank.camera

    def use_bank(self, name: str) -> None:
        """Plan with another bank, which must be for the same camera if there is a bed."""
        self.check_free()
        loaded = bank = bank_of(name)
        if self.bed is not None and self._view is not None and self._view.above:
            bank = bank_for(bank, self.camera)
        if self.bed is not None and bank.camera != self.camera:
            raise JShapeError(
                f"bank {quoted(name)} is for another camera ({bank.camera.width}x"
                f"{bank.camera.height} pixels) than the bed ({self.camera.width}x"
                f"{self.camera.height}): start with jshape studio --bank {quoted(name)}"
            )
        self.bank, self._loaded, self.bank_name = bank, loaded, name
        self._no_plan()

    def load_bed(self, path: Path, camera: str | None = None) -> None:
        """Take a depth image file for the bed."""
        self.check_free()
        source, depth = self._read(path, camera)
        view, bank = over_bed(self._loaded, source, depth, str(path))
        image = image_of_depth(depth, view.target, view=view, where=str(path)).image
        self.bank = bank
        self.see(image, str(path))
        self._view = view

    def look(self, robot: Robot) -> None:
        """Take what a robot's camera sees for the bed; the first look says from where."""
        if robot.view is None:
            given = self._loaded, robot.depth_camera.camera, robot.frame(), robot.eyes
            view, bank = over_bed(*given, again=robot.several)
        else:
            view, bank = robot.view, self._loaded
            if view.above:
                bank = bank_for(bank, view.target)
        robot.view, robot.camera = view, bank.camera
        image = image_of_depth(robot.look(), bank.camera, where=robot.depth_camera.name).image
        self.bank = bank
        self.see(image, robot.depth_camera.name)
        self._view = view

    def show_to(self, robot: Robot) -> None:
        """Let a robot look as the bed was seen.

        Raises:
          BadCamera: the bed is of another camera, and nothing says how its own stands to it.
        """
        view, eye = self._view, robot.depth_camera.camera
        if robot.camera == self.camera:
            return
        if view is None or differing(view.source, eye, ""):
            raise BadCamera(
                f"the bed is not of {robot.depth_camera.name}: look with the camera first"
            )
        robot.view, robot.camera = replace(view, source=eye), self.camera

    def see(self, image: np.ndarray, came_from: str, *, same_goal: bool = False) -> None:
        """As `GoalState.see`; how an earlier bed was seen says nothing of one of another look."""
        self._view = self._view if same_goal else None
        super().see(image, came_from, same_goal=same_goal)

    def _read(self, path: Path, camera: str | None) -> tuple[Camera, np.ndarray]:
        """A file's frame (H, W), metres, and the camera that took it."""
        if path.suffix.lower() in points.SUFFIXES:
            return self.camera, points.read_cloud(path, check_camera(self.camera))
        raw = formats.read_array(path)
        source = source_of(path, raw.shape, camera, self._loaded)
        return source.camera, frame_of(path, source, raw=raw)

    def load_goal(self, path: Path, camera: str | None = None) -> None:
        """Take a depth image, PLY or PCD file for the goal; what was drawn is dropped."""
        self.check_free()
        source, depth = self._read(path, camera)
        if source is self.camera:
            view = None
        elif self._view is not None and self.bed is not None:
            view = view_like(self._view, source, depth, str(path))
        else:
            view = cut_out(source, self.camera, depth) or view_above(source, depth, self.camera)
        wanted = image_of_depth(depth, self.camera, view=view, where=str(path))
        image = wanted.image
        if self.bed is not None and view is not None and view.above:
            image = np.where(wanted.known, image, self.bed)  # what is hidden stays as it is
        self.want(image)

    def make_plan(self, **fields: Any) -> Plan:
        """Plan from the bed to the goal; `fields` are those of `jshape.options`."""
        self.check_free()
        self.check_changed()
        bed, goal = self.both()
        bank, keywords = self.bank, options(self.keywords, **fields)
        self.search = PlanJob(lambda: plan(bed, goal, bank=bank, **keywords))
        try:
            self._keep(self.search.result())
        finally:
            self.search = None
        assert self.plan is not None
        return self.plan

    @property
    def keywords(self) -> dict[str, Any]:
        """How plans are made here, as keywords of `jshape.plan`."""
        space = SearchSpace(
            yaws=self.yaws if self.bank.turns else None,
            lengths=self.lengths,
            carries=None if self.carries else {},
        )
        return {
            "planner": self.planner,
            "space": space,
            "constraints": Constraints(stock_cm3=self.stock),
            "stop": StopCriteria(max_steps=self.max_steps),
        }

    @property
    def has_paths(self) -> bool:
        """Whether an action of the bank goes along a path, whose length may be another."""
        return any(predictor.path_mm for predictor in self.bank.predictors)

    @property
    def can_carry(self) -> bool:
        """Whether the bank has actions that take material out and bring it elsewhere."""
        return bool(problem.carries(self.bank, None))

    @property
    def stock(self) -> float | None:
        """`stock_cm3` where carries are tried, else None."""
        return self.stock_cm3 if self.carries and self.can_carry else None

    def drop(self, step: int) -> None:
        """Leave an action out (counted from 0)."""
        actions = self._actions(step)
        del actions[step]
        self._predict(actions, select=min(self.selected, len(actions)))

    def move(self, step: int, by: int) -> None:
        """Do an action earlier (-1) or later (1)."""
        actions = self._actions(step)
        to = min(max(step + by, 0), len(actions) - 1)
        actions.insert(to, actions.pop(step))
        self._predict(actions, select=to + 1)

    def change(self, step: int, **fields: Any) -> None:
        """Do an action elsewhere, at pixel `position` (u, v), or at another `strength`."""
        actions = self._actions(step)
        if "position" in fields:
            most = self.camera.width - 1, self.camera.height - 1
            fields["position"] = tuple(np.clip(fields["position"], 0.0, most).tolist())
        actions[step] = replace(actions[step], **fields)
        self._predict(actions, select=step + 1)

    def select(self, done: int) -> None:
        """Look at the image after so many actions of the plan."""
        self.selected = min(max(done, 0), len(self.plan) if self.plan else 0)
        self.version += 1

    def save(self, folder: Path, *, overwrite: bool = False) -> None:
        """Write bed, goal, camera and plan, as `jshape plan` and `jshape mold` read them."""
        bed, goal = self.both()
        with folders.atomic_folder(folder, overwrite, contents=CONTENTS) as temp:
            for name, image in (("now.png", bed), ("goal.png", goal)):
                images.write_depth_png(temp / name, self.depth_of(image), DEPTH_UNIT)
            write_camera(temp / "camera.json", self.camera, DEPTH_UNIT)
            if self.plan is not None:
                self.plan.to_json(temp / "plan.json")

    def follow(self, ahead: Plan) -> None:
        """Show what a run is about to do: what is left of its plan, the next action selected."""
        self.plan, self.selected = ahead, min(1, len(ahead))
        self.version += 1

    def _actions(self, step: int | None = None) -> list[PlacedAction]:
        """The plan's actions, to be changed; `step` must be one of them."""
        self.check_free()
        actions = list(self.plan or ())
        if step is not None and not 0 <= step < len(actions):
            raise JShapeError(f"there is no action {step + 1} of a plan of {len(actions)}")
        return actions

    def _predict(self, actions: list[PlacedAction], *, select: int) -> None:
        """The plan is these actions, with what they are predicted to bring."""
        self._keep(rollout(*self.both(), actions, bank=self.bank))
        self.selected = select

    def _keep(self, found: Plan) -> None:
        self.plan, self.selected, self.advice = found, 0, ""
        self.version += 1

    def _changed(self) -> None:
        """The bed or the goal is another: what was planned for it no longer holds."""
        super()._changed()
        self._no_plan()

    def _no_plan(self) -> None:
        self.plan, self.selected = None, 0
        self.version += 1
        self.revision += 1
