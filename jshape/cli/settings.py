"""The configuration file: options of commands written down once, so that commands stay short.

Each key is the long name of an option.  It reaches the commands that have the option, but those of
`OWN_TABLE`; within a table such as `[plan]` or `[dataset-simulate]` it reaches that command only.
The command line beats the file.
"""

import argparse
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jshape.cli import COMMANDS, arguments
from jshape.errors import BadSetting, JShapeError, UnknownName, did_you_mean, one_line, quoted

NAME, VARIABLE, OFF = "jshape.toml", "JSHAPE_CONFIG", "off"
LIMIT = 64 * 1024
"""Largest file that is read, bytes."""
EACH_TIME = ("yes", "overwrite", "resume", "restart", "host")
"""What moves an arm unasked, replaces work or lets others in is said each time, at the command
line: a file that happens to lie in a folder must not say it."""
NO_SETTINGS = ("help", "json", "config", "version")
"""Options that say something of one run."""
OWN_TABLE = ("dataset", "train", "evaluate")
"""Commands about data and measurements, which a camera and a bank for molding must not change: keys
outside of their own table do not reach them."""
OF_A_CAMERA, FROM_FILES = ("window", "depth-range"), ("plan", "goal")
"""Options that say how to look through a camera, and commands that take frames which may be cut
already: they read these only from tables of their own."""
NAMES_OR_FILES = ("bank", "camera", "camera-file", "positions", "start")
"""Options that take the name of something, or a file or folder."""


class Given(NamedTuple):
    """A setting that reaches a command."""

    key: str
    action: argparse.Action
    value: Any
    before: Any
    """The option's own default."""
    table: str
    """Where in the file: "" is outside of all tables."""


def named(words: Sequence[str]) -> tuple[str | None, list[str]]:
    """What `--config` says on a command line, and the line without it."""
    before = arguments.Parser(prog="jshape", add_help=False, allow_abbrev=False)
    before.add_argument("--config")
    found, rest = before.parse_known_args(list(words))
    return found.config, rest


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


