"""The image of bed, goal, prediction or difference, and what one draws on it."""

from collections.abc import Callable
from functools import partial

import numpy as np
from nicegui import events, ui

from jshape.studio import pictures
from jshape.studio.bench import Bench
from jshape.studio.desk import Desk
from jshape.studio.drawing import Mark, Stroke, Words

VIEWS = ("bed", "goal", "predicted", "difference")
TOOLS = {"look": "look", "draw": "draw", "write": "write", "place": "move the selected action"}
"""What a press on the image does; drawing and writing change the goal."""


class ImagePanel:
    """Shows one of `VIEWS`; the pointer reads heights, draws, writes, moves an action."""

    def __init__(self, desk: Desk, bench: Bench, changed: Callable[[], None]):
        """Build it where the caller is; `changed` is called when the desk was."""
        self._desk, self._bench, self._changed = desk, bench, changed
        self.view, self._tool = "bed", "look"
        self.depth: np.ndarray | None = None
        """(H, W) metres, of what is shown."""
        self.rgb: np.ndarray | None = None
        """(H, W, 3) its colours."""
        self._line: list[tuple[float, float]] = []  # the brush's way so far
        self._read_mm: np.ndarray | None = None  # what the pointer reads
        camera = desk.camera
        self._views = ui.toggle(list(VIEWS), value=self.view, on_change=self._viewed)
        self._views.props("dense no-caps aria-label=view")
        self._image = ui.interactive_image(
            size=(camera.width, camera.height), cross="#ffffff80", on_mouse=self._mouse,
            events=["mousedown", "mousemove", "mouseup", "mouseleave"],
        )  # fmt: skip
        self._image.style("width: 480px; border: 1px solid #999").props("data-name=image")
        self._under = ui.label().classes("text-sm").props("data-name=under")
        tools = ui.toggle(TOOLS, value=self._tool, on_change=self._tooled)
        tools.props("dense no-caps aria-label=tool")
        with ui.row().classes("items-end gap-2 no-wrap"):
            self._down = ui.number("down (mm), or -up", value=8.0, min=-40, max=40, step=1)
            self._width = ui.number("brush (mm)", value=20.0, min=2, max=100, step=2)
            self._text = ui.input("text", value="J").on("keydown.enter", lambda: self._write(None))
            self._size = ui.number("long (mm)", value=120.0, min=10, max=500, step=10)
            boxes = self._down, self._width, self._text, self._size
            for box, width in zip(boxes, (8.5, 6, 5, 6), strict=True):
                box.props("dense").style(f"width: {width}em")
            for words, act in (("undo", desk.undo), ("clear", desk.clear)):
                button = ui.button(words, on_click=partial(bench.guard, "drawing", act, changed))
                button.props("dense no-caps outline")

    def look_at(self, view: str) -> None:
        """Show another of `VIEWS`."""
        self._views.value = view

    def show(self) -> None:
        """Draw what may have changed."""
        desk = self._desk
        image, plan = self._shown(), desk.plan
        if image is None:
            return
        self.depth = desk.depth_of(image)
        self._read_mm = 1e3 * self.depth
        goal = desk.goal
        if self.view == "difference" and goal is not None:
            self._read_mm = self._read_mm - 1e3 * desk.depth_of(goal)
            self.rgb = pictures.differing(-self._read_mm)
        else:
            self.rgb = pictures.shaded(self.depth)
        self._image.set_source(pictures.data_url(self.rgb))
        self._image.content = "" if plan is None else pictures.boxes(plan, desk.selected - 1)

    def _shown(self) -> np.ndarray | None:
        """The image I that is looked at; `difference` is that of the predicted one to the goal."""
        desk = self._desk
        if desk.bed is None or self.view == "bed":
            return desk.bed
        if self.view == "goal":
            return desk.goal
        return desk.bed if desk.plan is None else desk.plan.images[desk.selected]

    def _viewed(self) -> None:
        self.view = str(self._views.value)
        self._changed()

    def _tooled(self, event: events.ValueChangeEventArguments) -> None:
        self._tool = str(event.value)
        if self._tool in ("draw", "write"):
            self.look_at("goal")

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        at = (event.image_x, event.image_y)
        if event.type == "mousemove" and not self._line:
            self._read(at)
        if self._desk.bed is None:
            return
        if self._tool == "draw":
            await self._brush(event.type, at)
        elif self._tool == "write" and event.type == "mouseup":
            await self._write(at)
        elif self._tool == "place" and event.type == "mouseup" and self._desk.selected:
            step = self._desk.selected - 1
            work = partial(self._desk.put, step, at)
            await self._bench.guard("predicting", work, self._changed)

    def _read(self, at: tuple[float, float]) -> None:
        if self._read_mm is not None:
            v, u = (
                int(np.clip(x, 0, size - 1))
                for x, size in zip(at[::-1], self._read_mm.shape, strict=True)
            )
            what = "too low" if self.view == "difference" else "from the camera"
            self._under.text = f"({u}, {v}): {self._read_mm[v, u]:.1f} mm {what}"

    async def _brush(self, kind: str, at: tuple[float, float]) -> None:
        if kind == "mousedown":
            self._line = [at]
        elif self._line and kind == "mousemove":
            self._line.append(at)
            width = float(self._width.value or 20) * self._desk.pixels_per_mm
            self._image.content = pictures.line(self._line, width, "#ff8800")
        elif self._line:  # the button is up, or the mouse has left
            line, self._line = tuple(self._line), []
            await self._mark(
                Stroke(line, float(self._width.value or 0), float(self._down.value or 0))
            )

    async def _write(self, at: tuple[float, float] | None) -> None:
        """The text at a place, or in the middle."""
        camera = self._desk.camera
        at = at or ((camera.width - 1) / 2, (camera.height - 1) / 2)
        size, down = float(self._size.value or 0), float(self._down.value or 0)
        self.look_at("goal")
        await self._mark(Words(str(self._text.value), at, size, down))

    async def _mark(self, mark: Mark) -> None:
        await self._bench.guard("drawing", lambda: self._desk.draw(mark), self._changed)
