"""The studio's page and its server."""

import gc
from typing import Any

from nicegui import Client, app, ui
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response

from jshape.app.annotate_page import AnnotatePage
from jshape.app.annotation import Annotation
from jshape.app.bench import Bench
from jshape.app.desk import Desk
from jshape.app.mold_page import MoldPage
from jshape.app.ports import FULL, MOST_PAGES, refused
from jshape.app.stopping import StopServer

LOADED_WITHIN = 10.0
"""Seconds after which a page that was fetched and never came alive is given up."""
KEPT_MESSAGES = 50
"""What was sent to a page and it has not confirmed; each may hold a bed in 3-D."""

RESIZE = "setTimeout(() => window.dispatchEvent(new Event('resize')), 100)"


def serve(
    desk: Desk, bench: Bench, boxes: Annotation | None, *, host: str, port: int, show: bool
) -> None:
    """Serve until it is interrupted.

    Args:
      desk: what people work on; the same in every tab of every browser.
      bench: the robot and the folder.
      boxes: opened in the tab for annotation.
      host: to listen at.
      port: likewise.
      show: open a browser.
    """
    app.add_middleware(_Door, host=host)
    # Any other path gets a line: NiceGUI would build a page for it, and keep it for a minute.
    app.add_exception_handler(404, lambda request, problem: PlainTextResponse("not here", 404))

    def build(script: str) -> None:
        ui.add_head_html(script)
        ui.add_css(".nicegui-content { padding: 8px }")
        with ui.header().classes("items-center no-wrap py-1"):
            ui.label("jshape studio").classes("text-lg gt-xs")  # a telephone has no room for it
            with ui.tabs().props("dense no-caps") as tabs:
                ui.tab("mold", label="Mold")
                ui.tab("annotate", label="Annotate boxes")
            ui.space()
            stop = ui.button("STOP", on_click=bench.stop)
            stop.props("dense color=negative data-name=stop")
        # Wherever the focus is, in whichever tab.
        ui.keyboard(on_key=lambda e: bench.stop() if e.key.escape else None, ignore=[])
        first = "annotate" if boxes is not None and desk.bed is None else "mold"
        with ui.tab_panels(tabs, value=first, animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("mold").classes("p-0"):
                mold = MoldPage(desk, bench)
            with ui.tab_panel("annotate").classes("p-0"):
                annotate = AnnotatePage(boxes)
        # A 3-D view has no size while its tab is behind.
        tabs.on_value_change(lambda: ui.run_javascript(RESIZE))
        mold.in_front = lambda: tabs.value == "mold"
        annotate.in_front = lambda: tabs.value == "annotate"

    # What is loaded by now stays.  Python's collector, which holds up all threads, looks through
    # the pages only from now on, and so finds those that were closed sooner.
    gc.collect()
    gc.freeze()
    with StopServer(bench.stop, host, port) as stopping:
        ui.page("/")(lambda: build(stopping.script))
        ui.run(
            host=host, port=port, show=show, reload=False, title="jshape studio", favicon="🏖",
            show_welcome_message=False, message_history_length=KEPT_MESSAGES,
        )  # fmt: skip


class _Door:
    """Lets in the studio's own pages, typed addresses and programs, and only so many pages."""

    def __init__(self, app: Any, host: str):
        self._app, self._host = app, host

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        why, status = refused(Headers(scope=scope), self._host), 403
        if why is None and scope["type"] == "http" and scope["path"] == "/":
            Client.prune_instances(client_age_threshold=LOADED_WITHIN)
            if len(Client.instances) >= MOST_PAGES:
                why, status = FULL, 503
        if why is None:
            return await self._app(scope, receive, _unframed(send))
        # A socket that is refused is closed before it opens.
        await Response(f"jshape studio: {why}\n", status, media_type="text/plain")(
            scope, receive, send
        )


def _unframed(send: Any) -> Any:
    """Answers that no other page may show in a frame: a press there would be meant for it."""

    async def sent(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], (b"x-frame-options", b"DENY")]
        await send(message)

    return sent
