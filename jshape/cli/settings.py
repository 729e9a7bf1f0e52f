"""The configuration file: options of commands written down once, so that commands stay short.

Each key is the long name of an option.  It reaches the commands that have the option, but those of
`OWN_TABLE`; within a table such as `[plan]` or `[dataset-simulate]` it reaches that command only.
The command line beats the file.
"""

import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

from cyclopts import Argument, Token

from jshape.cli import COMMANDS
from jshape.cli.commands import EACH_TIME, Leaf, build_app, leaves
from jshape.errors import BadSetting, UnknownName, did_you_mean, one_line, quoted

NAME, VARIABLE, OFF = "jshape.toml", "JSHAPE_CONFIG", "off"
LIMIT = 64 * 1024
"""Largest file that is read, bytes."""
OF_A_CAMERA, FROM_FILES = ("window", "depth-range"), ("plan", "goal", "heightmap")
"""Options that say how to look through a camera, and commands that take frames which may be cut
already: they read these only from tables of their own."""
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
    """What `--config` says on a command line, and the line without it.

    Raises:
      BadSetting: it says nothing.
    """
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
    """The file that applies, of the name that `--config` gave or of none.

    Raises:
      BadSetting: it was named and is not there.
    """
    name = name or os.environ.get(VARIABLE)
    path = Path(name or NAME)
    if name == OFF or not (name or os.path.lexists(path)):
        return None
    if not os.path.lexists(path):
        raise BadSetting(f"{path}: no such configuration file (--config {OFF}: without one)")
    return path


def apply(leaf: Leaf, file: Path, arguments: Iterable[Argument]) -> list[str]:
    """Give a command's arguments what a file says of those that were not given; returns the keys.

    Raises:
      BadSetting: a key or a table that no command has, or a value that the option does not take.
    """
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
    """What a file says of a command's options, by key.

    Raises:
      BadSetting: as for `apply`, but for values that the option's type does not take.
    """
    content = read(file)
    mine, table = leaf.settable, leaf.table
    tables = {name: part for name, part in content.items() if isinstance(part, dict)}
    shared = {name: value for name, value in content.items() if name not in tables}
    _check_tables(tables, file)
    if not leaf.shared or any(name not in mine for name in shared):
        _check_shared(shared, file)
    given: dict[str, Given] = {}
    if table in FROM_FILES:
        shared = {name: value for name, value in shared.items() if name not in OF_A_CAMERA}
    layers = {"": shared if leaf.shared else {}, table: tables.get(table, {})}
    for name, part in layers.items():
        where = f"{file}: [{name}] " if name else f"{file}: "
        for key in part if name else [key for key in part if key in mine]:
            if key not in mine:
                raise BadSetting(where + _unknown(key, mine))
            try:
                tokens = tokens_of(mine[key], key, part[key], file.parent, where)
            except BadSetting as problem:
                raise BadSetting(f"{where}{key}: {problem}") from None
            for rival in excluded(key):
                if rival in given and given[rival].table == name:
                    raise BadSetting(f"{where}{key}: excludes {rival}; give one of them")
                given.pop(rival, None)
            given[key] = Given(key, mine[key], part[key], name, tokens)
    return given


def excluded(key: str) -> list[str]:
    """The options that cannot be given together with one."""
    return [one for group in EXCLUDE if key in group for one in group if one != key]


def read(file: Path) -> dict[str, Any]:
    """What a file holds, its keys with dashes as on the command line.

    Raises:
      BadSetting: it cannot be read, or is not TOML.
    """
    from jshape.io.files import read_bytes  # which needs NumPy

    if file.is_file() and not file.stat().st_size:
        return {}
    try:
        content = tomllib.loads(read_bytes(file, limit=LIMIT).decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:  # ValueError: not UTF-8, not TOML, huge numbers
        raise BadSetting(f"{file}: not TOML that can be read: {one_line(problem)}") from None
    tables = {k: _dashed(v, file) if isinstance(v, dict) else v for k, v in content.items()}
    return _dashed(tables, file)


def tokens_of(argument: Argument, key: str, value: Any, folder: Path, where: str) -> list[Token]:
    """A value of a file as the command line would have given it; files are relative to `folder`.

    Raises:
      BadSetting: it is of another kind than the option's.
    """
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
    elif isinstance(value, list) and value and all(_is_number(one) for one in value):
        value = [",".join(str(one) for one in value)]  # as --strengths takes them
    else:
        value = [value]
    texts = [_read(argument, key, one, folder) for one in value]
    token = partial(Token, keyword=f"--{key}", source=where)
    return [token(value=text, index=index) for index, text in enumerate(texts)]


def _read(argument: Argument, key: str, value: Any, folder: Path) -> str:
    kinds = {argument.hint, *get_args(argument.hint)}
    kinds |= {part for kind in kinds for part in get_args(kind)}
    number = bool({int, float} & kinds)
    if not isinstance(value, str) and not (number and _is_number(value)):
        raise BadSetting(f"{_text(value)} is not {'a number or text' if number else 'text'}")
    text = str(value)
    if Path in kinds or key in NAMES_OR_FILES:
        text = _from_folder(text, folder, always=Path in kinds)
    return text


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


def _dashed(content: Mapping[str, Any], file: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in content.items():
        key = name.replace("_", "-")
        if key in found:
            raise BadSetting(f"{file}: {key} is there twice")
        if key in EACH_TIME:
            raise BadSetting(
                f"{file}: {key} is not taken from a file: --{key} is said each time, at the "
                "command line"
            )
        found[key] = value
    return found


def _check_tables(tables: Mapping[str, Any], file: Path) -> None:
    """Refuse a table that cannot be a command's; those of its subcommands `check` knows."""
    for name in tables:
        if not any(name == one or name.startswith(f"{one}-") for one in COMMANDS):
            raise BadSetting(f"{file}: {UnknownName('table', name, COMMANDS)}")


def _check_shared(shared: Mapping[str, Any], file: Path) -> None:
    known = {key for leaf in leaves(build_app()) if leaf.shared for key in leaf.settable}
    for key in shared:
        if key not in known:
            raise BadSetting(f"{file}: {_unknown(key, sorted(known))}")


def _unknown(key: str, known: Sequence[str] | Mapping[str, Any]) -> str:
    near = did_you_mean(key, known)
    return f"unknown key {quoted(key)}{near or '; allowed: ' + ', '.join(known)}"
