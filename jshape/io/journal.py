"""Files that grow by one JSON line at a time, each on disk before the next begins."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from jshape.errors import BadFile
from jshape.io.files import json_text, lock, parse_json, read_bytes, refused, regular

NAME = "log.jsonl"
LOCK = "log.lock"
LIMIT = 256 * 2**20
"""Largest file of lines that is read, bytes."""


def append(path: Path, line: str, at: int) -> int:
    """Write a line at byte `at`, whatever stands behind it; its length.

    Raises BadFile: it cannot be written; the file ends at `at`, without a torn line.
    """
    data = line.encode() + b"\n"
    # Without a buffer: one that could not be written is written once more at the end.
    with refused(path, "cannot be written"), open(path, "r+b", buffering=0, opener=regular) as file:
        file.truncate(at)
        file.seek(at)
        try:
            done = 0
            while done < len(data):
                done += file.write(data[done:])
            os.fsync(file.fileno())
        except BaseException:
            with suppress(OSError):
                file.truncate(at)
            raise
    return len(data)


def note(path: Path, event: Mapping[str, Any]) -> None:
    """Add an event.  A last line that a crash cut off goes.

    Raises BadFile: it cannot be written, or JSON cannot hold the event.
    """
    line = json_text(dict(event), str(path), indent=None)
    with refused(path, "cannot be written"):
        with open(path, "a+b", opener=regular) as file:  # made if need be
            at = file.tell()
            file.seek(max(at - 1, 0))
            if at and file.read() != b"\n":
                file.seek(0)
                at = file.read().rfind(b"\n") + 1
        append(path, line, at)


def events(path: Path) -> list[dict[str, Any]]:
    """All events; a last line that a crash cut off is left out.  Raises as `read_lines`."""
    return read_lines(path)[0]


def read_lines(path: Path) -> tuple[list[dict[str, Any]], int]:
    """The complete lines and the bytes that they take.

    Raises BadFile: the file cannot be read, or is damaged before its last line.
    """
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

    Raises BadFile: another program has the run, or the lock cannot be made.
    """
    path = folder / LOCK
    with refused(path, "cannot be written"):
        file = open(path, "ab", opener=regular)
    with file:
        with refused(path, "cannot be locked"):
            mine = lock(file.fileno())
        if not mine:
            raise BadFile(f"{folder}: another program goes on with this run")
        yield
