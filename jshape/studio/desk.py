"""What lies on the table: a bed, a goal that is drawn, a plan that is edited.

Everything is in the image of the bank's camera.  No browser here: the page calls these methods and
draws what they leave.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape._typing import Float
from jshape.camera import Camera, check_camera
from jshape.commands.arguments import STRENGTHS, STRIDE
from jshape.commands.plan import source_of
from jshape.data.view import image_of_depth, view_of
from jshape.errors import JShapeError
from jshape.goals import Limits, bed_map, make_goal, report
from jshape.planned import Plan
from jshape.planning import DEFAULT_BANK, plan, rollout
from jshape.predict.bank import Bank
from jshape.sim import MATERIALS, Material
from jshape.store import banks, folders, formats, images, plans, points
from jshape.store.cameras import write_camera
from jshape.studio.drawing import Mark, check_mark, wanted

MOST_MARKS = 500
"""Of a drawing."""
MIN_GAIN_MM = 0.005
"""What an action of a plan must gain: below it the camera's noise decides."""
DEPTH_UNIT = 0.0001
"""Metres per count of a goal that is written."""
CONTENTS = ("now.png", "goal.png", "camera.json", "plan.json")
"""What `Desk.save` writes."""


@dataclass
class Desk:
    """One person's work."""

    bank_name: str = DEFAULT_BANK
    material: str = "flour"
    """What the bed is of: walls that are drawn are as steep as it stands."""
    bank: Bank = field(init=False)
    bed: np.ndarray | None = None
    """(H, W) image I of the bed now."""
    came_from: str = ""
    """Where the bed is from, for people."""
    marks: tuple[Mark, ...] = ()
    """What was drawn, in its order."""
    plan: Plan | None = None
    selected: int = 0
    """How many of the plan's actions are looked at as done."""
    locked: str = ""
    """Why nothing may be changed now: a run goes on.  "" allows it."""
    version: int = 0
    """Grows with every change: pages that show another one draw anew."""
    _base: np.ndarray | None = None  # (H, W) the goal under the drawing; None: the bed
    _goal: np.ndarray | None = None  # the goal, once it was asked for
    _told: dict[str, Any] = field(default_factory=dict)  # the report on what was drawn

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
            raise JShapeError(f"bank {name} is for another camera than the bed on the table")
        self.bank, self.bank_name = bank, name
        self._no_plan()

    # The bed.

    def load_bed(self, path: Path, camera: str | None = None, *, reproject: bool = False) -> None:
        """Take a depth image file for the bed.

        Raises:
          JShapeError: as for `jshape plan`.
        """
        self.check_free()
        self.see(self._read(path, camera, reproject), str(path))

    def see(
        self, image: Float[np.ndarray, "H W"], came_from: str, *, same_goal: bool = False
    ) -> None:
        """Take an image I of the bank's camera for the bed.

        What was drawn is drawn on it; with `same_goal` the goal is what it was before.
        """
        if same_goal and self.goal is not None:
            self._base, self.marks = self.goal, ()
        self.bed, self.came_from = image, came_from
        self._changed()

    def _read(self, path: Path, camera: str | None, reproject: bool) -> np.ndarray:
        if path.suffix.lower() in points.SUFFIXES:
            depth, view = points.read_goal(path, check_camera(self.camera)), None
        else:
            raw = formats.read_array(path)
            source = source_of(path, raw.shape, camera, self.bank)
            depth = images.depth_of_array(
                raw, str(path), camera=check_camera(source.camera), depth_unit=source.depth_unit,
                check_range=source.stated or not reproject,
            )  # fmt: skip
            view = view_of(source.camera, self.camera, depth, reproject=reproject)
        return image_of_depth(depth, self.camera, view=view, where=str(path)).image

    # The goal.

    @property
    def goal(self) -> Float[np.ndarray, "H W"] | None:
        """(H, W) image I that is wanted; None without a bed.

        What was drawn is held to what the bed can give: its depth, the range, slopes that stand.
        """
        if self._goal is None and self.bed is not None:
            self._goal = self.bed if self._base is None else self._base
            if self.marks:
                below = bed_map(self.depth_of(self._goal), self.camera)
                limits = Limits(math.tan(float(self._material.repose)))  # as loose material lies
                made = make_goal(below, wanted(below, self.marks), limits)
                self._told = report(made, self._material)
                self._goal = self._image(made.depth)
        return self._goal

    @property
    def told(self) -> list[str]:
        """What of the drawing cannot be, and what no action can do about it, in sentences."""
        found = self._told if self.marks and self.goal is not None else {}
        lines = [*found.get("says", [])[1:], *found.get("warnings", [])]
        return [line.split("; --")[0] for line in lines]  # options of the command line

    @property
    def pixels_per_mm(self) -> float:
        """On the bed, in its middle; 1 without a bed."""
        if self.bed is None:
            return 1.0
        return float(self.camera.fx) / (1e3 * float(np.median(self.depth_of(self.bed))))

    @property
    def _material(self) -> Material:
        return MATERIALS[self.material]

    def load_goal(self, path: Path, camera: str | None = None, *, reproject: bool = False) -> None:
        """Take a depth image, PLY or PCD file for the goal; what was drawn is dropped.

        Raises:
          JShapeError: as for `jshape plan`.
        """
        self.check_free()
        self.want(self._read(path, camera, reproject))

    def want(self, image: Float[np.ndarray, "H W"]) -> None:
        """Take an image I of the bank's camera for the goal; what was drawn is dropped."""
        self._base, self.marks = image, ()
        self._changed()

    def draw(self, mark: Mark) -> None:
        """Draw on the goal.

        Raises:
          JShapeError: a mark that makes no sense, no bed yet, or more than `MOST_MARKS`.
        """
        self.check_free()
        if self.bed is None:
            raise JShapeError("there is no bed to draw on yet")
        if len(self.marks) == MOST_MARKS:
            raise JShapeError(f"a drawing has at most {MOST_MARKS} marks")
        before, self.marks = self.marks, (*self.marks, check_mark(mark, self.camera))
        self._changed()
        try:
            _ = self.goal
        except JShapeError:
            self.marks = before
            self._changed()
            raise

    def undo(self) -> None:
        """Take the last mark back; without any, the loaded goal."""
        self.check_free()
        if self.marks:
            self.marks = self.marks[:-1]
        else:
            self._base = None
        self._changed()

    def clear(self) -> None:
        """The goal is the bed as it is."""
        self.check_free()
        self._base, self.marks = None, ()
        self._changed()

    @property
    def to_move_cm3(self) -> tuple[float, float]:
        """Volume that the goal takes away, and that it brings, cm3."""
        if self.bed is None or self.goal is None:
            return 0.0, 0.0
        before, after = self.depth_of(self.bed), self.depth_of(self.goal)
        area = before**2 / (float(self.camera.fx) * float(self.camera.fy))  # of a pixel, m2
        change = (after - before) * area * 1e6
        return float(change.clip(0).sum()), float((-change).clip(0).sum())

    # The plan.

    @property
    def distance_mm(self) -> float:
        """Between the bed and the goal; 0 without a bed."""
        if self.bed is None or self.goal is None:
            return 0.0
        return float(metric.to_mm(metric.distance(self.bed, self.goal), self.camera))

    def make_plan(self, **options: Any) -> Plan:
        """Plan from the bed to the goal; `options` are those of `jshape.plan`.

        Raises:
          JShapeError: there is no bed, or as for `jshape.plan`.
        """
        self.check_free()
        bed, goal = self._both()
        if np.array_equal(bed, goal):
            raise JShapeError("the goal is the bed as it is: draw, write or load one first")
        usual = {"stride": STRIDE, "strengths": STRENGTHS, "min_gain": self._per_mm * MIN_GAIN_MM}
        self._keep(plan(bed, goal, bank=self.bank, **(usual | options)))
        assert self.plan is not None
        return self.plan

    def drop(self, step: int) -> None:
        """Leave an action out (counted from 0)."""
        self.check_free()
        order = [k for k in range(self._count(step)) if k != step]
        self._again(order, select=min(self.selected, len(order)))

    def move(self, step: int, by: int) -> None:
        """Do an action earlier (-1) or later (1)."""
        self.check_free()
        count = self._count(step)
        to = min(max(step + by, 0), count - 1)
        order = [k for k in range(count) if k != step]
        order.insert(to, step)
        self._again(order, select=to + 1)

    def put(self, step: int, position: tuple[float, float]) -> None:
        """Move the place of an action to pixel (u, v)."""
        self.check_free()
        count = self._count(step)
        u, v = position
        inside = (min(max(u, 0.0), self.camera.width - 1), min(max(v, 0.0), self.camera.height - 1))
        self._again(list(range(count)), {step: {"position": inside}}, select=step + 1)

    def deepen(self, step: int, strength: float) -> None:
        """Do an action so many times as deep as trained.

        Raises:
          JShapeError: no strength that a plan may have.
        """
        self.check_free()
        count = self._count(step)
        self._again(list(range(count)), {step: {"strength": strength}}, select=step + 1)

    def add(self, action: str, position: tuple[float, float], strength: float = 1.0) -> None:
        """Append an action.

        Raises:
          JShapeError: no such action, place or strength.
        """
        self.check_free()
        self._both()
        if self.plan is None:
            self._rolled([], [], [], [])
        found = self.plan
        assert found is not None
        self._rolled(
            [*found.actions, action], [*found.exact_positions.tolist(), list(position)],
            [*found.strengths.tolist(), strength], [*found.yaws.tolist(), 0.0],
        )  # fmt: skip
        self.selected = len(found.actions) + 1

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
                plans.write_plan(temp / "plan.json", self.plan)

    def follow(self, ahead: Plan) -> None:
        """Show what a run is about to do: what is left of its plan, the next action selected."""
        self.plan, self.selected = ahead, min(1, len(ahead))
        self.version += 1

    # Helpers.

    def check_free(self) -> None:
        """Whether the desk may be changed.

        Raises:
          JShapeError: a run goes on.
        """
        if self.locked:
            raise JShapeError(self.locked)

    def depth_of(self, image: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
        """Metres, of an image I."""
        return np.asarray(self.camera.depth(metric.unweigh(image, self.camera)))

    def _image(self, depth: np.ndarray) -> np.ndarray:
        level = self.camera.luminance(depth, quantize=False)
        return np.asarray(metric.weigh(level, self.camera))

    @property
    def _per_mm(self) -> float:
        return 1.0 / float(metric.to_mm(1.0, self.camera))

    def _both(self) -> tuple[np.ndarray, np.ndarray]:
        bed, goal = self.bed, self.goal
        if bed is None or goal is None:
            raise JShapeError("there is no bed yet: load one, or look with a camera")
        return bed, goal

    def _count(self, step: int) -> int:
        count = len(self.plan) if self.plan else 0
        if not 0 <= step < count:
            raise JShapeError(f"action {step + 1} of a plan of {count}")
        return count

    def _again(
        self, order: list[int], changes: dict[int, dict[str, Any]] | None = None, *, select: int
    ) -> None:
        """The plan with its actions in another order or changed, predicted anew."""
        found = self.plan
        assert found is not None
        changes = changes or {}

        def value(k: int, name: str, now: Any) -> Any:
            return changes.get(k, {}).get(name, now)

        self._rolled(
            [found.actions[k] for k in order],
            [value(k, "position", found.exact_positions[k].tolist()) for k in order],
            [value(k, "strength", float(found.strengths[k])) for k in order],
            [float(found.yaws[k]) for k in order],
        )
        self.selected = select

    def _rolled(
        self, actions: list[str], positions: list, strengths: list[float], yaws: list[float]
    ) -> None:
        bed, goal = self._both()
        found = rollout(
            bed, goal, actions, positions, strengths=strengths, yaws=yaws, bank=self.bank
        )
        self._keep(found)

    def _keep(self, found: Plan) -> None:
        self.plan, self.selected = found, 0
        self.version += 1

    def _changed(self) -> None:
        """The bed or the goal is another: what was planned for it no longer holds."""
        self._goal = None
        self._no_plan()

    def _no_plan(self) -> None:
        self.plan, self.selected = None, 0
        self.version += 1
