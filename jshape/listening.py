"""Where a local page can be served."""

import errno
import socket

from jshape.errors import JShapeError

LOCAL = ("127.0.0.1", "localhost")
"""Hosts that only this computer reaches, of those that a server can check requests against."""


def free_port(host: str, port: int) -> int:
    """The port, or a free one for 0; a server would take another if it is taken, or wait forever.

    Args:
      host: to listen at.
      port: likewise.

    Raises:
      JShapeError: nothing can listen there; with what the system says.
    """
    try:
        kind, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            return probe.getsockname()[1]
    except (OSError, OverflowError, UnicodeError) as problem:
        why = getattr(problem, "strerror", None) or problem
        taken = getattr(problem, "errno", None) in (errno.EADDRINUSE, errno.EACCES)
        hint = "; --port 0 takes a free one" if taken else ""
        raise JShapeError(f"nothing can listen at {host}, port {port}: {why}{hint}") from None


def url(host: str, port: int) -> str:
    """What a browser opens."""
    return f"http://{'[' + host + ']' if ':' in host else host}:{port}"
