"""Who may ask viser's server: its own page, a typed address, a program; and only so many."""

import http
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from jshape.app.ports import FULL, MOST_PAGES, refused
from jshape.errors import JShapeError


@contextmanager
def door(host: str) -> Iterator[None]:
    """A server that viser starts meanwhile answers nobody else.

    viser's own API cannot refuse anybody: any page of the internet that a person has open could
    read all depths through its socket, and have 50 MB kept with each message.  It does let the
    library under it look at each request, so that is where this stands.

    Args:
      host: that the server listens at.

    Raises:
      JShapeError: this version of viser serves otherwise, so that nothing would be refused.
    """
    import websockets.asyncio.server as library

    real, used = library.serve, []

    def serve(handler: Any, *where: Any, process_request: Any, **options: Any) -> Any:
        sockets = set()

        async def counted(connection: Any) -> None:
            sockets.add(connection)
            try:
                await handler(connection)
            finally:
                sockets.discard(connection)

        def checked(connection: Any, request: Any) -> Any:
            why = refused({n.lower(): value for n, value in request.headers.raw_items()}, host)
            if why is None and "?" in request.path:  # ?websocket= would show another server's page
                why = "an address with a question mark is not known here"
            if why is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"jshape view: {why}\n")
            if len(sockets) >= MOST_PAGES:
                return connection.respond(
                    http.HTTPStatus.SERVICE_UNAVAILABLE, f"jshape view: {FULL}\n"
                )
            return process_request(connection, request)

        used.append(True)
        return real(counted, *where, process_request=checked, **options)

    library.serve = serve
    try:
        yield
    finally:
        library.serve = real
    if not used:
        raise JShapeError("this version of viser cannot be told whom to answer; viser 1.1 can")
