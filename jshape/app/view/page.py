"""A plan or a run on a page of its own: the bed in 3-D and from above, step by step."""

from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.bed_scene import BedScene
from jshape.app.curve import Curve
from jshape.app.pages import serve_pages
from jshape.app.view.episode import Episode
from jshape.app.widgets import FIELDS, buttons, small

PERIOD = 1.0
"""Seconds that a step is shown while it plays."""
BED, PREDICTED, GOAL, GAP, ERROR = "bed", "predicted", "goal", "bed - goal", "bed - predicted"
"""What can be shown."""
GOAL_ABOVE = 0.001
"""Metres that the goal is drawn higher than it is: where the bed is right, it lies over it."""
EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)])
"""(12, 2) corners of a box that an edge joins."""
CURVES = {
    "to the goal (mm)": {"predicted": "predicted_mm", "obtained": "seen_mm"},
    "effort (Nm)": {"effort": "effort_nm"},
}
"""Charts: their lines, and the field of a step that each shows."""


def serve_episode(episode: Episode, *, host: str, port: int, show: bool) -> None:
    """Serve until Ctrl-C; each browser steps for itself."""

    def build() -> None:
        EpisodePage(episode)

    serve_pages(build, title="jshape view", host=host, port=port, show=show)


class EpisodePage:
    """One browser's view of an episode."""

    def __init__(self, episode: Episode):
        self._episode, self._ready = episode, False
        with ui.row().classes("w-full no-wrap items-stretch max-md:flex-wrap"):
            self._scene = BedScene(episode.camera).props("data-name=scene")
            self._scene.classes("grow h-[80vw] md:h-[calc(100vh-32px)]")
            self._scene.style("min-width: min(100%, 340px)")
            with ui.column().classes("gap-1 w-full md:w-[400px] md:shrink-0"):
                self._build_controls()
        ui.keyboard(on_key=self._key, ignore=FIELDS)
        self._timer = ui.timer(PERIOD, self._play, active=False)
        self._ready = True
        self._show()

    def _build_controls(self) -> None:
        episode, last = self._episode, len(self._episode)
        ui.label(episode.title).classes("text-base font-bold").props("data-name=title")
        for note in episode.notes:
            ui.label(note).classes("text-sm")
        self._slider = ui.slider(min=0, max=max(last, 1), value=0, on_change=self._show)
        self._slider.props("label snap data-name=step").set_enabled(last > 0)
        with ui.row().classes("items-center gap-2"):
            buttons(
                ("back", lambda: self._go(-1), "The step before (left arrow)"),
                ("play", self._start, "One step a second"),
                ("next", lambda: self._go(1), "The next step (right arrow)"),
            )
            self._choice = ui.select(self._choices(), value=BED, label="show", on_change=self._show)
            self._choice.classes("grow").style("min-width: 9em")
        self._words = ui.label().classes("text-sm").props("data-name=words")
        self._image = ui.interactive_image().classes("w-full").props("data-name=picture")
        self._under = small()
        with ui.row().classes("items-center gap-3 w-full no-wrap whitespace-nowrap"):
            self._boxes = ui.checkbox("actions", value=True, on_change=self._show)
            self._over = ui.checkbox("goal over it", on_change=self._show)
            self._over.set_visibility(episode.goal is not None)
            ui.label("height x").classes("text-sm")
            self._tall = ui.slider(min=1, max=5, step=0.5, value=1, on_change=self._show)
            self._tall.props("label dense").classes("mr-2")
        self._charts = []
        for label, names in CURVES.items():
            values = {name: self._values(field) for name, field in names.items()}
            if not episode.is_run and "obtained" in values:  # a plan: the start begins its line
                values["predicted"][0] = values.pop("obtained")[0]
            known = {name: y for name, y in values.items() if np.isfinite(y).any()}
            if known:
                self._charts.append((Curve(label, list(known), height=190), known))

    def _values(self, field: str) -> list[float]:
        values = [getattr(step, field) for step in self._episode.steps]
        return [np.nan if value is None else float(value) for value in values]

    def _choices(self) -> list[str]:
        """What the episode has to show."""
        episode = self._episode
        predicted = any(step.predicted is not None for step in episode.steps)
        there = {BED: True, PREDICTED: predicted, GOAL: episode.goal is not None}
        there |= {GAP: there[GOAL], ERROR: predicted and episode.is_run}
        return [name for name, is_there in there.items() if is_there]

    @property
    def step(self) -> int:
        """The step that is shown."""
        return min(int(self._slider.value or 0), len(self._episode))

    def _go(self, by: int) -> None:
        self._timer.deactivate()
        self._slider.value = min(max(self.step + by, 0), len(self._episode))

    def _start(self) -> None:
        if self.step == len(self._episode):
            self._slider.value = 0
        self._timer.active = not self._timer.active

    def _play(self) -> None:
        self._slider.value = min(self.step + 1, len(self._episode))
        self._timer.active = self.step < len(self._episode)

    def _key(self, event: events.KeyEventArguments) -> None:
        if event.action.keydown and (event.key.arrow_left or event.key.arrow_right):
            self._go(1 if event.key.arrow_right else -1)

    def _depth(self, step: int, name: str) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(H, W) depth to show, metres, and the differences to colour it with, mm, if any."""
        episode, one = self._episode, self._episode.steps[step]
        bed = episode.last(step)
        if name == GAP:
            return bed, episode.too_high_mm(bed, episode.goal)
        if name == ERROR:
            gap = episode.too_high_mm(one.seen, one.predicted)
            return (None if gap is None else one.seen), gap
        return {GOAL: episode.goal, PREDICTED: one.predicted}.get(name, bed), None

    def _show(self) -> None:
        if not self._ready:
            return
        episode, step = self._episode, self.step
        depth, gap = self._depth(step, str(self._choice.value))
        known = "" if depth is not None else "; not known at this step"
        self._words.text = f"step {step} of {len(episode)}: {episode.words(step)}{known}"
        if gap is not None:
            scale = episode.differences
            rgb = pictures.differing(gap, scale)
            said = f"red: too high, blue: too low, up to {scale.high:.1f} mm"
        else:
            scale = episode.heights
            shown = np.zeros(episode.camera.shape) if depth is None else depth
            rgb = pictures.shaded(episode.heights_mm(shown), scale)
            said = f"dark to bright: {scale.low:+.1f} to {scale.high:+.1f} mm from the bed's level"
        self._under.text = said
        actions = episode.actions(step) if self._boxes.value else ()
        self._image.set_source(pictures.data_url(rgb))
        self._image.content = pictures.boxes(actions, step - 1 if step else None)
        goal = episode.goal if self._over.value else None
        self._scene.show(
            depth,
            rgb,
            level=episode.level,
            exaggeration=float(self._tall.value or 1),
            goal=None if goal is None else np.where(goal > 0, goal - GOAL_ABOVE, np.nan),
            boxes=[
                box
                for k, act in enumerate(actions, 1)
                for box in self._solid(k, act.action, k == step)
            ],
        )
        for chart, values in self._charts:
            chart.show(values, step)

    def _solid(self, k: int, name: str, chosen: bool) -> list[dict[str, Any]]:
        if (box := self._episode.box(k)) is None:
            return []
        edges = box[EDGES].reshape(-1, 3).tolist()
        top = box[:2].mean(0).tolist()  # the upper edge that is far from who looks
        look = {"colour": pictures.colour_of(name), "words": f"{k} {name}", "chosen": chosen}
        return [{"edges": edges, "top": top, **look}]
