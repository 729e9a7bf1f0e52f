"""Files that grow by one JSON line at a time, each on disk before the next begins."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jshape.errors import BadFile
from jshape.io.files import append, json_text, lock, parse_json, read_bytes, refuse, regular

NAME = "log.jsonl"
LOCK = "log.lock"
LIMIT = 256 * 2**20
"""Largest file of lines that is read, bytes."""


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
    return read_lines(path)[0]


def read_lines(path: Path) -> tuple[list[dict[str, Any]], int]:
    """The complete lines and the bytes that they take.  Raises as `events`."""
    if path.is_file() and path.stat().st_size == 0:  # it was made, and the disk was full
        return [], 0
    *lines, torn = read_bytes(path, limit=LIMIT).split(b"\n")
    found, size = [], 0
    for number, line in enumerate(lines, 1):
        try:
            found.append(parse_json(line, f"{path}: line {number}"))
        except BadFile:
            if number == len(lines) and not torn:  # a power cut may leave a block of zeros
                break
            raise
        size += len(line) + 1
    return found, size


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
        try:
            mine = lock(file.fileno())
        except OSError as problem:
            refuse(path, "cannot be locked", problem)
        if not mine:
            raise BadFile(f"{folder}: another program goes on with this run")
        yield
