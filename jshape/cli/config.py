"""`jshape config [COMMAND]` and `jshape config --init`."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jshape.cli import settings
from jshape.cli.commands import Leaf, build_app, leaves
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
        return _init(Path(named), options)
    file = settings.file_of(options.config)
    found = {leaf.table: leaf for leaf in leaves(build_app())}
    spoken = {name: " ".join(leaf.words) for name, leaf in found.items()}
    if file is not None:
        for name in (k for k, part in settings.read(file).items() if isinstance(part, dict)):
            if name not in found:
                raise BadSetting(f"{file}: {UnknownName('table', name, found)}")
    # All of them: whoever asks wants to know whether the file is in order.
    given = {name: settings.settings_for(leaf, file) if file is not None else {}
             for name, leaf in found.items()}  # fmt: skip
    for one in (one for of_one in given.values() for one in of_one.values()):
        value_of(one.argument, one.tokens)
    if command:
        name = "-".join(command)
        if name not in found:
            raise UnknownName("command", " ".join(command), spoken.values())
        rows = _all_of(found[name], given[name], file)
    else:
        rows = _said({spoken[name]: of_one for name, of_one in given.items()}, file)
    result = {"file": None if file is None else str(file), "settings": rows}
    _print(result, of_one=bool(command))
    return result


def _init(file: Path, options: ConfigOptions) -> dict[str, Any]:
    from jshape.io.files import write_atomic

    if os.path.lexists(file):
        raise BadSetting(f"{file}: exists and is not replaced; edit it, or name another")
    write_atomic(file, EXAMPLE)
    print(f"an example, all of it behind #: {file}")
    return {"file": str(file)}


def _said(given: dict[str, dict[str, settings.Given]], file: Path | None) -> list[dict[str, Any]]:
    """Each setting of the file once, with the commands that it reaches."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, found in given.items():
        for one in found.values():
            row = {"key": one.key, "value": one.value, "from": _from(one, file), "of": []}
            rows.setdefault((one.table, one.key), row)["of"].append(name)
    return list(rows.values())


def _all_of(
    leaf: Leaf, given: dict[str, settings.Given], file: Path | None
) -> list[dict[str, Any]]:
    """Every option of a command, with where its value comes from."""
    return [
        {"key": key, "value": given[key].value, "from": _from(given[key], file)}
        if key in given
        else {"key": key, "value": _plain(leaf.usual(argument)), "from": "default"}
        for key, argument in leaf.settable.items()
    ]


def _from(one: settings.Given, file: Path | None) -> str:
    return f"{file} [{one.table}]" if one.table else str(file)


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, Path) else value


def _print(result: dict[str, Any], of_one: bool) -> None:
    if result["file"] is None:
        print(f"no {settings.NAME} here; jshape config --init writes one")
    elif not result["settings"]:
        print(f"{result['file']} sets nothing")
    if not result["settings"]:
        return
    rows = [(r["key"], _shown(r["value"]), r["from"], ", ".join(r.get("of", ())))
            for r in result["settings"]]  # fmt: skip
    head = ("option", "value", "from", "reaches")
    print_table(head[: 3 if of_one else 4], [row[: 3 if of_one else 4] for row in rows])


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
