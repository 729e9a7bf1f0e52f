"""Where a local page can be served."""

import socket

from jshape.errors import JShapeError

LOCAL = ("127.0.0.1", "localhost", "::1")
"""Hosts that only this computer reaches."""


def check_free(host: str, port: int) -> None:
    """Refuse a place where nothing can listen: a server would take another port, or wait forever.

    Raises:
      JShapeError: with what the system says.
    """
    try:
        kind, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, OverflowError) as problem:
        why = getattr(problem, "strerror", None) or problem
        raise JShapeError(
            f"nothing can listen at {host}, port {port}: {why}; --port 0 takes a free one"
        ) from None
