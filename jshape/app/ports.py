"""Where a local page can be served, and who may ask for it."""

import errno
import ipaddress
import socket
from collections.abc import Mapping
from urllib.parse import urlsplit

from jshape.errors import JShapeError, quoted

LOCAL = ("127.0.0.1", "localhost")
"""Hosts that only this computer reaches, of those that a server can check requests against."""


def refused(headers: Mapping[str, str], host: str) -> str | None:
    """Why a request must not be answered; None: it may be.

    Any page on the internet can ask a browser to send requests to this computer, and by a name of
    its own that leads here (DNS rebinding) read the answers.  What the browser says of the request
    tells them from those of our page, of an address that was typed, and of a program.

    Args:
      headers: of the request, whatever the case of their names.
      host: that the server listens at.
    """
    asked = headers.get("host", "")
    if not _is_ours(_hostname("//" + asked), host):
        return f"this server is not known as {quoted(asked)}; open it by its address"
    origin = headers.get("origin")
    if origin is not None:
        ours = origin.lower() in (f"http://{asked}".lower(), f"https://{asked}".lower())
        return None if ours else "a page of another origin must not ask here"
    if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
        return "another page asked for this; type the address, or open the link here"
    return None


def _is_ours(name: str | None, host: str) -> bool:
    """Whether a host's name in a request can only mean this server."""
    if name is None:
        return False
    if name in (*LOCAL, "::1", host.lower()):
        return True
    if host in LOCAL:
        return False
    try:
        ipaddress.ip_address(name)
        return True  # a foreign page's own name never is an address
    except ValueError:
        return name in (socket.gethostname().lower(), socket.getfqdn().lower())


def _hostname(address: str) -> str | None:
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def free_port(host: str, port: int) -> int:
    """The port, or a free one for 0; a JShapeError says why nothing can listen there.

    A server would take another one if it is taken, or wait forever.
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
