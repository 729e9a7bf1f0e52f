"""The tab where the boxes of a data set are looked at and corrected."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.annotation import Annotation
from jshape.app.widgets import FIELDS, POINTER, OneAtATime, buttons, small
from jshape.io.datasets import TABLE

FOUND, OWN, NEW = "#1f77b4", "#2ca02c", "#ff7f0e"
"""Colours of boxes: found, drawn by hand, not saved yet."""
NAMES = ("before", "after", "difference")


class AnnotatePage:
    """One browser's view of a data set."""

    def __init__(self, boxes: Annotation | None):
        """Build the tab's content where the caller is; with a data set, show it."""
        self._work: Annotation | None = None
        self.number = 0
        self.in_front: Callable[[], bool] = lambda: True
        """Whether keys are for this tab."""
        self._do = OneAtATime()
        self._corner: tuple[float, float] | None = None
        self._warned = False  # that changed boxes are not saved
        with ui.row().classes("w-full items-center gap-2"):
            folder = str(boxes.folder) if boxes else ""
            path = ui.input("data set on this computer", value=folder).classes("grow")
            path.tooltip("Folder with pairs.csv, camera.json and the frames")
            buttons(("open", lambda: self._open(str(path.value or "").strip()), "Read it"))
        self._title = ui.label(
            "No data set is open: type the folder with pairs.csv above and press open."
        )
        self._title.classes("text-base").props("data-name=title")
        self._row = ui.element("div").classes("studio-columns w-full")
        self._images: dict[str, Any] = {}
        self._labels: dict[str, ui.label] = {}
        with ui.row().classes("items-center gap-2"):
            self._buttons = buttons(
                ("previous", partial(self._go, -1), "The pair before (left arrow)"),
                ("next", partial(self._go, 1), "The next pair (right arrow)"),
                ("take the found box", self._found, "What is found in the two frames (f)"),
                ("put back", self._put_back, "The box as it was saved last (z)"),
                ("save to pairs.csv", self._save, "Write the changed boxes (s)"),
            )
        small("Drag a box over any of the images, sizes are in pixels.")
        self._list = ui.row().classes("w-full gap-1")
        ui.keyboard(on_key=self._key, ignore=FIELDS)
        for button in self._buttons:
            button.disable()
        if boxes is not None:
            self._take(boxes)

    @property
    def work(self) -> Annotation:
        """The data set that is open."""
        assert self._work is not None
        return self._work

    async def _open(self, words: str) -> None:
        if not words:
            ui.notify("type the folder of a data set first", type="warning")
            return
        unsaved = 0 if self._work is None else len(self._work.changed)
        if unsaved and not self._warned:
            self._warned = True
            said = f"{unsaved} boxes are not saved: save them, or press open again"
            ui.notify(said, type="warning")
            return
        self._warned, opened = False, list[Annotation]()
        path = Path(words).expanduser()
        if await self._do("reading", lambda: opened.append(Annotation(path))):
            self._take(opened[0])

    def _take(self, work: Annotation) -> None:
        self._work, self.number, self._warned = work, 0, False
        for button in self._buttons:
            button.enable()
        size = work.pairs.camera.width, work.pairs.camera.height
        self._row.clear()
        with self._row:
            for name in NAMES:
                with ui.column().classes("gap-0"):
                    self._labels[name] = ui.label(name).classes("text-sm")
                    image = ui.interactive_image(
                        size=size, cross=True, on_mouse=self._mouse, events=POINTER
                    )
                    image.classes("w-full").style("border: 1px solid #999; touch-action: none")
                    self._images[name] = image.props(f"data-name={name}")
        self._show()

    def _show(self) -> None:
        work, k = self.work, self.number
        pairs = work.pairs
        depths = {"before": pairs.prior[k], "after": pairs.posterior[k]}
        heights = {name: -1e3 * pairs.depth_unit * counts for name, counts in depths.items()}
        for name, height in heights.items():
            height[depths[name] <= 0] = np.nan
        scale = pictures.height_scale(*heights.values())
        for name, height in heights.items():
            self._images[name].set_source(pictures.data_url(pictures.shaded(height, scale)))
            self._labels[name].text = f"{name}: {scale.high - scale.low:.1f} mm from dark to bright"
        change = np.nan_to_num(work.effect(k).change_mm)  # positive is deeper
        scale = pictures.difference_scale(change)
        self._images["difference"].set_source(pictures.data_url(pictures.differing(change, scale)))
        said = f"difference: red sank, blue rose, up to {scale.high:.1f} mm"
        self._labels["difference"].text = said
        self._show_box()
        self._list.clear()
        with self._list:
            for number, name in enumerate(pairs.id.tolist()):
                colour = "primary" if number == k else self._kind(number)[1]
                button = ui.button(name, on_click=partial(self._select, number))
                button.props(f"size=sm {'' if number == k else 'outline'} color={colour}")

    def _kind(self, k: int) -> tuple[str, str, str]:
        """What a box is, and its colours: of the button, of the drawing."""
        if k in self.work.changed:
            return "not saved yet", "orange", NEW
        return ("by hand", "green", OWN) if self.work.by_hand[k] else ("found", "blue-grey", FOUND)

    def _show_box(self, drawn: tuple[int, int, int, int] | None = None) -> None:
        work, k = self.work, self.number
        box, (kind, _, colour) = drawn or work.box(k), self._kind(k)
        for image in self._images.values():
            image.content = pictures.box(box, NEW if drawn else colour)
        left, top, w, h = box
        self._title.text = (
            f"{work.pairs.id[k]} ({k + 1} of {len(work)}): {work.pairs.action[k]} by "
            f"{work.pairs.agent[k]}; box {w}x{h} px at ({left}, {top}), {kind}; "
            f"{len(work.changed)} not saved"
        )

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        at, corner = (event.image_x, event.image_y), self._corner
        if event.type == "pointerdown":
            self._corner = at
        elif corner is not None and event.type == "pointermove":
            (u0, u1), (v0, v1) = (sorted(map(round, ends)) for ends in zip(corner, at, strict=True))
            self._show_box((u0, v0, u1 - u0, v1 - v0))
        elif event.type == "pointercancel":  # the system took the finger
            self._corner = None
            self._show()
        elif corner is not None:
            self._corner = None
            await self._do(
                "drawing", partial(self.work.correct, self.number, corner, at), self._show
            )

    async def _key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown or not self.in_front() or self._work is None:
            return
        if event.key.arrow_left or event.key.arrow_right:
            self._go(1 if event.key.arrow_right else -1)
        elif event.key.name == "z":
            self._put_back()
        elif event.key.name in ("f", "s"):
            await (self._found() if event.key.name == "f" else self._save())

    def _go(self, by: int) -> None:
        self._select(self.number + by)

    def _select(self, number: int) -> None:
        self.number = min(max(number, 0), len(self.work) - 1)
        self._show()

    async def _found(self) -> None:
        await self._do("looking", partial(self.work.take_found, self.number), self._show)

    def _put_back(self) -> None:
        self.work.put_back(self.number)
        self._show()

    async def _save(self) -> None:
        if not (count := len(self.work.changed)):
            ui.notify("no box is changed: nothing to save", type="warning")
        elif await self._do("saving", self.work.save, self._show):
            ui.notify(f"{count} boxes written to {self.work.folder / TABLE}")
