"""Files: written whole or not at all, read with limits, never outside their folder."""

import hashlib
import json
import math
import os
import secrets
import stat
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PureWindowsPath
from typing import Any, NoReturn

from jshape.errors import BadFile, BadImage, JShapeError, one_line, quoted

JSON_LIMIT = 64 * 2**20
"""Default largest JSON file that is read, bytes."""
JSON_VALUES = 1_000_000
"""Most values of a JSON text: they take up to 200 bytes each in memory."""


@contextmanager
def refused(path: str | os.PathLike, what: str) -> Iterator[None]:
    """Raise BadFile, `path: what: the reason`, where the operating system refuses something."""
    try:
        yield
    except (OSError, ValueError, RuntimeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) and problem.strerror else problem
        raise BadFile(f"{path}: {what}: {one_line(reason)}") from None


@contextmanager
def as_error(kind: type[JShapeError], *of: type[JShapeError]) -> Iterator[None]:
    """Raise another kind of error, of the same text; `of` are those meant, else of files."""
    meant = of or (BadFile, BadImage)
    try:
        yield
    except meant as problem:
        raise kind(str(problem)) from None


def write_atomic(path: str | os.PathLike, content: bytes | str) -> Path:
    """Write a file whole or not at all; what was there stays until the new content is on disk.

    Its folder is made if need be; text is written as UTF-8.

    Raises BadFile: it cannot be written; nothing new is left behind.
    """
    path = Path(path)
    temp = temp_beside(path)
    with refused(path, "cannot be written"):
        if path.is_dir():
            raise BadFile(f"{path}: is a folder; a file is to be written there")
        with parents(path):
            try:
                write_new(temp, content.encode() if isinstance(content, str) else content)
                os.replace(temp, path)
            finally:
                remove_file(temp)
        sync_folder(path.parent)
    return path


def read_bytes(path: str | os.PathLike, *, limit: int) -> bytes:
    """The content of a regular file of at most `limit` bytes.

    Raises BadFile: it is missing, a folder, empty, too large or unreadable.
    """
    with refused(path, "cannot be read"), open(path, "rb", opener=regular) as file:
        size = os.fstat(file.fileno()).st_size
        if size == 0:
            raise BadFile(f"{path}: the file is empty")
        if size > limit:
            raise BadFile(f"{path}: {size:,} bytes; at most {limit:,} are read")
        return file.read(limit)


def regular(path: str, flags: int) -> int:
    """An `opener` for `open` that takes regular files only, and never waits for one.

    A FIFO would wait until somebody writes to it, and some devices never end or act when opened.

    Raises BadFile: it is missing, a folder, or something else than a file.
    """
    try:
        if not (flags & os.O_CREAT and not os.path.lexists(path)):
            _check_regular(os.stat(path), path)
        handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o666)
    except FileNotFoundError:
        what = "is a link to no file" if os.path.islink(path) else "no such file"
        raise BadFile(f"{path}: {what}") from None
    try:
        _check_regular(os.fstat(handle), path)  # which may have become another file since
    except BadFile:
        os.close(handle)
        raise
    return handle


def _check_regular(found: os.stat_result, path: str) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise BadFile(f"{path}: is a folder, not a file")
    if not stat.S_ISREG(found.st_mode):
        raise BadFile(f"{path}: is not a regular file")


def sha256(path: str | os.PathLike) -> str:
    """SHA-256 of a file, in hexadecimal.  Raises BadFile: it cannot be read."""
    with refused(path, "cannot be read"), open(path, "rb", opener=regular) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sums(folder: Path, sums: dict[str, str]) -> None:
    """Refuse a folder of which a file is not as its checksum says.

    Raises BadFile: naming the file.
    """
    for name, expected in sums.items():
        if sha256(inside(folder, name)) != expected:
            raise BadFile(f"{folder / name}: checksum differs; damaged?")


def read_json(path: str | os.PathLike, *, limit: int = JSON_LIMIT) -> dict[str, Any]:
    """The object (a dict) that a JSON file holds.

    Raises BadFile: the file cannot be read, is too large, is not JSON, is not an object, names a
    key twice, or holds NaN or infinity.
    """
    return parse_json(read_bytes(path, limit=limit), str(path))


