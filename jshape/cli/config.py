"""`jshape config [COMMAND]` and `jshape config --init`."""

import os
from dataclasses import dataclass
from inspect import Parameter
from pathlib import Path
from typing import Any

from cyclopts import Argument

from jshape.cli import settings
from jshape.cli.commands import build_app, leaves
from jshape.cli.options import Common
from jshape.cli.parser import value_of
from jshape.cli.tables import print_table
from jshape.errors import BadSetting, UnknownName

EXAMPLE = """\
# Settings of jshape: the options of its commands, written down once.  The command line beats them.
# A key is an option's long name and reaches the commands that have it; dataset, train and evaluate
# read only tables of their own.  Files are relative to this one.  `jshape config` shows what
# applies.

# The camera: a name as for `jshape record`, and a camera.json to believe instead of what it says.
#camera = "realsense"
#camera-file = "camera.json"
#window = "181,46,480x395"
#depth-range = [0.42, 0.47]

# The bank, where actions are tried, and the search.
#bank = "pressed-flour-robot"
#planner = "greedy"
#error-margin = 0.5

# The arm, and where the camera is in its frame (what `jshape calibrate` wrote).
#arm = "sim:3"
#base = "base.json"
#material = "flour"

# A table is for one command: [plan], [mold], [setup], [dataset-simulate] ...
#[plan]
#positions = "41x31"
#strengths = [0.25, 0.5, 1, 1.6]

#[mold]
#stride = 8
#frames = 15
"""


@dataclass(frozen=True, kw_only=True)
class ConfigOptions(Common):
    """Of `jshape config`."""

    computes = False

    init: bool = False
    """Write an example to jshape.toml, or to --config."""


def config(*command: str, options: ConfigOptions = ConfigOptions()) -> dict[str, Any]:
    """What applies and where it comes from; with `--init` the example's file.

    Args:
      command: Command whose options to list, such as dataset simulate.
    """
    if options.init:
        named = options.config or os.environ.get(settings.VARIABLE) or settings.NAME
        return _init(Path(named))
    file = settings.file_of(options.config)
    found = {leaf.table: leaf for leaf in leaves(build_app())}
    if file is not None:
        for name in {row.table for row in settings.read(file)} - {"", *found}:
            raise BadSetting(f"{file}: {UnknownName('table', name, found)}")
    # All of them: whoever asks wants to know whether the file is in order.
    given = {name: settings.settings_for(leaf, file) if file is not None else {}
             for name, leaf in found.items()}  # fmt: skip
    for one in (one for of_one in given.values() for one in of_one.values()):
        value_of(one.argument, one.tokens)
    rows: list[dict[str, Any]] = []
    if command:
        name = "-".join(command)
        if name not in found:
            known = (" ".join(leaf.words) for leaf in found.values())
            raise UnknownName("command", " ".join(command), known)
        for key, argument in found[name].settable.items():
            row = {"key": key, "value": default_of(argument), "from": "default"}
            rows.append(_row(given[name][key], file) if key in given[name] else row)
    else:  # each setting once, with the commands that it reaches
        reached: dict[tuple[str, str], dict[str, Any]] = {}
        for name, settings_of in given.items():
            for one in settings_of.values():
                row = reached.setdefault((one.table, one.key), _row(one, file) | {"of": []})
                row["of"].append(" ".join(found[name].words))
        rows = list(reached.values())
    result = {"file": None if file is None else str(file), "settings": rows}
    if file is None:
        print(f"no {settings.NAME} here; jshape config --init writes one")
    elif not rows:
        print(f"{file} sets nothing")
    if rows:
        head = ("option", "value", "from", *(() if command else ("reaches",)))
        print_table(head, [_cells(row) for row in rows])
    return result


def _init(file: Path) -> dict[str, Any]:
    from jshape.io.files import write_atomic

    if os.path.lexists(file):
        raise BadSetting(f"{file}: exists and is not replaced; edit it, or name another")
    write_atomic(file, EXAMPLE)
    print(f"an example, all of it behind #: {file}")
    return {"file": str(file)}


def default_of(argument: Argument) -> Any:
    """The default of an option as JSON holds it; None: it has none."""
    default = argument.field_info.default
    if isinstance(default, list | tuple):
        return list(default)
    if default is Parameter.empty:
        return None
    return str(default) if isinstance(default, Path) else default


def _row(one: settings.Given, file: Path | None) -> dict[str, Any]:
    where = f"{file} [{one.table}]" if one.table else str(file)
    return {"key": one.key, "value": one.value, "from": where}


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    value = row["value"]
    if isinstance(value, bool):
        value = str(value).lower()
    elif isinstance(value, list):
        value = ",".join(map(str, value))
    reaches = (", ".join(row["of"]),) if "of" in row else ()
    return row["key"], "-" if value is None else str(value), row["from"], *reaches
