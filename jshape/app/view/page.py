"""A plan or a run on a page of its own: the bed in 3-D and from above, step by step."""

from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.bed_scene import BedScene
from jshape.app.curve import Curve
from jshape.app.pages import COLUMNS, serve_pages
from jshape.app.view.story import Story

PERIOD = 1.0
"""Seconds that a step is shown while it plays."""
BED, PREDICTED, GOAL, GAP, ERROR = "bed", "predicted", "goal", "bed - goal", "bed - predicted"
"""What can be shown."""
GOAL_ABOVE = 0.001
"""Metres that the goal is drawn higher than it is: where the bed is right, it lies over it."""
EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)])
"""(12, 2) corners of a box that an edge joins."""
CURVES = {"predicted": "predicted_mm", "obtained": "seen_mm", "effort": "effort_nm"}
"""Of each line: the field of a moment."""


def serve_story(story: Story, *, host: str, port: int, show: bool) -> None:
    """Serve until Ctrl-C; each browser steps for itself."""

    def build() -> None:
        ui.add_css(COLUMNS)
        StoryPage(story)

    serve_pages(build, title="jshape view", host=host, port=port, show=show)


class StoryPage:
    """One browser's view of a story."""

    def __init__(self, story: Story):
        """Build it where the caller is."""
        self._story, self._ready = story, False
        with ui.row().classes("w-full no-wrap items-stretch max-md:flex-wrap"):
            self._scene = BedScene(story.camera).classes("grow").props("data-name=scene")
            self._scene.style("min-width: min(100%, 340px); height: calc(100vh - 32px)")
            with ui.column().classes("gap-1 w-full md:w-[400px] md:shrink-0"):
                self._build_controls()
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"])
        self._timer = ui.timer(PERIOD, self._play, active=False)
        self._ready = True
        self._show()

    def _build_controls(self) -> None:
        story, last = self._story, len(self._story)
        ui.label(story.title).classes("text-base font-bold").props("data-name=title")
        for note in story.notes:
            ui.label(note).classes("text-sm")
        self._slider = ui.slider(min=0, max=max(last, 1), value=0, on_change=self._show)
        self._slider.props("label snap data-name=step").set_enabled(last > 0)
        with ui.row().classes("items-center gap-2"):
            for words, act in (
                ("back", lambda: self._go(-1)), ("play", self._start), ("next", lambda: self._go(1))
            ):  # fmt: skip
                ui.button(words, on_click=act).props("dense no-caps")
            self._choice = ui.select(self._choices(), value=BED, label="show", on_change=self._show)
            self._choice.props("dense").classes("grow").style("min-width: 9em")
        self._words = ui.label().classes("text-sm").props("data-name=words")
        self._image = ui.interactive_image().classes("w-full").props("data-name=picture")
        self._under = ui.label().classes("text-xs text-gray-600")
        with ui.row().classes("items-center gap-2 w-full no-wrap"):
            self._boxes = ui.checkbox("actions", value=True, on_change=self._show)
            self._over = ui.checkbox("goal over it", on_change=self._show)
            for box in (self._boxes, self._over):
                box.props("dense").classes("whitespace-nowrap")
            self._over.set_visibility(story.goal is not None)
            ui.label("height x").classes("text-sm whitespace-nowrap")
            self._tall = ui.slider(min=1, max=5, step=0.5, value=1, on_change=self._show)
            self._tall.props("label dense")
        self._plots = [
            (Curve(label, known, height=190), known)
            for label, names in (
                ("to the goal (mm)", ("predicted", "obtained")), ("effort (Nm)", ("effort",))
            )
            if (known := [name for name in names if np.isfinite(self._values(name)).any()])
        ]  # fmt: skip

    def _values(self, name: str) -> list[float]:
        values = [getattr(moment, CURVES[name]) for moment in self._story.moments]
        return [np.nan if value is None else float(value) for value in values]

    def _choices(self) -> list[str]:
        """What the story has to show."""
        story = self._story
        foretold = any(moment.predicted is not None for moment in story.moments)
        there = {BED: True, PREDICTED: foretold, GOAL: story.goal is not None}
        there |= {GAP: there[GOAL], ERROR: foretold and story.is_run}
        return [name for name, is_there in there.items() if is_there]

    @property
    def step(self) -> int:
        """The step that is shown."""
        return min(int(self._slider.value or 0), len(self._story))

    def _go(self, by: int) -> None:
        self._timer.deactivate()
        self._slider.value = min(max(self.step + by, 0), len(self._story))

    def _start(self) -> None:
        if self.step == len(self._story):
            self._slider.value = 0
        self._timer.active = not self._timer.active

    def _play(self) -> None:
        self._slider.value = min(self.step + 1, len(self._story))
        self._timer.active = self.step < len(self._story)

    def _key(self, event: events.KeyEventArguments) -> None:
        if event.action.keydown and (event.key.arrow_left or event.key.arrow_right):
            self._go(1 if event.key.arrow_right else -1)

    def _depth(self, step: int, name: str) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(H, W) depth to show, metres, and the differences to colour it with, mm, if any."""
        story = self._story
        bed, foretold = story.last(step), story.moments[step].predicted
        if name == GOAL:
            return story.goal, None
        if name == PREDICTED:
            return foretold, None
        if name == GAP:
            return bed, story.too_high_mm(bed, story.goal)
        if name == ERROR:
            seen = story.moments[step].seen
            gap = story.too_high_mm(seen, foretold)
            return (None if gap is None else seen), gap
        return bed, None

    def _show(self) -> None:
        """Draw the step that the slider stands at."""
        if not self._ready:
            return
        story, step = self._story, self.step
        depth, gap = self._depth(step, str(self._choice.value))
        known = "" if depth is not None else "; not known at this step"
        self._words.text = f"step {step} of {len(story)}: {story.moments[step].words}{known}"
        if gap is not None:
            scale = pictures.Scale(-story.reach_mm, story.reach_mm, pictures.DIFFERENCES)
            rgb = pictures.differing(gap, scale)
            self._under.text = f"red: too high, blue: too low, up to {story.reach_mm:.1f} mm"
        else:
            low, high = (1e3 * (story.level - x) for x in reversed(story.range_m))
            heights = np.full(story.camera.shape, np.nan) if depth is None else depth
            mm = 1e3 * (story.level - np.where(heights > 0, heights, np.nan))
            rgb = pictures.shaded(mm, pictures.Scale(low, high, pictures.HEIGHTS))
            self._under.text = f"dark to bright: {low:+.1f} to {high:+.1f} mm from the bed's level"
        acts = self._acts(step) if self._boxes.value else []
        self._image.set_source(pictures.data_url(rgb))
        outlines = [(k, act.name, story.outline(act)) for k, act in acts]
        flat = [(name, corners) for _, name, corners in outlines if corners is not None]
        self._image.content = pictures.boxes(flat, step - 1 if step else None)
        goal = story.goal if self._over.value else None
        self._scene.show(
            depth, rgb, level=story.level, exaggeration=float(self._tall.value or 1),
            goal=None if goal is None else np.where(goal > 0, goal - GOAL_ABOVE, np.nan),
            boxes=[box for k, act in acts if (box := self._solid(k, act.name, step)) is not None],
        )  # fmt: skip
        for plot, names in self._plots:
            plot.show({name: self._values(name) for name in names}, step)

    def _acts(self, step: int) -> list[tuple[int, Any]]:
        """Actions so far with their numbers; at the start, all of them."""
        moments = self._story.moments[: (step or len(self._story)) + 1]
        return [(k, moment.act) for k, moment in enumerate(moments) if moment.act is not None]

    def _solid(self, k: int, name: str, step: int) -> dict[str, Any] | None:
        box = self._story.box(k)
        if box is None:
            return None
        return {
            "edges": box.corners[EDGES].reshape(-1, 3).tolist(),
            "top": box.corners[:2].mean(0).tolist(),  # the upper edge that is far from who looks
            "colour": pictures.colour_of(name), "words": f"{k} {name}", "chosen": k == step,
        }  # fmt: skip
