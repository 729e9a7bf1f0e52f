"""What lies on the table: a bed, a goal that is drawn, a plan that is edited.

Everything is in the image of the bank's camera.  No browser here: the page calls these methods and
draws what they leave.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape.app.canvas import Canvas
from jshape.app.search import Search
from jshape.camera import Camera, check_camera
from jshape.data.view import View, image_of_depth, view_beside, view_of
from jshape.errors import JShapeError, quoted
from jshape.io import banks, folders, formats, images, points
from jshape.io.cameras import write_camera
from jshape.io.frames import frame_of, source_of
from jshape.models.bank import Bank
from jshape.planning.api import plan, rollout
from jshape.planning.options import DEFAULT_BANK, YAWS, SearchSpace, options
from jshape.planning.plan import Plan

DEPTH_UNIT = 0.0001
"""Metres per count of a goal that is written."""
CONTENTS = ("now.png", "goal.png", "camera.json", "plan.json")
"""What `Desk.save` writes."""


class _Act(NamedTuple):
    """One action of the plan."""

    action: str
    position: Any
    """(u, v), pixels."""
    strength: float
    yaw: float


@dataclass
class Desk(Canvas):
    """One person's work."""

    bank_name: str = DEFAULT_BANK
    bank: Bank = field(init=False)
    plan: Plan | None = None
    """From the bed to the goal."""
    yaws: int = YAWS
    """Yaw angles of the hand that are tried where the bank can turn it."""
    search: Search | None = None
    """The search for a plan that goes on now."""
    advice: str = ""
    """Why the last plan is empty."""
    selected: int = 0
    """How many of the plan's actions are looked at as done."""
    _view: View | None = None  # how a bed of a file was seen

    def __post_init__(self) -> None:
        self.bank = banks.load_bank(self.bank_name)

    @property
    def camera(self) -> Camera:
        """The bank's."""
        return self.bank.camera

    def use_bank(self, name: str) -> None:
        """Plan with another bank; the bed and the goal stay if its camera is the same.

        Raises:
          JShapeError: no such bank, or one for another camera while a bed is on the table.
        """
        self.check_free()
        bank = banks.load_bank(name)
        if self.bed is not None and bank.camera != self.camera:
            raise JShapeError(
                f"bank {quoted(name)} is for another camera ({bank.camera.width}x"
                f"{bank.camera.height} pixels) than the bed on the table ({self.camera.width}x"
                f"{self.camera.height}): start with jshape studio --bank {quoted(name)}"
            )
        self.bank, self.bank_name = bank, name
        self._no_plan()

    # The bed.

    def load_bed(self, path: Path, camera: str | None = None, *, reproject: bool = False) -> None:
        """Take a depth image file for the bed.

        Raises:
          JShapeError: as for `jshape plan`.
        """
        self.check_free()
        image, view = self._read(path, camera, reproject)
        self.see(image, str(path))
        self._view = view

    def see(self, image: np.ndarray, came_from: str, *, same_goal: bool = False) -> None:
        """As `Canvas.see`; how an earlier bed was seen says nothing of this one."""
        self._view = None
        super().see(image, came_from, same_goal=same_goal)

    def _read(
        self, path: Path, camera: str | None, reproject: bool, bed: View | None = None
    ) -> tuple[np.ndarray, View | None]:
        """The image of a file and how it was seen: as the bed was, if its camera is the bed's."""
        if path.suffix.lower() in points.SUFFIXES:
            depth, view = points.read_goal(path, check_camera(self.camera)), None
        else:
            raw = formats.read_array(path)
            source = source_of(path, raw.shape, camera, self.bank)
            depth = frame_of(path, source, reproject=reproject, raw=raw)
            how: dict[str, Any] = {"reproject": reproject, "where": str(path)}
            view = (
                view_beside(bed, self.depth_of(self.bed), source.camera, depth, **how)
                if bed is not None and self.bed is not None
                else view_of(source.camera, self.camera, depth, **how)
            )
        return image_of_depth(depth, self.camera, view=view, where=str(path)).image, view

    # The goal.

    def load_goal(self, path: Path, camera: str | None = None, *, reproject: bool = False) -> None:
        """Take a depth image, PLY or PCD file for the goal; what was drawn is dropped.

        Raises:
          JShapeError: as for `jshape plan`.
        """
        self.check_free()
        self.want(self._read(path, camera, reproject, self._view)[0])

    # The plan.

    def make_plan(self, **fields: Any) -> Plan:
        """Plan from the bed to the goal; `fields` are those of `jshape.options`.

        Raises:
          JShapeError: there is no bed, or as for `jshape.plan`.
        """
        self.check_free()
        bed, goal = self._both()
        if not self.changed:
            raise JShapeError("the goal is the bed as it is: draw, write or load one first")
        bank, keywords = self.bank, options(self.keywords, **fields)
        self.search = Search(lambda: plan(bed, goal, bank=bank, **keywords))
        try:
            self._keep(self.search.result())
        finally:
            self.search = None
        assert self.plan is not None
        return self.plan

    @property
    def keywords(self) -> dict[str, Any]:
        """How plans are made here, as keywords of `jshape.plan`."""
        return {"space": SearchSpace(yaws=self.yaws if self.bank.turns else None)}

    def drop(self, step: int) -> None:
        """Leave an action out (counted from 0)."""
        acts = self._acts(step)
        del acts[step]
        self._predict(acts, select=min(self.selected, len(acts)))

    def move(self, step: int, by: int) -> None:
        """Do an action earlier (-1) or later (1)."""
        acts = self._acts(step)
        to = min(max(step + by, 0), len(acts) - 1)
        acts.insert(to, acts.pop(step))
        self._predict(acts, select=to + 1)

    def put(self, step: int, position: tuple[float, float]) -> None:
        """Move the place of an action to pixel (u, v)."""
        acts = self._acts(step)
        inside = np.clip(position, 0.0, (self.camera.width - 1, self.camera.height - 1))
        acts[step] = acts[step]._replace(position=inside)
        self._predict(acts, select=step + 1)

    def deepen(self, step: int, strength: float) -> None:
        """Do an action so many times as deep as trained.

        Raises:
          JShapeError: no strength that a plan may have.
        """
        acts = self._acts(step)
        acts[step] = acts[step]._replace(strength=strength)
        self._predict(acts, select=step + 1)

    def add(self, action: str, position: tuple[float, float], strength: float = 1.0) -> None:
        """Append an action.

        Raises:
          JShapeError: no such action, place or strength.
        """
        acts = [*self._acts(), _Act(action, position, strength, 0.0)]
        self._predict(acts, select=len(acts))

    def select(self, done: int) -> None:
        """Look at the image after so many actions of the plan."""
        self.selected = min(max(done, 0), len(self.plan) if self.plan else 0)
        self.version += 1

    def save(self, folder: Path, *, overwrite: bool = False) -> None:
        """Write bed, goal, camera and plan, as `jshape plan` and `jshape mold` read them.

        Raises:
          BadFile: the folder holds something else, or cannot be written.
          JShapeError: there is no bed.
        """
        bed, goal = self._both()
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

    # Helpers.

    def _both(self) -> tuple[np.ndarray, np.ndarray]:
        bed, goal = self.bed, self.goal
        if bed is None or goal is None:
            raise JShapeError("there is no bed yet: load one, or look with a camera")
        return bed, goal

    def _acts(self, step: int | None = None) -> list["_Act"]:
        """The plan's actions, to be changed; `step` must be one of them.

        Raises:
          JShapeError: it is not, or a run goes on.
        """
        self.check_free()
        found = self.plan
        columns = (
            () if found is None else
            (found.actions, found.exact_positions, found.strengths.tolist(), found.yaws.tolist())
        )  # fmt: skip
        acts = [_Act(*row) for row in zip(*columns, strict=True)]
        if step is not None and not 0 <= step < len(acts):
            raise JShapeError(f"there is no action {step + 1} of a plan of {len(acts)}")
        return acts

    def _predict(self, acts: list["_Act"], *, select: int) -> None:
        """The plan is these actions, with what they are predicted to bring."""
        bed, goal = self._both()
        names, positions, strengths, yaws = zip(*acts, strict=True) if acts else [()] * 4
        self._keep(
            rollout(bed, goal, names, positions, strengths=strengths, yaws=yaws, bank=self.bank)
        )
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
