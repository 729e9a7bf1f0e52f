"""The local web page: tabs, errors as one line, and the server.  Needs NiceGUI (extra studio)."""

import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from nicegui import events, run, ui

from jshape.errors import JShapeError

LARGEST_UPLOAD = 64 * 2**20
"""Bytes of a file that may be sent to the page."""


class Guard:
    """Does what people ask, one thing at a time; errors become one line on the page."""

    def __init__(self) -> None:
        self._busy = ""

    async def __call__(self, what: str, work: Callable[[], Any], then: Callable[[], Any]) -> None:
        """Do something that may take long in a thread of its own, then draw.

        Args:
          what: it does, for people.
          work: touches no element of the page.
          then: draws what has changed.
        """
        if self._busy:
            ui.notify(f"still {self._busy}", type="warning")
            return
        self._busy = what
        waiting = ui.notification(f"{what} ...", spinner=True, timeout=None)
        try:
            await run.io_bound(work)
        except JShapeError as problem:
            ui.notify(" ".join(str(problem).split()), type="negative", multi_line=True)
        finally:
            self._busy = ""
            waiting.dismiss()
            then()


def at_once(work: Callable[[], Any], then: Callable[[], Any]) -> None:
    """Do something quick, then draw; an error becomes one line on the page."""
    try:
        work()
    except JShapeError as problem:
        ui.notify(" ".join(str(problem).split()), type="negative", multi_line=True)
    then()


def upload(label: str, take: Callable[[Path], Awaitable[None]], accept: str) -> ui.upload:
    """A place where a file can be dropped; `take` gets where it was put."""

    async def arrived(event: events.UploadEventArguments) -> None:
        suffix = Path(event.file.name).suffix[:8]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"upload{suffix}"
            path.write_bytes(await event.file.read())
            await take(path)
        element.reset()

    element = ui.upload(
        label=label, auto_upload=True, max_file_size=LARGEST_UPLOAD, on_upload=arrived,
        on_rejected=lambda: ui.notify(f"{label}: not a file of that kind", type="negative"),
    ).props(f'accept="{accept}" flat bordered dense').classes(
        "w-full"
    ).style("max-height: 76px; overflow: hidden")  # fmt: skip
    return element
