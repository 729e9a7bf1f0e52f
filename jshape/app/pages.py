"""How pages of this computer are served: to whom, how many at once, and never in a frame."""

import gc
import signal
import sys
from collections.abc import Callable
from typing import Any

from nicegui import Client, app, ui
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

from jshape.app.ports import LOCAL, refused, url

MOST_PAGES = 8
"""Pages of one server that may be open at once: each holds pictures and a bed in 3-D."""
FULL = f"{MOST_PAGES} pages are open already; close one, then load this again in a few seconds"
"""What the next one is told."""
LOADED_WITHIN = 10.0
"""Seconds after which a page that was fetched and never came alive is given up."""
KEPT_MESSAGES = 50
"""What was sent to a page and it has not confirmed; each may hold a bed in 3-D."""

COLUMNS = """
.nicegui-content { padding: 8px }
.studio-columns { display: grid; gap: 12px; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 340px), 1fr)); }
.studio-columns > * { min-width: 0; max-width: 640px; }
"""
"""As many columns as the screen has room for; one on a telephone."""


def serve_pages(build: Callable[[], None], *, title: str, host: str, port: int, show: bool) -> None:
    """Serve a page, built for each browser anew, until Ctrl-C or SIGTERM; `show` opens it here."""

    def told() -> None:
        if host not in LOCAL:
            print(f"anybody who reaches {host} can use this page", file=sys.stderr)
        print(f"{title} is at {url(host, port)}; Ctrl-C ends it", file=sys.stderr, flush=True)

    def page() -> None:
        ui.add_css(COLUMNS)
        build()

    app.on_startup(told)
    app.add_middleware(_OriginCheck, host=host, title=title)
    # Any other path gets a line: NiceGUI would build a page for it, and keep it for a minute.
    app.add_exception_handler(404, lambda request, problem: PlainTextResponse("not here", 404))
    # What is loaded by now stays.  Python's collector, which holds up all threads, looks through
    # the pages only from now on, and so finds those that were closed sooner.
    gc.collect()
    gc.freeze()
    ui.page("/")(page)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        ui.run(
            host=host,
            port=port,
            show=show,
            reload=False,
            title=title,
            favicon="🏖",
            show_welcome_message=False,
            message_history_length=KEPT_MESSAGES,
        )
    except KeyboardInterrupt:
        pass  # how people end it
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


class _OriginCheck:
    """Lets in the program's own pages, typed addresses and programs, and only so many pages."""

    def __init__(self, app: Any, host: str, title: str):
        self._app, self._host, self._title = app, host, title

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
        await PlainTextResponse(f"{self._title}: {why}\n", status)(scope, receive, send)


def _unframed(send: Any) -> Any:
    """Answers that no other page may show in a frame: a press there would be meant for it."""

    async def sent(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], (b"x-frame-options", b"DENY")]
        await send(message)

    return sent
