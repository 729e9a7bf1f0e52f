"""The tab where the boxes of a data set are looked at and corrected."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app import pictures
from jshape.app.annotation import Annotation
from jshape.app.page import Guard
from jshape.io.datasets import TABLE

FOUND, OWN, NEW = "#1f77b4", "#2ca02c", "#ff7f0e"
"""Colours of boxes: found, drawn by hand, not saved yet."""
NAMES = ("before", "after", "difference")


class AnnotatePage:
    """One browser's view of a data set."""

    def __init__(self, boxes: Annotation | None):
        """Build the tab's content where the caller is; with a data set, show it."""
        self.work: Annotation | None = None
        self.number = 0
        self.in_front: Callable[[], bool] = lambda: True
        """Whether keys are for this tab."""
        self._guard = Guard()
        self._corner: tuple[float, float] | None = None
        self._warned = False  # that changed boxes are not saved
        with ui.row().classes("w-full items-center gap-2"):
            path = ui.input(
                "data set on this computer", value=str(boxes.folder) if boxes else ""
            ).props("dense")
            path.classes("grow")
            path.tooltip("Folder with pairs.csv, camera.json and the frames")
            ui.button("open", on_click=lambda: self._open(str(path.value or "").strip())).props(
                "dense no-caps data-name=open"
            )
        self._title = ui.label(
            "No data set is open: type the folder with pairs.csv above and press open."
        )
        self._title.classes("text-base").props("data-name=title")
        self._row = ui.element("div").classes("studio-columns w-full")
        self._images: dict[str, Any] = {}
        self._labels: dict[str, ui.label] = {}
        self._buttons: list[ui.button] = []
        with ui.row().classes("items-center gap-2"):
            for text, act, said in (
                ("previous", lambda: self._go(-1), "The pair before (left arrow)"),
                ("next", lambda: self._go(1), "The next pair (right arrow)"),
                ("take the found box", self._found, "What is found in the two frames (f)"),
                ("put back", self._put_back, "The box as it was saved last (z)"),
                ("save to pairs.csv", self._save, "Write the changed boxes (s)"),
            ):
                button = ui.button(text, on_click=act).props("dense no-caps").tooltip(said)
                self._buttons.append(button)
        ui.label("Drag a box over any of the images, sizes are in pixels.").classes(
            "text-xs text-gray-600"
        )
        self._list = ui.row().classes("w-full gap-1")
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"])
        for button in self._buttons:
            button.disable()
        if boxes is not None:
            self._take(boxes)

    async def _open(self, words: str) -> None:
        if not words:
            ui.notify("type the folder of a data set first", type="warning")
            return
        if self.work is not None and self.work.changed and not self._warned:
            self._warned = True
            ui.notify(
                f"{len(self.work.changed)} boxes are not saved: save them, or press open again",
                type="warning",
            )
            return
        self._warned, opened = False, list[Annotation]()
        path = Path(words).expanduser()
        await self._guard("reading", lambda: opened.append(Annotation(path)))
        if opened:
            self._take(opened[0])

    def _take(self, work: Annotation) -> None:
        self.work, self.number, self._warned = work, 0, False
        for button in self._buttons:
            button.enable()
        camera = work.pairs.camera
        self._row.clear()
        with self._row:
            for name in NAMES:
                with ui.column().classes("gap-0"):
                    self._labels[name] = ui.label(name).classes("text-sm")
                    image = ui.interactive_image(
                        size=(camera.width, camera.height), cross=True, on_mouse=self._mouse,
                        events=["pointerdown", "pointermove", "pointerup", "pointerleave",
                                "pointercancel"],
                    )  # fmt: skip
                    image.classes("w-full").style("border: 1px solid #999; touch-action: none")
                    self._images[name] = image.props(f"data-name={name}")
        self._show()

    def _show(self) -> None:
        work, k = self.work, self.number
        if work is None:
            return
        pairs = work.pairs
        heights = {}
        for name, counts in (("before", pairs.prior[k]), ("after", pairs.posterior[k])):
            mm = np.where(counts > 0, counts * (-1e3 * pairs.depth_unit), np.nan)
            level = np.nanmedian(mm)
            heights[name] = np.where(np.isfinite(mm), mm, level).astype(np.float32)
        scale = pictures.height_scale(*heights.values())
        for name, height in heights.items():
            self._images[name].set_source(pictures.data_url(pictures.shaded(height, scale)))
            self._labels[name].text = f"{name}: {scale.high - scale.low:.1f} mm from dark to bright"
        change = np.nan_to_num(work.effect(k).change_mm)  # positive is deeper
        scale = pictures.difference_scale(change)
        self._images["difference"].set_source(pictures.data_url(pictures.differing(change, scale)))
        self._labels[
            "difference"
        ].text = f"difference: red sank, blue rose, up to {scale.high:.1f} mm"
        self._show_box()
        self._list.clear()
        with self._list:
            for number, name in enumerate(pairs.id.tolist()):
                colour = "primary" if number == k else self._kind(number)[1]
                button = ui.button(name, on_click=partial(self._select, number))
                button.props(f"dense no-caps size=sm {'' if number == k else 'outline'}")
                button.props(f"color={colour}")

    def _kind(self, k: int) -> tuple[str, str, str]:
        """What a box is, and its colours: of the button, of the drawing."""
        assert self.work is not None
        if k in self.work.changed:
            return "not saved yet", "orange", NEW
        if self.work.by_hand[k]:
            return "by hand", "green", OWN
        return "found", "blue-grey", FOUND

    def _show_box(self, drawn: tuple[int, int, int, int] | None = None) -> None:
        work, k = self.work, self.number
        assert work is not None
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
        at = (event.image_x, event.image_y)
        if event.type == "pointerdown":
            self._corner = at
        elif self._corner is not None and event.type == "pointermove":
            u, v = (min(a, b) for a, b in zip(self._corner, at, strict=True))
            w, h = (abs(a - b) for a, b in zip(self._corner, at, strict=True))
            self._show_box((round(u), round(v), round(w), round(h)))
        elif event.type == "pointercancel":  # the system took the finger
            self._corner = None
            self._show()
        elif self._corner is not None:
            corner, self._corner = self._corner, None
            if self.work is not None:
                work, k = self.work, self.number
                await self._guard("drawing", lambda: work.correct(k, corner, at), self._show)

    async def _key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown or not self.in_front():
            return
        if event.key.arrow_left or event.key.arrow_right:
            self._go(1 if event.key.arrow_right else -1)
        elif event.key.name == "f":
            await self._found()
        elif event.key.name == "z":
            self._put_back()
        elif event.key.name == "s":
            await self._save()

    def _go(self, by: int) -> None:
        self._select(self.number + by)

    def _select(self, number: int) -> None:
        if self.work is not None:
            self.number = min(max(number, 0), len(self.work) - 1)
            self._show()

    async def _found(self) -> None:
        if self.work is not None:
            work, k = self.work, self.number
            await self._guard("looking for the box", lambda: work.take_found(k), self._show)

    def _put_back(self) -> None:
        if self.work is not None:
            self.work.put_back(self.number)
            self._show()

    async def _save(self) -> None:
        if self.work is None or not self.work.changed:
            ui.notify("no box is changed: nothing to save", type="warning")
            return
        written: list[int] = []
        work = self.work
        await self._guard("saving", lambda: written.append(work.save()), self._show)
        if written:
            ui.notify(f"{written[0]} boxes written to {work.folder / TABLE}")