def leaf_of(parser: argparse.ArgumentParser, words: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of the command that the words name."""
    for word in words:
        parser = _children(parser).get(word, parser)
    return parser


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of all commands that do something."""
    children = _children(parser)
    if not children:
        yield parser
    for child in children.values():
        yield from leaves(child)


def table_of(leaf: argparse.ArgumentParser) -> str:
    """The name of a command's own table: "plan", "dataset-simulate"."""
    return "-".join(leaf.prog.split()[1:])


def options_of(leaf: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """The options of a command that a file may set, by key."""
    found = {}
    for action in leaf._actions if leaf.get_default("computes") else ():
        key = key_of(action)
        if key and key not in (*NO_SETTINGS, *EACH_TIME):
            found[key] = action
    return found


def key_of(action: argparse.Action) -> str:
    """The key of an option: its first long name, or its own; "" for those that have none."""
    long = next((one for one in action.option_strings if one.startswith("--")), "")
    return getattr(action, "setting", long.removeprefix("--"))


def apply(leaf: argparse.ArgumentParser, file: Path | None) -> list[Given]:
    """Make what a file says the defaults of a command's options; returns what it said.

    Raises:
      BadSetting: a key or a table that no command has, or a value that the option does not take.
    """
    given = {} if file is None else settings_for(leaf, file)
    for one in given.values():
        one.action.default, one.action.required = one.value, False
        leaf.set_defaults(**{one.action.dest: one.value})
    return list(given.values())


def settings_for(leaf: argparse.ArgumentParser, file: Path) -> dict[str, Given]:
    """What a file says of a command's options, by key.

    Raises:
      BadSetting: as for `apply`.
    """
    content = read(file)
    mine, table = options_of(leaf), table_of(leaf)
    tables = {name: part for name, part in content.items() if isinstance(part, dict)}
    shared = {name: value for name, value in content.items() if name not in tables}
    _check_tables(tables, file)
    if not _is_shared(leaf) or any(name not in mine for name in shared):
        _check_shared(shared, file)
    given: dict[str, Given] = {}
    if table in FROM_FILES:
        shared = {name: value for name, value in shared.items() if name not in OF_A_CAMERA}
    layers = {"": shared if _is_shared(leaf) else {}, table: tables.get(table, {})}
    for name, part in layers.items():
        where = f"{file}: [{name}] " if name else f"{file}: "
        for key in part if name else [key for key in part if key in mine]:
            if key not in mine:
                raise BadSetting(where + _unknown(key, mine))
            try:
                value = read_value(mine[key], key, part[key], file.parent)
            except JShapeError as problem:
                raise BadSetting(f"{where}{key}: {problem}") from None
            for other in excluded(leaf, mine[key]):
                rival = next((k for k, one in given.items() if one.action is other), None)
                if rival is not None and given[rival].table == name:
                    raise BadSetting(f"{where}{key}: excludes {rival}; give one of them")
                given.pop(rival or "", None)
            given[key] = Given(key, mine[key], value, mine[key].default, name)
    return given


def give_way(
    leaf: argparse.ArgumentParser, given: Sequence[Given], options: argparse.Namespace
) -> None:
    """Take back settings that an option of the command line excludes."""
    for one in given:
        rivals = excluded(leaf, one.action)
        if any(getattr(options, rival.dest) != rival.default for rival in rivals):
            setattr(options, one.action.dest, one.before)


def excluded(leaf: argparse.ArgumentParser, action: argparse.Action) -> list[argparse.Action]:
    """The options that cannot be given together with one."""
    groups = [group._group_actions for group in leaf._mutually_exclusive_groups]
    return [one for group in groups if action in group for one in group if one is not action]


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


def read_value(action: argparse.Action, key: str, value: Any, folder: Path) -> Any:
    """A value of a file as the command line would have read it; files are relative to `folder`.

    Raises:
      BadSetting: it is nothing that the option takes.
    """
    if action.nargs == 0 or isinstance(action, argparse.BooleanOptionalAction):
        if not isinstance(value, bool):
            raise BadSetting(f"{_text(value)} is not true or false")
        return value
    several = action.nargs is not None and action.nargs != "?"
    if several or isinstance(action, argparse._AppendAction):
        if not isinstance(value, list) or not value:
            raise BadSetting(f"{_text(value)} is not a list [...]")
        if isinstance(action.nargs, int) and len(value) != action.nargs:
            raise BadSetting(f"{_text(value)} has {len(value)} values; {action.nargs} are needed")
        return [_read_one(action, key, one, folder) for one in value]
    if isinstance(value, list) and value and all(_is_number(one) for one in value):
        value = ",".join(str(one) for one in value)  # as --strengths takes them
    return _read_one(action, key, value, folder)


def _read_one(action: argparse.Action, key: str, value: Any, folder: Path) -> Any:
    kind: Any = action.type or str
    if not isinstance(value, str) and (kind in (str, Path) or not _is_number(value)):
        expected = "text" if kind in (str, Path) else "a number or text"
        raise BadSetting(f"{_text(value)} is not {expected}")
    text = str(value)
    if kind is Path or key in NAMES_OR_FILES:
        text = _from_folder(text, folder, always=kind is Path)
    try:
        found = kind(text)
    except (argparse.ArgumentTypeError, ValueError, TypeError) as problem:
        raise BadSetting(str(problem)) from None
    if action.choices is not None and found not in action.choices:
        raise UnknownName("value", found, [str(one) for one in action.choices])
    return found


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


def _is_shared(leaf: argparse.ArgumentParser) -> bool:
    """Whether keys outside of tables reach a command."""
    return leaf.prog.split()[1] not in OWN_TABLE


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
    from jshape.cli.parser import build_parser

    reached = filter(_is_shared, leaves(build_parser()))
    known = {key for leaf in reached for key in options_of(leaf)}
    for key in shared:
        if key not in known:
            raise BadSetting(f"{file}: {_unknown(key, sorted(known))}")


def _unknown(key: str, known: Sequence[str] | Mapping[str, Any]) -> str:
    near = did_you_mean(key, known)
    return f"unknown key {quoted(key)}{near or '; allowed: ' + ', '.join(known)}"


def _children(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
