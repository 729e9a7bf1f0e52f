"""`jshape config [COMMAND]` and `jshape config --init`."""

import argparse
import os
from pathlib import Path
from typing import Any

from jshape.cli import arguments, settings
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

# A table is for one command: [plan], [mold], [camera-check], [dataset-simulate] ...
#[plan]
#positions = "41x31"
#strengths = [0.25, 0.5, 1, 1.6]

#[mold]
#stride = 8
#frames = 15
"""


def config(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape config`: what applies and where it comes from; with `--init` the example's file."""
    named = getattr(options, "config", None)
    if options.init:
        return _init(Path(named or os.environ.get(settings.VARIABLE) or settings.NAME), options)
    from jshape.cli.parser import build_parser

    file = settings.file_of(named)
    leaves = {settings.table_of(leaf): leaf for leaf in settings.leaves(build_parser())}
    spoken = {name: " ".join(leaf.prog.split()[1:]) for name, leaf in leaves.items()}
    if file is not None:
        for name in (k for k, part in settings.read(file).items() if isinstance(part, dict)):
            if name not in leaves:
                raise BadSetting(f"{file}: {UnknownName('table', name, leaves)}")
    # All of them: whoever asks wants to know whether the file is in order.
    given = {
        name: settings.settings_for(leaf, file) if file is not None else {}
        for name, leaf in leaves.items()
    }
    if options.of:
        name = "-".join(options.of)
        if name not in leaves:
            raise UnknownName("command", " ".join(options.of), spoken.values())
        rows = _all_of(leaves[name], given[name], file)
    else:
        rows = _said({spoken[name]: found for name, found in given.items()}, file)
    result = {"file": None if file is None else str(file), "settings": rows}
    if not options.json:
        _print(result, of_one=bool(options.of))
    return result


def _init(file: Path, options: argparse.Namespace) -> dict[str, Any]:
    from jshape.io.files import write_atomic

    if os.path.lexists(file):
        raise BadSetting(f"{file}: exists and is not replaced; edit it, or name another")
    write_atomic(file, EXAMPLE)
    if not options.json:
        print(f"an example, all of it behind #: {file}")
    return {"file": str(file)}


def _said(given: dict[str, dict[str, settings.Given]], file: Path | None) -> list[dict[str, Any]]:
    """Each setting of the file once, with the commands that it reaches."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, found in given.items():
        for one in found.values():
            row = rows.setdefault(
                (one.table, one.key),
                {"key": one.key, "value": _plain(one.value), "from": _from(one, file), "of": []},
            )
            row["of"].append(name)
    return list(rows.values())


def _all_of(
    leaf: argparse.ArgumentParser, given: dict[str, settings.Given], file: Path | None
) -> list[dict[str, Any]]:
    """Every option of a command, with where its value comes from."""
    return [
        {"key": key, "value": _plain(given[key].value), "from": _from(given[key], file)}
        if key in given
        else {
            "key": key,
            "value": _plain(getattr(action, "usual", action.default)),
            "from": "default",
        }
        for key, action in settings.options_of(leaf).items()
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


def add(commands: Any) -> None:
    """The parser of `jshape config`."""
    parser = arguments.command(commands, "config", config, writes=False, computes=False)
    parser.add_argument(
        "of", nargs="*", metavar="COMMAND", help="all options of this one, such as dataset simulate"
    )
    parser.add_argument(
        "--init", action="store_true", help=f"write an example to {settings.NAME}, or to --config"
    )
