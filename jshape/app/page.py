"""What the panels of the local web page share: work beside it, errors as one line, uploads."""

import asyncio
import tempfile
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from nicegui import events, ui

from jshape.errors import JShapeError, one_line

LARGEST_UPLOAD = 64 * 2**20
"""Bytes of a file that may be sent to the page."""
PATIENCE = 0.4
"""Seconds after which the page says that it is at work."""


class Guard:
    """Does what people ask, one thing at a time, beside the page; errors become one line on it.

    Nothing that computes runs where the page is served: STOP must not wait behind it.
    """

    def __init__(self) -> None:
        self._busy = ""

    async def __call__(
        self,
        what: str,
        work: Callable[[], Any],
        then: Callable[[], Any] = lambda: None,
        hands: Executor | None = None,
    ) -> None:
        """Do something in another thread, then draw.

        Args:
          what: it does, for people.
          work: touches no element of the page.
          then: draws what has changed.
          hands: where the work has to be done; None: in any thread.

        Raises:
          CancelledError: the page was closed meanwhile, so that its caller draws nothing either.
        """
        page = ui.context.client
        if self._busy:
            ui.notify(f"still {self._busy}", type="warning")
            return
        self._busy = what
        doing = asyncio.get_running_loop().run_in_executor(hands, work)
        waiting = None
        try:
            done, _ = await asyncio.wait([doing], timeout=PATIENCE)
            if not done and not page.is_deleted:
                with page:
                    waiting = ui.notification(f"{what} ...", spinner=True, timeout=None)
            await doing
        except Exception as problem:  # whatever it is, the person at the page must hear of it
            kind = "" if isinstance(problem, JShapeError) else f"{type(problem).__name__}: "
            said = one_line(f"{kind}{problem}", 500)
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


def upload(label: str, take: Callable[[Path], Awaitable[None]], accept: str) -> ui.upload:
    """A place where a file can be dropped; `take` gets where it was put, under its own name."""
    # FastAPI keeps the route of every upload for good (fastapi/dependencies/models.py), and with it
    # what its handler holds: of a page that is closed, pictures and a bed in 3-D, 7 MB.
    takes = [take]
    ui.context.client.on_delete(lambda: takes.clear())

    async def arrived(event: events.UploadEventArguments) -> None:
        given = Path(event.file.name.replace("\\", "/"))
        stem = one_line(given.stem, 60).strip(".") or "upload"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{stem}{given.suffix[:8]}"
            path.write_bytes(await event.file.read())
            await takes[0](path)
        element.reset()

    def refused() -> None:
        ui.notify(
            f"{label}: allowed are {accept.replace(',', ' ')}, one file of at most "
            f"{LARGEST_UPLOAD >> 20} MiB", type="negative",
        )  # fmt: skip

    element = ui.upload(
        label=label, auto_upload=True, max_file_size=LARGEST_UPLOAD, on_upload=arrived,
        on_rejected=refused,
    ).props(f'accept="{accept}" flat bordered dense').classes(
        "w-full"
    ).style("max-height: 76px; overflow: hidden")  # fmt: skip
    return element
