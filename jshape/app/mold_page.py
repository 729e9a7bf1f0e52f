"""The tab where a goal is drawn, a plan made and edited, and carried out."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.acting_panel import ActingPanel
from jshape.app.advice import next_step
from jshape.app.bench import Bench
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


COLUMNS = """
.studio-columns { display: grid; gap: 12px; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 340px), 1fr)); }
.studio-columns > * { min-width: 0; max-width: 640px; }
.studio-wide { width: 100% !important; height: 260px !important; }
"""
"""As many columns as the screen has room for; one on a telephone."""


class MoldPage:
    """One browser's view of the desk."""

    def __init__(self, desk: Desk, bench: Bench):
        """Build the tab's content where the caller is."""
        self._desk, self._bench = desk, bench
        self._shown = -1  # version of the desk
        self.in_front: Callable[[], bool] = lambda: True
        """Whether keys are for this tab."""
        self._points: Any = None
        self._ready = False
        ui.add_css(COLUMNS)
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
        self._scene = ui.scene(width=340, height=260, grid=False, background_color="#eef1f4")
        self._scene.classes("studio-wide")
        self._scene.move_camera(x=0, y=-3.4, z=2.9, look_at_x=0, look_at_y=-0.25, look_at_z=0)
        said = ui.label(f"the same in 3-D, heights x{EXAGGERATE:g}; drag to turn")
        said.classes("text-xs text-gray-600")
        self._curve = ui.echart(_curve_options()).classes("w-full").style("height: 230px")

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
        self._show_cloud()

    def _follow(self) -> None:
        """Draw what a run or another window has changed."""
        if self._shown != self._desk.version:
            self.show()

    def _show_curve(self) -> None:
        plan, done = self._desk.plan, self._desk.selected
        d = [] if plan is None else [round(float(mm), 4) for mm in plan.distances_mm]
        line, point = self._curve.options["series"]
        line["data"] = [[k, mm] for k, mm in enumerate(d)]
        point["data"] = [[done, d[done]]] if d else []
        self._curve.update()

    def _show_cloud(self) -> None:
        depth, rgb = self._image.depth, self._image.rgb
        if depth is None or rgb is None:
            return
        x, y = (np.asarray(axis) for axis in self._desk.camera.rays())
        points = np.stack(np.broadcast_arrays(x * depth, y * depth, depth), -1)
        xyz, colours = pictures.cloud(points, rgb, EXAGGERATE)
        with self._scene:
            if self._points is not None:
                self._points.delete()
            self._points = self._scene.point_cloud(xyz, colours, point_size=0.05)

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


def _curve_options() -> dict[str, Any]:
    axis = {"nameLocation": "middle", "nameTextStyle": {"fontSize": 12}}
    return {
        "animation": False,
        "grid": {"left": 55, "right": 15, "top": 15, "bottom": 40},
        "xAxis": axis | {"type": "value", "name": "actions done", "nameGap": 24, "minInterval": 1},
        "yAxis": axis | {"type": "value", "name": "to the goal (mm)", "nameGap": 38, "min": 0},
        "series": [
            {"type": "line", "data": [], "symbolSize": 7},
            {"type": "scatter", "data": [], "symbolSize": 14, "itemStyle": {"color": "#d62728"}},
        ],
    }
