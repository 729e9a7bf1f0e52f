"""The image of bed, goal, prediction or difference, and what one draws on it."""

from collections.abc import Callable
from functools import partial

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.advice import first_stroke, how_near
from jshape.app.context import AppContext
from jshape.app.drawing import BrushStroke, Mark, Words
from jshape.app.editor_state import EditorState
from jshape.app.widgets import POINTER, buttons, small
from jshape.planning.limit import Limit

VIEWS = ("bed", "goal", "predicted", "difference")
TOOLS = {"draw": "draw", "write": "write", "place": "move action", "look": "only look"}
"""What a press on the image does; drawing and writing change the goal."""
HINTS = {
    "draw": "Drag over the image: a trench as wide and as deep as below; negative depths raise.",
    "write": "Press where the middle of the text goes, or Enter in its field: the middle.",
    "place": "Press where the selected action of the plan is to be done instead.",
    "look": "The pointer reads heights; nothing is changed.",
}


class ImagePanel:
    """Shows one of `VIEWS`; the pointer reads heights, draws, writes, moves an action."""

    def __init__(self, editor: EditorState, context: AppContext, changed: Callable[[], None]):
        """Build it where the caller is; `changed` is called when the state was."""
        self._editor, self._context, self._changed = editor, context, changed
        self.view, self._tool = "bed", "draw"
        self.depth: np.ndarray | None = None
        """(H, W) metres, of what is shown."""
        self.rgb: np.ndarray | None = None
        """(H, W, 3) its colours."""
        self._line: list[tuple[float, float]] = []  # the brush's way so far
        self._read_mm: np.ndarray | None = None  # what the pointer reads
        self._half_mm: np.ndarray | None = None  # how far the truth may be from it
        self._views = ui.toggle(list(VIEWS), value=self.view, on_change=self._viewed)
        self._views.props("aria-label=view")
        self._image = ui.interactive_image(cross="#ffffff80", on_mouse=self._mouse, events=POINTER)
        self._image.classes("w-full").style("border: 1px solid #999").props("data-name=image")
        with ui.row().classes("w-full no-wrap items-center gap-2 text-xs").props("data-name=bar"):
            self._low = ui.label()
            self._colours = ui.element("div").classes("grow").style("height: 10px")
            self._high = ui.label()
        self._under = small("", "under", "").style("min-height: 1.3em")
        tools = ui.toggle(TOOLS, value=self._tool, on_change=self._tooled)
        tools.props("aria-label=tool")
        self._hint = small(HINTS[self._tool])
        wide, deep = first_stroke(editor.bank, editor.pixels_per_mm)
        with ui.row().classes("w-full items-end gap-2"):
            said = "How far a stroke or a text sinks the bed; below 0 it raises it"
            self._down = _field("depth down", deep, -100, 100, 1, said)
            self._width = _field("brush width", wide, 2, 100, 2, "Of the trench, at its floor")
            self._size = _field("text length", 150.0, 10, 500, 10, "Of the text's longer side")
            self._text = ui.input("text", value="J").on("keydown.enter", lambda: self._write(None))
            self._text.style("width: 4em").tooltip("What write puts on the bed")
            undo, clear = partial(self._edit, editor.undo), partial(self._edit, editor.clear)
            buttons(
                ("undo", undo, "Take the last stroke or text back (Ctrl-Z)"),
                ("clear", clear, "Take everything back: the goal is the bed as it is"),
                props="outline",
            )
        with small("", "limit", "") as self._near:
            self._holds = ui.tooltip("").style("max-width: 320px")
        with ui.row().classes("w-full items-center gap-x-3 gap-y-0 text-xs") as self._why:
            self._marks = ui.checkbox("mark where", value=True, on_change=self.show)
            self._marks.tooltip("On the goal: where even fractions of actions leave over 0.5 mm")
            self._causes = ui.row().classes("items-center gap-x-1 gap-y-0")
        self._why.set_visibility(False)
        self._limit: Limit | str = ""
        self._stroked()

    def look_at(self, view: str) -> None:
        """Show another of `VIEWS`."""
        self._views.value = view

    def show(self) -> None:
        """Draw what may have changed."""
        editor = self._editor
        self._tell()
        image, bed, goal = self._shown(), editor.bed, editor.goal
        height, width = editor.camera.shape
        self._image.props["size"] = (width, height)  # another bank's camera makes another image
        if image is None or bed is None or goal is None:
            self._under.text = "no bed yet"
            return
        self.depth, plan = editor.depth_of(image), editor.plan
        self._half_mm = None
        if plan is not None and self.view in ("predicted", "difference"):
            self._half_mm = plan.half_widths_after(editor.selected)
        first, wanted = editor.depth_of(bed), editor.depth_of(goal)
        level = float(np.median(first))
        if self.view == "difference":
            self._read_mm = 1e3 * (wanted - self.depth)
            scale = pictures.difference_scale(1e3 * (wanted - first))
            self.rgb = pictures.differing(self._read_mm, scale)
            ends = f"{-scale.low:.1f} mm too low", f"{scale.high:.1f} mm too high"
        else:
            self._read_mm = 1e3 * (level - self.depth)
            scale = pictures.height_scale(*(1e3 * (level - depth) for depth in (first, wanted)))
            self.rgb = pictures.shaded(self._read_mm, scale)
            ends = f"{scale.low:+.1f} mm", f"{scale.high:+.1f} mm above the bed's level"
        self._low.text, self._high.text = ends
        self._colours.style(f"background: {scale.gradient}")
        shown = self.rgb
        if self.view == "goal" and self._marks.value and not isinstance(self._limit, str):
            shown = pictures.marked(shown, self._limit.causes)
        self._image.set_source(pictures.data_url(shown))
        self._image.content = self._boxes()
        if self.view == "predicted" and editor.plan is None:
            self._under.text = "no plan yet: this is the bed as it is"

    def follow(self) -> None:
        """Show how near any plan can come, once that is known."""
        if self._context.limit.ask(self._editor) != self._limit:
            self.show()

    def _tell(self) -> None:
        """How near any plan can come, and why not nearer."""
        found = self._context.limit.ask(self._editor)
        if found == self._limit:
            return
        self._limit, self._near.text, shares = found, how_near(found), {}
        if not isinstance(found, str):
            shares, self._holds.text = found.shares, f"It holds {found.strongest.holds}"
        self._holds.set_visibility(not isinstance(found, str) and found.proves)
        self._why.set_visibility(bool(shares))
        self._causes.clear()
        with self._causes:
            for cause, share in shares.items():
                swatch = ui.element("div").style(f"background: {pictures.stripes(cause)}")
                swatch.style("width: 20px; height: 12px")
                ui.label(f"{cause} {share:.0%}").classes("mr-2")

    def _boxes(self) -> str:
        plan = self._editor.plan
        return "" if plan is None else pictures.boxes(plan, self._editor.selected - 1)

    def _shown(self) -> np.ndarray | None:
        """The image I that is looked at; `difference` is that of the predicted one to the goal."""
        editor = self._editor
        if editor.bed is None or self.view == "bed":
            return editor.bed
        if self.view == "goal":
            return editor.goal
        return editor.bed if editor.plan is None else editor.plan.images[editor.selected]

    def _viewed(self) -> None:
        self.view = str(self._views.value)
        self._changed()

    def _tooled(self, event: events.ValueChangeEventArguments) -> None:
        self._tool = str(event.value)
        self._hint.text = HINTS[self._tool]
        self._stroked()
        if self._tool in ("draw", "write"):
            self.look_at("goal")

    def _stroked(self) -> None:
        """A finger that draws must not move the page."""
        self._image.style(f"touch-action: {'none' if self._tool == 'draw' else 'auto'}")

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        at, up = (event.image_x, event.image_y), event.type == "pointerup"
        if event.type == "pointermove" and not self._line:
            self._read(at)
        if self._editor.bed is None:
            if up:
                ui.notify("there is no bed to draw on yet: load one first", type="warning")
        elif self._tool == "draw":
            await self._brush(event.type, at)
        elif self._tool == "write" and up:
            await self._write(at)
        elif self._tool == "place" and up:
            await self._place(at)

    async def _place(self, at: tuple[float, float]) -> None:
        step = self._editor.selected - 1
        if step < 0:
            ui.notify("select an action of the plan first: press its line", type="warning")
            return
        await self._edit(partial(self._editor.change, step, position=at))

    def _read(self, at: tuple[float, float]) -> None:
        if self._read_mm is None or self.depth is None:
            return
        height, width = self.depth.shape
        u, v = int(np.clip(at[0], 0, width - 1)), int(np.clip(at[1], 0, height - 1))
        mm = float(self._read_mm[v, u])
        if self.view == "difference":
            said = f"{abs(mm):.1f} mm too {'high' if mm > 0 else 'low'}"
        else:
            said = f"{abs(mm):.1f} mm {'above' if mm > 0 else 'below'} the bed's level"
        if self._half_mm is not None and (half := float(self._half_mm[v, u])) > 0:
            said += f" (80 %: ±{half:.1f})"
        self._under.text = f"({u}, {v}) px: {said}, {1e3 * self.depth[v, u]:.1f} mm from the camera"

    async def _brush(self, kind: str, at: tuple[float, float]) -> None:
        if kind == "pointerdown":
            self._line = [at]
        elif kind == "pointercancel":  # the system took the finger
            self._line, self._image.content = [], self._boxes()
        elif self._line and kind == "pointermove":
            self._line.append(at)
            width = float(self._width.value or 20) * self._editor.pixels_per_mm
            self._image.content = pictures.line(self._line, width, "#ff8800")
        elif self._line:  # it is up, or has left
            line, self._line = tuple(self._line), []
            await self._mark(BrushStroke(line, _value(self._width), _value(self._down)))

    async def _write(self, at: tuple[float, float] | None) -> None:
        """The text at a place, or in the middle."""
        camera = self._editor.camera
        at = at or ((camera.width - 1) / 2, (camera.height - 1) / 2)
        await self._mark(Words(str(self._text.value), at, _value(self._size), _value(self._down)))

    async def _mark(self, mark: Mark) -> None:
        self.look_at("goal")
        await self._edit(partial(self._editor.draw, mark))

    async def _edit(self, change: Callable[[], None]) -> None:
        await self._context.do("changing it", change, self._changed)


def _field(label: str, value: float, least: int, most: int, step: int, said: str) -> ui.number:
    field = ui.number(label, value=value, min=least, max=most, step=step, suffix="mm")
    return field.style("width: 6.1em").tooltip(f"{said}, {least} to {most} mm")


def _value(field: ui.number) -> float:
    return float(field.value or 0)
