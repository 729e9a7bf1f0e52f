"""The tab where the boxes of a data set are looked at and corrected."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.studio import pictures
from jshape.studio.annotation import Annotation
from jshape.studio.page import Guard

WIDTH = 440
"""Of each image on the page, pixels."""
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
        with ui.row().classes("w-full items-center gap-2"):
            path = ui.input(
                "data set on this computer", value=str(boxes.folder) if boxes else ""
            ).props("dense")
            path.classes("grow")
            ui.button("open", on_click=lambda: self._open(Path(path.value or "."))).props(
                "dense no-caps"
            ).props("data-name=open")
        self._title = ui.label("no data set is open").classes("text-base").props("data-name=title")
        self._row = ui.row().classes("w-full no-wrap gap-2")
        self._images: dict[str, Any] = {}
        with ui.row().classes("items-center gap-2"):
            for text, act in (
                ("previous", lambda: self._go(-1)),
                ("next", lambda: self._go(1)),
                ("take the found box", self._found),
                ("put back", self._put_back),
                ("save to pairs.csv", self._save),
            ):
                ui.button(text, on_click=act).props("dense no-caps")
        ui.label(
            "Drag a box over any of the images. Keys: left and right for the pair, f takes the "
            "found box, z puts it back, s saves."
        ).classes("text-xs text-gray-600")
        self._list = ui.row().classes("w-full gap-1")
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"])
        if boxes is not None:
            self._take(boxes)

    async def _open(self, path: Path) -> None:
        opened: list[Annotation] = []
        await self._guard("reading", lambda: opened.append(Annotation(path)))
        if opened:
            self._take(opened[0])

    def _take(self, work: Annotation) -> None:
        self.work, self.number = work, 0
        camera = work.pairs.camera
        self._row.clear()
        with self._row:
            for name in NAMES:
                with ui.column().classes("gap-0"):
                    ui.label(name).classes("text-sm")
                    image = ui.interactive_image(
                        size=(camera.width, camera.height), cross=True, on_mouse=self._mouse,
                        events=["mousedown", "mousemove", "mouseup"],
                    )  # fmt: skip
                    self._images[name] = image.style(
                        f"width: {WIDTH}px; border: 1px solid #999"
                    ).props(f"data-name={name}")
        self._show()

    def _show(self) -> None:
        work, k = self.work, self.number
        if work is None:
            return
        pairs = work.pairs
        for name, counts in (("before", pairs.prior[k]), ("after", pairs.posterior[k])):
            depth = np.where(counts > 0, counts * pairs.depth_unit, np.nan)
            depth = np.where(np.isfinite(depth), depth, np.nanmedian(depth)).astype(np.float32)
            self._images[name].set_source(pictures.data_url(pictures.shaded(depth)))
        change = -np.nan_to_num(work.effect(k).change_mm)
        self._images["difference"].set_source(pictures.data_url(pictures.differing(change)))
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
            f"{work.pairs.agent[k]}; box {w}x{h} at ({left}, {top}), {kind}; "
            f"{len(work.changed)} not saved"
        )

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        at = (event.image_x, event.image_y)
        if event.type == "mousedown":
            self._corner = at
        elif self._corner is not None and event.type == "mousemove":
            u, v = (min(a, b) for a, b in zip(self._corner, at, strict=True))
            w, h = (abs(a - b) for a, b in zip(self._corner, at, strict=True))
            self._show_box((round(u), round(v), round(w), round(h)))
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
        if self.work is not None:
            count = len(self.work.changed)
            await self._guard("saving", self.work.save, self._show)
            if not self.work.changed:
                ui.notify(f"{count} boxes written")