def parse_json(text: bytes | str, where: str) -> dict[str, Any]:
    """The object (a dict) that a JSON text holds; `where` names it in errors.  Raises likewise."""
    try:
        text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
        values = sum(map(text.count, "[{,"))
        if values > JSON_VALUES:
            raise BadFile(f"{where}: holds {values:,} values; at most {JSON_VALUES:,} are read")
        found = json.loads(
            text, object_pairs_hook=_unique, parse_constant=_no_constant, parse_float=_finite
        )
    except UnicodeDecodeError:
        raise BadFile(f"{where}: not JSON: it is not UTF-8 text") from None
    except RecursionError:
        raise BadFile(f"{where}: not JSON that can be read: nested too deeply") from None
    except ValueError as problem:
        raise BadFile(f"{where}: not JSON that can be read: {one_line(problem)}") from None
    if not isinstance(found, dict):
        raise BadFile(f"{where}: holds a {type(found).__name__}; a JSON object {{...}} is expected")
    return found


def read_toml(path: str | os.PathLike, *, limit: int) -> dict[str, Any]:
    """The table that a TOML file holds.

    Raises BadFile: the file cannot be read, is too large, or is not TOML.
    """
    data = read_bytes(path, limit=limit)
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:  # ValueError: of UTF-8, TOML, huge numbers
        raise BadFile(f"{path}: is not TOML that can be read: {one_line(problem)}") from None


def json_text(content: dict[str, Any], where: str, *, indent: int | None = 1) -> str:
    """JSON of a dict; NumPy and JAX numbers and arrays become numbers and lists.

    Raises BadFile: it holds NaN, infinity or something that JSON has no word for.
    """
    try:
        return json.dumps(content, indent=indent, allow_nan=False, default=_plain)
    except (TypeError, ValueError, RecursionError) as problem:
        raise BadFile(f"{where}: cannot be written as JSON: {one_line(problem)}") from None


def write_json(path: str | os.PathLike, content: dict[str, Any]) -> Path:
    """Write a dict as JSON, atomically.  Raises as `json_text` and `write_atomic`."""
    return write_atomic(path, json_text(content, str(path)) + "\n")


def inside(folder: str | os.PathLike, relative: Any) -> Path:
    """The path of a file that a data file names, which must lie inside `folder`.

    Raises BadFile: an empty or absolute path, one with `..` or a backslash, or a symbolic link that
    leads out of the folder.
    """
    folder = Path(folder)
    if not isinstance(relative, str) or not relative.strip() or "\0" in relative:
        raise BadFile(f"{folder}: {quoted(relative)} is not a file name")
    path = PureWindowsPath(relative)  # which sees drives, and both kinds of slash
    plain = not (path.drive or path.root or "\\" in relative or ".." in path.parts)
    with refused(folder / relative, "cannot be resolved"):
        if not (plain and (folder / relative).resolve().is_relative_to(folder.resolve())):
            raise BadFile(
                f"{folder}: path {quoted(relative)} is not allowed; it must lead into the folder, "
                "with / between names and without '..'"
            )
    return folder / relative


def lock(handle: int) -> bool:
    """Keep other programs off an open file or folder until it is closed; False: one has it.

    Raises OSError: nothing can be locked here, as on some network disks.
    """
    from filelock import lock_descriptor  # 0.1 s

    return lock_descriptor(handle, blocking=False)


@contextmanager
def parents(path: Path) -> Iterator[None]:
    """Make the folders above a path; those that were made go again if the block fails."""
    made = [parent for parent in path.parents if not parent.exists()]
    try:
        with refused(path, "cannot be made"):
            path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for parent in made:
            with suppress(OSError):
                parent.rmdir()
        raise


def temp_beside(path: Path) -> Path:
    """A name for a temporary file or folder on the same file system, so that a rename is enough."""
    return path.parent / f".{path.name[:80]}.{secrets.token_hex(6)}.tmp"


def write_new(path: Path, data: bytes) -> None:
    """Write a file that is not there yet, onto the disk."""
    with path.open("xb") as file:  # exclusive: a file of that name, or a link, is never followed
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def remove_file(path: Path) -> None:
    """Remove a file, if it is there and can be."""
    with suppress(OSError, ValueError):
        path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Put a rename on disk where folders can be synced (not on Windows or some network disks)."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        ((twice, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"{quoted(twice)} is there twice")
    return found


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{one_line(text, 40)} is too large for a number")
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, os.PathLike):
        raise TypeError("a path; write it as text relative to the folder")
    if hasattr(value, "tolist"):  # of NumPy and JAX, which give a number where there is one
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} is not a JSON value")
