"""The configuration file: options of commands written down once, so that commands stay short.

Each key is the long name of an option.  It reaches the commands that have the option, but those of
`OWN_TABLE`; within a table such as `[plan]` or `[dataset-simulate]` it reaches that command only.
The command line beats the file.
"""

import os
import tomllib
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from cyclopts import Argument, Token

from jshape.cli import COMMANDS
from jshape.cli.commands import EACH_TIME, Leaf, build_app, leaves
from jshape.errors import BadSetting, UnknownName, did_you_mean, one_line, quoted

NAME, VARIABLE, OFF = "jshape.toml", "JSHAPE_CONFIG", "off"
LIMIT = 64 * 1024
"""Largest file that is read, bytes."""
CAMERA_FILE = "camera-file"
NAMES_OR_FILES = ("bank", "camera", CAMERA_FILE, "positions", "reachable", "start")
"""Options that take the name of something, or a file or folder."""


EXCLUDE = (
    ("positions", "stride"),
    ("text", "mask", "height-map", "mesh", "frame", "actions"),
)
"""Options of which only one can be given."""


class Given(NamedTuple):
    """A setting that reaches a command."""

    key: str
    argument: Argument
    value: Any
    table: str
    """Where in the file: "" is outside of all tables."""
    tokens: list[Token]


def named(words: Sequence[str]) -> tuple[str | None, list[str]]:
    """What `--config` says on a command line, and the line without it."""
    found, rest = None, []
    left = iter(words)
    for word in left:
        if word == "--":
            rest += [word, *left]
        elif word.partition("=")[0] == "--config":
            found = word.partition("=")[2] if "=" in word else next(left, "")
            if not found:
                raise BadSetting("--config: needs the name of a file, or off")
        else:
            rest.append(word)
    return found, rest


def file_of(name: str | None) -> Path | None:
    """The file that applies, of the name that `--config` gave or of none."""
    name = name or os.environ.get(VARIABLE)
    path = Path(name or NAME)
    if name == OFF or not (name or os.path.lexists(path)):
        return None
    if not os.path.lexists(path):
        raise BadSetting(f"{path}: no such configuration file (--config {OFF}: without one)")
    return path


def apply(leaf: Leaf, file: Path, arguments: Iterable[Argument]) -> list[str]:
    """Give a command's arguments, unless they were given, what a file says; returns the keys."""
    found = settings_for(leaf, file)
    mine = {one.name: one for one in arguments}
    said = {one.name.lstrip("-") for one in mine.values() if one.tokens}
    for key, one in found.items():
        if key in said or said.intersection(excluded(key)) or mine[one.argument.name].tokens:
            continue
        for token in one.tokens:
            mine[one.argument.name].append(token)
    return list(found)


def settings_for(leaf: Leaf, file: Path) -> dict[str, Given]:
    """What a file says of a command's options, by key."""
    rows = [row for row in read(file) if row.table in ("", leaf.table)]
    elsewhere = {row.key for row in rows if not row.table} - leaf.shared.keys()
    if elsewhere:
        known = {key for one in leaves(build_app()) for key in one.shared}
        for key in sorted(elsewhere - known):
            raise BadSetting(f"{file}: {_unknown(key, sorted(known))}")
    given: dict[str, Given] = {}
    for table, key, value in rows:
        where = f"{file}: [{table}] " if table else f"{file}: "
        takes = leaf.settable if table else leaf.shared
        if key not in takes:
            if not table:
                continue
            raise BadSetting(where + _unknown(key, takes))
        try:
            tokens = tokens_of(takes[key], key, value, file.parent, where)
        except BadSetting as problem:
            raise BadSetting(f"{where}{key}: {problem}") from None
        for rival in excluded(key):
            if rival in given and given[rival].table == table:
                raise BadSetting(f"{where}{key}: excludes {rival}; give one of them")
            given.pop(rival, None)
        given[key] = Given(key, takes[key], value, table, tokens)
    return given


def excluded(key: str) -> list[str]:
    """The options that cannot be given together with one."""
    return [one for group in EXCLUDE if key in group for one in group if one != key]


