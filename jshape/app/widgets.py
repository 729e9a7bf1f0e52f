"""What the panels of the local pages share: buttons, work beside the page, errors, uploads."""

import asyncio
import tempfile
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from nicegui import events, ui

from jshape.errors import one_line, told

LARGEST_UPLOAD = 64 * 2**20
"""Bytes of a file that may be sent to the page."""
BUSY_AFTER = 0.4
"""Seconds after which the page says that it is at work."""
FIELDS: list[Any] = ["input", "select", "textarea"]
"""Elements whose keys are their own."""
POINTER = ["pointerdown", "pointermove", "pointerup", "pointerleave", "pointercancel"]
"""What mouse, pen and finger do alike."""

for _element in (ui.number, ui.input, ui.select, ui.checkbox, ui.radio, ui.expansion):
    _element.default_props("dense")
for _element in (ui.button, ui.toggle, ui.tabs):
    _element.default_props("dense no-caps")


def buttons(*rows: tuple[str, Callable[[], Any], str], props: str = "") -> list[ui.button]:
    """Buttons: what each says, does, and tells of itself."""
    made = [ui.button(words, on_click=act) for words, act, _ in rows]
    for button, (_, _, said) in zip(made, rows, strict=True):
        button.props(props).tooltip(said)
    return made


def small(text: str = "", name: str = "", colour: str = "text-gray-600") -> ui.label:
    """A line in small letters."""
    return ui.label(text).classes(f"text-xs {colour}").props(f"data-name={name}" if name else "")


class OneAtATime:
    """Does what people ask in another thread, one thing at a time; errors become one line.

    Nothing that computes runs where the page is served: STOP must not wait behind it.
    """

    _busy = ""

    async def __call__(
        self,
        what: str,
        work: Callable[[], Any],
        then: Callable[[], Any] = lambda: None,
        thread: Executor | None = None,
    ) -> bool:
        """Do `work`, which touches no element of the page, then draw; returns whether it was done.

        Raises:
          CancelledError: the page was closed meanwhile, so that its caller draws nothing either.
        """
        page = ui.context.client
        if self._busy:
            ui.notify(f"still {self._busy}", type="warning")
            return False
        self._busy = what
        doing = asyncio.get_running_loop().run_in_executor(thread, work)
        waiting, succeeded = None, False
        try:
            done, _ = await asyncio.wait([doing], timeout=BUSY_AFTER)
            if not done and not page.is_deleted:
                with page:
                    waiting = ui.notification(f"{what} ...", spinner=True, timeout=None)
            await doing
            succeeded = True
        except Exception as problem:  # whatever it is, the person at the page must hear of it
            said = told(problem, 500)
            if not page.is_deleted:
                with page:  # the button that was pressed may have been drawn anew
                    ui.notify(said, type="negative", multi_line=True)
        finally:
            self._busy = ""
        if page.is_deleted:
            raise asyncio.CancelledError("the page was closed")
        with page:
            if waiting is not None:
                waiting.dismiss()
            then()
        return succeeded


def upload(label: str, take: Callable[[Path], Awaitable[None]], accept: str) -> None:
    """A place where a file can be dropped; `take` gets where it was put, under its own name."""
    # FastAPI keeps the route of every upload for good (fastapi/dependencies/models.py), and with it
    # what its handler holds: of a page that is closed, pictures and a bed in 3-D, 7 MB.
    takes = [take]
    ui.context.client.on_delete(takes.clear)

    async def arrived(event: events.UploadEventArguments) -> None:
        given = Path(event.file.name.replace("\\", "/"))
        stem = one_line(given.stem, 60).strip(".") or "upload"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{stem}{given.suffix[:8]}"
            path.write_bytes(await event.file.read())
            await takes[0](path)
        element.reset()

    allowed = f"{accept.replace(',', ' ')}, one file of at most {LARGEST_UPLOAD >> 20} MiB"
    element = ui.upload(
        label=label,
        auto_upload=True,
        max_file_size=LARGEST_UPLOAD,
        on_upload=arrived,
        on_rejected=lambda: ui.notify(f"{label}: allowed are {allowed}", type="negative"),
    )
    element.props(f'accept="{accept}" flat bordered dense').classes("w-full")
    element.style("max-height: 76px; overflow: hidden")
