"""A journal on disk: one JSON line for each thing that happened, on disk before the next begins."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jshape.errors import BadFile
from jshape.io.files import append, json_text, parse_json, read_bytes, refuse, regular

try:
    import fcntl
except ImportError:  # Windows: nothing keeps two programs apart there
    fcntl = None

NAME = "log.jsonl"
LOCK = "log.lock"
LIMIT = 256 * 2**20
"""Largest journal that is read, bytes."""


def note(path: Path, event: Mapping[str, Any]) -> None:
    """Add an event.  A last line that a crash cut off goes.

    Raises:
      BadFile: it cannot be written, or JSON cannot hold the event.
    """
    line = json_text(dict(event), str(path), indent=None)
    try:
        with open(path, "a+b", opener=regular) as file:  # made if need be
            at = file.tell()
            file.seek(max(at - 1, 0))
            if at and file.read() != b"\n":
                file.seek(0)
                at = file.read().rfind(b"\n") + 1
        append(path, line.encode() + b"\n", at)
    except OSError as problem:
        refuse(path, "cannot be written", problem)


def events(path: Path) -> list[dict[str, Any]]:
    """All events; a last line that a crash cut off is left out.

    Raises:
      BadFile: it cannot be read, or is damaged before its last line.
    """
    if path.stat().st_size == 0:  # it was made, and the disk was full
        return []
    *lines, _ = read_bytes(path, limit=LIMIT).split(b"\n")
    return [parse_json(line, f"{path}: line {k + 1}") for k, line in enumerate(lines)]


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other programs out of a run until the block ends.

    Raises:
      BadFile: another program has the run, or the lock cannot be made.
    """
    path = folder / LOCK
    try:
        file = open(path, "ab", opener=regular)
    except OSError as problem:
        refuse(path, "cannot be written", problem)
    with file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise BadFile(f"{folder}: another program goes on with this run") from None
        yield
