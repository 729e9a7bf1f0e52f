"""Kinds of options that commands share: how they are read from the command line, and refused."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from jshape.cli import COMMANDS
from jshape.cli.colours import coloured
from jshape.errors import UnknownName, did_you_mean, one_line, quoted

STRIDE = 8
"""Pixels between the places where dense plans try actions."""
STRENGTHS = (0.25, 0.5, 1.0, 1.6)
"""How deep actions are tried where places are dense, unless one says otherwise."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line and say which name may have been meant."""

    def __init__(self, *more: Any, **options: Any):
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*more, **options)
        self.color = False  # Python 3.14 would colour the help, and only the help

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        said = f"{one_line(message, 2000)} (see {self.prog} --help)"
        self.exit(2, f"{self.prog}: {coloured('error:', 'error', sys.stderr)} {said}\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As usual, but a command refuses unknown options itself: it knows which may be meant."""
        known = self._option_string_actions
        for word in args or () if self.get_default("run") else ():
            name = word.partition("=")[0]
            if word == "--":
                break
            if word.startswith("--") and not any(one.startswith(name) for one in known):
                self.error(f"unknown option {name}{did_you_mean(name, known)}")
        return super().parse_known_args(args, namespace)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """A value as its type reads it; never empty, and with digits that people can compare."""
        if isinstance(action, argparse._SubParsersAction):  # of which the command takes care
            return super()._get_value(action, arg_string)
        if not arg_string.strip() and arg_string is not action.default:
            raise argparse.ArgumentError(action, "is empty; leave the option out, or give a value")
        foreign = [c for c in arg_string if c.isnumeric() and not c.isascii()]
        if foreign and action.type not in (None, str, Path):
            said = f"{quoted(arg_string)}: numbers are written with the digits 0 to 9"
            raise argparse.ArgumentError(action, said)
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        names = [str(one) for one in action.choices]
        what = "/".join(action.option_strings) or str(action.metavar or action.dest)
        what = "command" if isinstance(action, argparse._SubParsersAction) else f"value of {what}"
        raise argparse.ArgumentError(None, str(UnknownName(what, value, names)))


class Remembered(argparse._StoreAction):
    """Stores a value, and that the command line gave it: a default or a file may be beaten."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        """As usual; the option's name is added to `options.given`."""
        super().__call__(parser, namespace, values, option_string)
        namespace.given = {*getattr(namespace, "given", ()), self.dest}


def command(
    parent: Any,
    name: str,
    run: Callable[[argparse.Namespace], dict[str, Any]],
    what: str = "",
    *,
    writes: bool = True,
    computes: bool = True,
    at_once: bool = False,
) -> Parser:
    """A command's parser, with the options that all commands have.

    Args:
      parent: what `add_subparsers` gave.
      name: of the command.
      run: called with the parsed options; returns what `--json` prints, and may set
        `options.exit_code`.
      what: one line of help; "" takes it from `COMMANDS`.
      writes: it makes a folder or file, which `--overwrite` allows to replace.
      computes: it uses JAX, which keeps what it compiles.
      at_once: it may end at any time while JAX compiles.
    """
    what = what or COMMANDS[name]
    parser = parent.add_parser(name, help=what, description=what)
    parser.set_defaults(run=run, computes=computes, at_once=at_once)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    if writes:
        parser.add_argument("--overwrite", action="store_true", help="replace an earlier result")
    add_config(parser)
    return parser


def add_config(parser: argparse.ArgumentParser) -> None:
    """The option that names a configuration file, or none."""
    # Suppressed: what stands before the command must not be forgotten behind it.
    parser.add_argument(
        "--config",
        metavar="FILE",
        default=argparse.SUPPRESS,
        help="settings (default: $JSHAPE_CONFIG, else jshape.toml here); off: none",
    )


def _number(text: str, kind: Callable[[str], Any], ok: Any, allowed: str) -> Any:
    try:
        value = kind(text)
        if ok(value):
            return value
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{quoted(text)} is not {allowed}")


def count(text: str) -> int:
    """A whole number from 0."""
    return _number(text, int, lambda x: x >= 0, "a whole number from 0")


def positive_count(text: str) -> int:
    """A whole number from 1."""
    return _number(text, int, lambda x: x > 0, "a whole number from 1")


def port(text: str) -> int:
    """A port of this computer; 0 is any free one."""
    return _number(text, int, lambda x: 0 <= x <= 65535, "a port from 0 to 65535")


def seed(text: str) -> int:
    """A seed of 32 bits."""
    return _number(text, int, lambda x: 0 <= x < 2**32, "a seed from 0 to 4294967295")


def positive(text: str) -> float:
    """A finite number above 0."""
    return _number(text, float, lambda x: 0 < x < float("inf"), "a positive number")


def nonnegative(text: str) -> float:
    """A finite number from 0."""
    return _number(text, float, lambda x: 0 <= x < float("inf"), "a number from 0")


def share(text: str) -> float:
    """A number from 0 to 1."""
    return _number(text, float, lambda x: 0 <= x <= 1, "a share from 0 to 1")


def positives(text: str) -> list[float]:
    """Finite numbers above 0 with commas between."""
    return [positive(part) for part in text.split(",")]


def duration(text: str) -> float:
    """A time above 0 in seconds: "5", "5s", "500ms" or "2min"."""
    number, unit = text, "s"
    for name in ("ms", "min", "s"):
        if text.endswith(name):
            number, unit = text.removesuffix(name), name
            break
    size = {"ms": 1e-3, "s": 1.0, "min": 60.0}[unit]
    allowed = "a time above 0, such as 5s, 500ms or 2min"
    try:
        return size * positive(number)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not {allowed}") from None


def use(text: str) -> tuple[str, int]:
    """An action and how often: "knock=2"."""
    name, _, number = text.rpartition("=")
    if not name or not number.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{quoted(text)} is not an action and a number, like knock=2"
        )
    return name, int(number)


def devices(text: str) -> int:
    """A number of devices."""
    return _number(text, int, lambda x: 0 < x <= 64, "a number of devices from 1 to 64")


def add_devices(parser: argparse.ArgumentParser) -> None:
    """The option that says how many devices share the work."""
    parser.add_argument(
        "--devices",
        type=devices,
        metavar="N",
        help="CPU devices that share the work (default: one per core, at most 8)",
    )


# Options that are fields of `learn.training.Training`, with how they are read; None is its default.
TRAINING: dict[str, tuple[Any, str]] = {
    "width": (positive_count, "features of the U-Net's first block (32, the paper's)"),
    "epochs": (positive_count, "most passes over the pairs (500)"),
    "batch": (positive_count, "pairs per step (8)"),
    "learning_rate": (positive, "Adam's step (0.0002)"),
    "patience": (count, "stop after so many epochs without a better loss (50; 0: never)"),
    "validation": (share, "share of the pairs to choose the best epoch by (0.2)"),
    "seed": (seed, "of everything random (0)"),
    "save_every": (positive_count, "epochs between checkpoints (10)"),
}


def add_material(parser: argparse.ArgumentParser) -> None:
    """Of which material a simulated bed is."""
    from jshape.sim.material import MATERIALS

    said = f"of a simulated bed: {', '.join(MATERIALS)} or FILE.toml (flour)"
    parser.add_argument("--material", default="flour", help=said)


def agents_help() -> str:
    """Who may act in a simulation."""
    from jshape.sim.tools import AGENTS

    return f"{', '.join(AGENTS)} or FILE.toml (robot)"
