"""A bed and the goal that is drawn on it, in the image of one camera.  No browser here.

Methods raise a JShapeError, in one line for people, and then have changed nothing.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jshape import metric
from jshape._typing import Float
from jshape.app.drawing import Mark, check_mark, wanted
from jshape.camera import Camera
from jshape.errors import JShapeError
from jshape.goals import Limits, bed_map, make_goal, report
from jshape.sim import MATERIALS

MOST_MARKS = 500
"""Of a drawing."""


@dataclass(kw_only=True)
class GoalState:
    """What is there and what is wanted."""

    material: str = "flour"
    """What the bed is of: walls that are drawn are as steep as it stands."""
    bed: np.ndarray | None = None
    """(H, W) image I of the bed now."""
    came_from: str = ""
    """Where the bed is from, for people."""
    marks: tuple[Mark, ...] = ()
    """What was drawn, in its order."""
    locked: str = ""
    """Why nothing may be changed now: a run goes on.  "" allows it."""
    version: int = 0
    """Grows with every change: pages that show another one draw anew."""
    _base: np.ndarray | None = None  # (H, W) the goal under the drawing; None: the bed
    # Of which bed, base and marks; the goal; the report on what was drawn.  Set at once: a thread
    # that asks while another draws gets a whole one.
    _made: tuple[tuple[Any, ...], np.ndarray | None, dict[str, Any]] = ((None, None, ()), None, {})

    @property
    def camera(self) -> Camera:
        """That sees it."""
        raise NotImplementedError

    def see(
        self, image: Float[np.ndarray, "H W"], came_from: str, *, same_goal: bool = False
    ) -> None:
        """Take an image I for the bed; the drawing goes onto it, or `same_goal` stays as it was."""
        if same_goal and self.goal is not None:
            self._base, self.marks = self.goal, ()
        self.bed, self.came_from = image, came_from
        self._changed()

    @property
    def goal(self) -> Float[np.ndarray, "H W"] | None:
        """(H, W) image I that is wanted; None without a bed.

        What was drawn is held to what the bed can give: its depth, the range, slopes that stand.
        """
        return self._held[1]

    @property
    def _held(self) -> tuple[tuple[Any, ...], np.ndarray | None, dict[str, Any]]:
        bed, base, marks = of = self.bed, self._base, self.marks
        made = self._made
        if any(one is not other for one, other in zip(of, made[0], strict=True)):
            goal, told = bed if base is None or bed is None else base, {}
            if goal is not None and marks:
                below = bed_map(self.depth_of(goal), self.camera)
                material = MATERIALS[self.material]
                limits = Limits(math.tan(float(material.repose)))  # as loose material lies
                held = make_goal(below, wanted(below, marks), limits)
                told = report(held, material)
                level = self.camera.luminance(held.depth, quantize=False)
                goal = np.asarray(metric.weigh(level, self.camera))
            made = self._made = of, goal, told
        return made

    @property
    def warnings(self) -> list[str]:
        """What of the drawing cannot be, and what no action can do about it, in sentences."""
        found = self._held[2]
        lines = [*found.get("says", [])[1:], *found.get("warnings", [])]
        return [line.split("; --")[0] for line in lines]  # options of the command line

    @property
    def pixels_per_mm(self) -> float:
        """On the bed, in its middle; 1 without a bed."""
        if self.bed is None:
            return 1.0
        return float(self.camera.scale(np.median(self.depth_of(self.bed)))[0]) / 1e3

    def want(self, image: Float[np.ndarray, "H W"]) -> None:
        """Take an image I of the bank's camera for the goal; what was drawn is dropped."""
        self._base, self.marks = image, ()
        self._changed()

    def draw(self, mark: Mark) -> None:
        """Draw on the goal."""
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
        self._check_drawn()
        if self.marks:
            self.marks = self.marks[:-1]
        else:
            self._base = None
        self._changed()

    def clear(self) -> None:
        """The goal is the bed as it is."""
        self._check_drawn()
        self._base, self.marks = None, ()
        self._changed()

    def both(self) -> tuple[np.ndarray, np.ndarray]:
        """The bed and the goal."""
        bed, goal = self.bed, self.goal
        if bed is None or goal is None:
            raise JShapeError("there is no bed yet: load one, or look with a camera")
        return bed, goal

    @property
    def changed(self) -> bool:
        """Whether the goal asks for anything."""
        return self.bed is not None and not np.array_equal(*self.both())

    def check_changed(self) -> None:
        """Refuse to work towards a goal that asks for nothing."""
        self.both()
        if not self.changed:
            raise JShapeError("the goal is the bed as it is: draw, write or load one first")

    @property
    def to_move_cm3(self) -> tuple[float, float]:
        """Volume that the goal takes away, and that it brings, cm3."""
        before, after = (self.depth_of(image) for image in self.both())
        across, along = self.camera.scale(before)
        area = 1.0 / (across * along)  # of a pixel, m2
        change = (after - before) * area * 1e6
        return float(change.clip(0).sum()), float((-change).clip(0).sum())

    @property
    def distance_mm(self) -> float:
        """Between the bed and the goal."""
        return float(metric.to_mm(metric.distance(*self.both()), self.camera))

    def lock(self, why: str) -> None:
        """Allow no change, or all of them again: ""."""
        if why != self.locked:
            self.locked = why
            self.version += 1

    def check_free(self) -> None:
        """Refuse a change while a run goes on."""
        if self.locked:
            raise JShapeError(self.locked)

    def _check_drawn(self) -> None:
        self.check_free()
        if self._base is None and not self.marks:
            raise JShapeError("nothing is drawn or loaded: the goal is the bed as it is")

    def depth_of(self, image: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
        """Metres, of an image I."""
        return np.asarray(self.camera.depth(metric.unweigh(image, self.camera)))

    def _changed(self) -> None:
        """The bed or the goal is another."""
        self.version += 1
