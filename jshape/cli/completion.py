"""`jshape completion SHELL`: a script that completes commands, options and names.

The script holds everything: a TAB starts no Python.  It is made by shtab.
"""

import argparse
from pathlib import Path
from typing import Any

from jshape.cli import arguments, settings
from jshape.errors import JShapeError

SHELLS = ("bash", "zsh", "fish")
FILES_TOO = (
    *("bank", "start", "camera", "camera-file", "positions"),
    *("material", "agent", "agents"),
)
"""Options whose value may be a name, or a file or folder."""


def completion(options: argparse.Namespace) -> dict[str, Any]:
    """Print the script; with `--json` it is the value of `script`."""
    script = script_of(options.shell)
    if not options.json:
        print(script)
    return {"shell": options.shell, "script": script}


def script_of(shell: str) -> str:
    """The script for a shell.

    Raises:
      JShapeError: shtab is not installed, or too old for this shell.
    """
    try:
        import shtab
    except ImportError:
        raise JShapeError("shell completion needs shtab: pip install shtab") from None
    if shell not in shtab.SUPPORTED_SHELLS:
        raise JShapeError(f"this shtab knows no {shell}: pip install --upgrade shtab")
    from jshape.cli.parser import build_parser

    parser = build_parser()
    names = _names()
    for leaf in settings.leaves(parser):
        for action in leaf._actions:
            if action.nargs == 0 or action.choices is not None:
                continue  # shtab knows
            key = settings.key_of(action) or action.dest
            if action.type is None and key in names:
                action.complete = _words(key, names[key])  # type: ignore[attr-defined]
            elif action.type is Path or key in FILES_TOO:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return shtab.complete(parser, shell)


def _words(key: str, words: tuple[str, ...]) -> dict[str, Any]:
    """What shtab writes into each shell's script for an option that takes one of some words."""
    name, files = f"_jshape_{key.replace('-', '_')}", key in FILES_TOO
    listed = " ".join(words)  # names of banks, actions ...: letters, digits, dots and dashes
    bash = f'  compgen -W "{listed}" -- "$1"\n' + '  compgen -f -- "$1"\n' * files
    zsh = f"  compadd -- {listed}\n" + "  _files\n" * files
    fish = f"  printf '%s\\n' {listed}\n"
    fish += "  __fish_complete_path (commandline -ct)\n" * files
    return {
        **{"bash": name, "zsh": name, "fish": f"({name})"},
        "preamble": {
            "bash": f"{name}() {{\n{bash}}}",
            "zsh": f"{name}() {{\n{zsh}}}",
            "fish": f"function {name}\n{fish}end",
        },
    }


def _names() -> dict[str, tuple[str, ...]]:
    """Words that complete options, by key: what is bundled, and known without looking around."""
    from jshape import PAPER_ACTIONS, list_banks
    from jshape.camera import PRESETS
    from jshape.learn.fit import FITTERS
    from jshape.robot.arms.names import ARMS
    from jshape.robot.cameras.names import CAMERAS
    from jshape.sim import AGENTS, MATERIALS

    banks, kinds, agents = list_banks(), tuple(FITTERS), tuple(AGENTS)
    return {
        "bank": banks, "start": banks, "kind": kinds, "kinds": kinds, "arm": tuple(ARMS),
        "actions": PAPER_ACTIONS.names, "action": PAPER_ACTIONS.names, "agent": agents,
        "agents": agents, "material": tuple(MATERIALS), "camera": tuple(CAMERAS),
        "camera-file": tuple(PRESETS),
    }  # fmt: skip


def add(commands: Any) -> None:
    """The parser of `jshape completion`."""
    parser = arguments.command(commands, "completion", completion, writes=False, computes=False)
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))