class Setting(NamedTuple):
    """A line of the file; its key with dashes, as on the command line."""

    table: str
    key: str
    value: Any


def read(file: Path) -> list[Setting]:
    """What a file says, outside of tables first."""
    from jshape.io.files import read_bytes  # which needs NumPy

    if file.is_file() and not file.stat().st_size:
        return []
    try:
        content = tomllib.loads(read_bytes(file, limit=LIMIT).decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:  # ValueError: not UTF-8, not TOML, huge numbers
        raise BadSetting(f"{file}: not TOML that can be read: {one_line(problem)}") from None
    rows: dict[tuple[str, str], Setting] = {}
    tables = {name: part for name, part in content.items() if isinstance(part, dict)}
    shared = {name: value for name, value in content.items() if name not in tables}
    for name, part in {"": shared, **tables}.items():
        table = name.replace("_", "-")
        if table and not any(table == one or table.startswith(f"{one}-") for one in COMMANDS):
            raise BadSetting(f"{file}: {UnknownName('table', table, COMMANDS)}")
        for key, value in ((key.replace("_", "-"), value) for key, value in part.items()):
            if (table, key) in rows:
                raise BadSetting(f"{file}: {key} is there twice")
            if key in EACH_TIME:
                raise BadSetting(
                    f"{file}: {key} is not taken from a file: --{key} is said each time, at the "
                    "command line"
                )
            rows[table, key] = Setting(table, key, value)
    return list(rows.values())


def tokens_of(argument: Argument, key: str, value: Any, folder: Path, where: str) -> list[Token]:
    """A value of a file as the command line would have given it; files are relative to `folder`."""
    if argument.is_flag():
        if not isinstance(value, bool):
            raise BadSetting(f"{_text(value)} is not true or false")
        return [Token(keyword=f"--{key}", source=where, implicit_value=value)]
    many, rest = argument.token_count()
    if argument.parameter.n_tokens is None and (many != 1 or rest):
        if key in ("camera", CAMERA_FILE) and isinstance(value, str):  # the only one
            value = [value]
        if not isinstance(value, list) or not value:
            raise BadSetting(f"{_text(value)} is not a list [...]")
        if not rest and len(value) != many:
            raise BadSetting(f"{_text(value)} has {len(value)} values; {many} are needed")
    elif isinstance(value, list) and value and all(map(_is_number, value)):
        value = [",".join(map(str, value))]  # as --strengths takes them
    else:
        value = [value]
    texts = [_read(argument, key, one, folder) for one in value]
    return [
        Token(keyword=f"--{key}", source=where, value=text, index=k) for k, text in enumerate(texts)
    ]


def _read(argument: Argument, key: str, value: Any, folder: Path) -> str:
    kinds = {argument.hint, *get_args(argument.hint)}
    kinds |= {part for kind in kinds for part in get_args(kind)}
    number = bool({int, float} & kinds)
    if not isinstance(value, str) and not (number and _is_number(value)):
        raise BadSetting(f"{_text(value)} is not {'a number or text' if number else 'text'}")
    if Path in kinds or key in NAMES_OR_FILES:
        return _from_folder(str(value), folder, always=Path in kinds)
    return str(value)


def _from_folder(text: str, folder: Path, always: bool) -> str:
    """A file's name seen from the folder of the configuration; a name of something else stays."""
    kind, colon, rest = text.rpartition(":")  # realsense:FILE.db3
    start = f"{kind}{colon}" if colon and kind.isalpha() and len(kind) > 1 else ""
    path = folder / Path(text.removeprefix(start)).expanduser()
    there = bool(text.removeprefix(start)) and os.path.lexists(path)
    return f"{start}{path}" if there or always else text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Any) -> str:
    """A value as TOML writes it, more or less."""
    if isinstance(value, bool):
        return str(value).lower()
    return "a table" if isinstance(value, dict) else quoted(value)


def _unknown(key: str, known: Collection[str]) -> str:
    near = did_you_mean(key, known)
    return f"unknown key {quoted(key)}{near or '; allowed: ' + ', '.join(known)}"
