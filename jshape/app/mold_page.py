"""The tab where a goal is drawn, a plan made and edited, and carried out."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app.advice import next_step
from jshape.app.bed_scene import BedScene
from jshape.app.context import AppContext
from jshape.app.curve import Curve
from jshape.app.editor_state import EditorState
from jshape.app.image_panel import VIEWS, ImagePanel
from jshape.app.loading_panel import LoadingPanel
from jshape.app.plan_panel import PlanPanel
from jshape.app.run_panel import RunPanel
from jshape.app.widgets import FIELDS, small

POLL = 0.4
"""Seconds between two looks whether the state has changed."""
EXAGGERATE = 2.0
"""Heights in 3-D are drawn so many times as high."""
KEYS = (
    "Keys: left and right step through the plan, Delete drops the action, [ and ] do it earlier "
    "or later, 1 to 4 choose the view, Ctrl-Z takes a mark back, Escape is STOP."
)


class MoldPage:
    """One browser's view of the editor's state."""

    def __init__(self, editor: EditorState, context: AppContext):
        self._editor, self._context = editor, context
        self._shown = -1  # version of the state
        self.in_front: Callable[[], bool] = lambda: True
        """Whether keys are for this tab."""
        self._ready = False
        self._hint = ui.label().classes("w-full text-sm bg-blue-50 px-2 py-1")
        self._hint.props("data-name=hint")
        with ui.element("div").classes("studio-columns w-full"):
            with ui.column().classes("gap-1"):
                self._image = ImagePanel(editor, context, self.show)
            with ui.column().classes("gap-1"):
                with ui.expansion("Plan", value=True).classes("w-full"):
                    self._plan = PlanPanel(editor, context, self.show, self._select)
                with ui.expansion("Carry out").classes("w-full"):
                    RunPanel(editor, context)
                with ui.expansion("Bed and goal", value=True).classes("w-full"):
                    self._loading = LoadingPanel(editor, context, self.show)
            with ui.column().classes("gap-1"):
                self._scene = BedScene(editor.camera).classes("w-full").style("height: 260px")
                small(f"the same in 3-D, heights x{EXAGGERATE:g}; drag to turn")
                self._curve = Curve("to the goal (mm)", ["predicted"])
        small(KEYS).classes("gt-xs")
        ui.keyboard(on_key=self._key, ignore=FIELDS)
        self._ready = True
        ui.timer(POLL, self._follow)
        self.show()

    def show(self) -> None:
        """Draw all that may have changed."""
        if not self._ready:
            return
        editor, image = self._editor, self._image
        self._shown = editor.version
        self._hint.text = next_step(editor)
        for panel in (self._loading, self._plan, image):
            panel.show()
        distances = [] if editor.plan is None else editor.plan.distances_mm.tolist()
        self._curve.show({"predicted": distances}, editor.selected)
        if image.depth is not None and image.rgb is not None:
            self._scene.use(editor.camera)
            level = float(np.median(image.depth))
            self._scene.show(image.depth, image.rgb, level=level, exaggeration=EXAGGERATE)

    def _follow(self) -> None:
        if self._shown != self._editor.version:
            self.show()
        self._image.follow()

    def _select(self, done: int) -> None:
        self._editor.select(done)
        if self._editor.plan is not None and self._image.view in ("bed", "goal"):
            self._image.look_at("predicted")
        self.show()

    async def _key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown or not self.in_front():
            return
        key, editor = event.key, self._editor
        step = editor.selected - 1
        edits: dict[str, Any] = {"z": editor.undo} if event.modifiers.ctrl else {}
        if step >= 0:
            edits["Delete"] = partial(editor.drop, step)
            edits |= {name: partial(editor.move, step, by) for name, by in (("[", -1), ("]", 1))}
        if key.arrow_right or key.arrow_left:
            self._select(editor.selected + (1 if key.arrow_right else -1))
        elif key.name in edits:
            await self._context.do("changing it", edits[key.name], self.show)
        elif key.name in ("1", "2", "3", "4"):
            self._image.look_at(VIEWS[int(key.name) - 1])
