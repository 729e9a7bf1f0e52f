"""The tab where a goal is drawn, a plan made and edited, and carried out."""

from collections.abc import Callable
from functools import partial

import numpy as np
from nicegui import events, ui

from jshape.app.acting_panel import ActingPanel
from jshape.app.advice import next_step
from jshape.app.bed_scene import BedScene
from jshape.app.bench import Bench
from jshape.app.curve import Curve
from jshape.app.desk import Desk
from jshape.app.image_panel import VIEWS, ImagePanel
from jshape.app.loading_panel import LoadingPanel
from jshape.app.plan_panel import PlanPanel

POLL = 0.4
"""Seconds between two looks whether the desk has changed."""
EXAGGERATE = 2.0
"""Heights in 3-D are drawn so many times as high."""
KEYS = (
    "Keys: left and right step through the plan, Delete drops the action, [ and ] do it earlier "
    "or later, 1 to 4 choose the view, Ctrl-Z takes a mark back, Escape is STOP."
)


class MoldPage:
    """One browser's view of the desk."""

    def __init__(self, desk: Desk, bench: Bench):
        """Build the tab's content where the caller is."""
        self._desk, self._bench = desk, bench
        self._shown = -1  # version of the desk
        self.in_front: Callable[[], bool] = lambda: True
        """Whether keys are for this tab."""
        self._ready = False
        self._hint = ui.label().classes("w-full text-sm bg-blue-50 px-2 py-1")
        self._hint.props("data-name=hint")
        with ui.element("div").classes("studio-columns w-full"):
            with ui.column().classes("gap-1"):
                self._image = ImagePanel(desk, bench, self.show)
            with ui.column().classes("gap-1"):
                with self._folded("Plan", True):
                    self._plan = PlanPanel(desk, bench, self.show, self._select)
                with self._folded("Carry out", False):
                    ActingPanel(desk, bench)
                with self._folded("Bed and goal", True):
                    self._loading = LoadingPanel(desk, bench, self.show)
            with ui.column().classes("gap-1"):
                self._build_scene()
        ui.label(KEYS).classes("text-xs text-gray-600 gt-xs")
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"])
        self._ready = True
        ui.timer(POLL, self._follow)
        self.show()

    @staticmethod
    def _folded(title: str, open_: bool) -> ui.expansion:
        return ui.expansion(title, value=open_).classes("w-full").props("dense")

    def _build_scene(self) -> None:
        self._scene = BedScene(self._desk.camera).classes("w-full").style("height: 260px")
        said = ui.label(f"the same in 3-D, heights x{EXAGGERATE:g}; drag to turn")
        said.classes("text-xs text-gray-600")
        self._curve = Curve("to the goal (mm)", ["predicted"])

    def show(self) -> None:
        """Draw all that may have changed."""
        if not self._ready:
            return
        self._shown = self._desk.version
        self._hint.text = next_step(self._desk)
        self._loading.show()
        self._plan.show()
        self._show_curve()
        self._image.show()
        self._show_bed()

    def _follow(self) -> None:
        """Draw what a run or another window has changed."""
        if self._shown != self._desk.version:
            self.show()

    def _show_curve(self) -> None:
        plan, done = self._desk.plan, self._desk.selected
        self._curve.show({} if plan is None else {"predicted": plan.distances_mm.tolist()}, done)

    def _show_bed(self) -> None:
        depth, rgb = self._image.depth, self._image.rgb
        if depth is not None and rgb is not None:
            self._scene.use(self._desk.camera)
            level = float(np.median(depth))
            self._scene.show(depth, rgb, level=level, exaggeration=EXAGGERATE)

    def _select(self, done: int) -> None:
        self._desk.select(done)
        if self._desk.plan is not None and self._image.view in ("bed", "goal"):
            self._image.look_at("predicted")
        self.show()

    async def _key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown or not self.in_front():
            return
        key, desk = event.key, self._desk
        step = desk.selected - 1
        if key.arrow_right or key.arrow_left:
            self._select(desk.selected + (1 if key.arrow_right else -1))
        elif key.delete and step >= 0:
            await self._bench.guard("predicting", partial(desk.drop, step), self.show)
        elif key.name in ("[", "]") and step >= 0:
            by = -1 if key.name == "[" else 1
            await self._bench.guard("predicting", partial(desk.move, step, by), self.show)
        elif key.name in ("1", "2", "3", "4"):
            self._image.look_at(VIEWS[int(key.name) - 1])
        elif key.name == "z" and event.modifiers.ctrl:
            await self._bench.guard("taking back", desk.undo, self.show)
