"""`jshape ...`: reads arguments, calls the library, prints.  Exit code 0, or 2 with one line."""

import argparse
import io
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from jshape.commands import bank as bank_commands
from jshape.commands import dataset as dataset_commands
from jshape.commands.demo import demo as run_demo
from jshape.commands.plan import plan as run_plan
from jshape.errors import JShapeError


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        self.exit(2, f"{self.prog}: error: {' '.join(message.split())} (see {self.prog} --help)\n")


def build_parser() -> Parser:
    """All commands and their options."""
    parser = Parser(prog="jshape", description="Mold soft material by shaping depth images.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands_ = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    demo = _command(
        commands_,
        "demo",
        run_demo,
        "simulate a bed and a goal, plan, act in closed loop, write pictures and a report",
    )
    demo.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder for the run")
    demo.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    demo.add_argument("--seed", type=_seed, default=0, help="another bed and goal")
    demo.add_argument("--actions", type=_count, default=4, help="actions that make the goal")
    demo.add_argument("--max-steps", type=_count, default=8, help="most actions to apply")
    demo.add_argument("--material", default="flour", help="flour, sand or dough")
    demo.add_argument("--agent", default="robot", help="who acts: robot or human")
    demo.add_argument("--open-loop", action="store_true", help="plan once, then act blindly")

    plan = _command(
        commands_,
        "plan",
        run_plan,
        "which actions mold the bed of INITIAL into DESIRED, where and in which order",
    )
    plan.add_argument("initial", type=Path, help="depth image now: 16-bit PNG, TIFF, NPY, EXR")
    plan.add_argument("desired", type=Path, help="the same wanted, or a point cloud (PLY, PCD)")
    plan.add_argument(
        "--camera",
        help="camera.json or a preset (default: camera.json beside INITIAL, else the bank's)",
    )
    plan.add_argument(
        "--reproject",
        action="store_true",
        help="see the frames of another camera or height as the bank's camera would",
    )
    plan.add_argument("--depth-unit", type=_positive, help="metres per count of 16-bit images")
    plan.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    plan.add_argument("--planner", default="greedy", help="which search (default: greedy)")
    plan.add_argument(
        "--positions",
        default="21x15",
        metavar="CxR|FILE",
        help="a grid of places for each action (default: 21x15), or a JSON file with positions",
    )
    plan.add_argument(
        "--clip",
        default="refuse",
        choices=("refuse", "shift", "drop"),
        help="what to do with a place whose ROI leaves the image",
    )
    plan.add_argument("--max-steps", type=_count, default=16, help="most actions (default: 16)")
    plan.add_argument(
        "--min-gain-mm",
        type=_nonnegative,
        default=0.005,
        help="an action must help by more than this (default: 0.005)",
    )
    plan.add_argument(
        "--tolerance-mm",
        type=_nonnegative,
        default=0.0,
        help="stop when the goal is this near",
    )
    plan.add_argument(
        "--max-missing",
        type=_share,
        default=0.1,
        help="largest share of pixels without depth to fill (0.1)",
    )
    plan.add_argument("--out", type=Path, help="folder for plan.json and pictures")

    dataset = commands_.add_parser("dataset", help="make and inspect data sets")
    dataset.set_defaults(help_of=dataset)
    datasets = dataset.add_subparsers(dest="subcommand", metavar="WHAT", parser_class=Parser)
    simulate = _command(
        datasets, "simulate", dataset_commands.simulate, "simulated pairs of frames"
    )
    simulate.add_argument("out", type=Path, help="folder of the new data set")
    simulate.add_argument(
        "--pairs", type=_positive_count, default=25, help="per action and agent (default: 25)"
    )
    simulate.add_argument("--actions", nargs="+", default=None, help="default: all five")
    simulate.add_argument("--agents", nargs="+", default=["robot"], help="robot, human")
    simulate.add_argument("--material", default="flour", help="flour, sand or dough")
    simulate.add_argument("--beds", nargs="+", default=["flat"], help="flat, irregular, curved")
    simulate.add_argument("--frames", type=_positive_count, default=5, help="averaged per look")
    simulate.add_argument("--seed", type=_seed, default=0)
    info = _command(datasets, "info", dataset_commands.info, "what a data set holds", writes=False)
    info.add_argument("dataset", type=Path)

    train = _command(commands_, "train", bank_commands.train, "fit a bank to a data set")
    train.add_argument("dataset", type=Path)
    train.add_argument("--kind", default="D", help="D: the mean difference, no training needed")
    train.add_argument("--out", type=Path, required=True, help="folder of the new bank")
    train.add_argument("--licence", default="", help="licence of the bank, for its manifest")

    evaluate = _command(
        commands_,
        "evaluate",
        bank_commands.evaluate,
        "prediction errors in mm: of a bank, or over random partitions of the data set",
    )
    evaluate.add_argument("dataset", type=Path)
    evaluate.add_argument("--bank", default=None, help="test this bank on the whole data set")
    evaluate.add_argument("--kind", default=None, help="kind to fit to each partition (D)")
    evaluate.add_argument("--partitions", type=_positive_count, default=None, help="how many (4)")
    evaluate.add_argument("--seed", type=_seed, default=0)
    evaluate.add_argument("--out", type=Path, help="folder for the table and a picture")
    return parser


def _command(
    parent: Any, name: str, run: Any, what: str, *, writes: bool = True
) -> argparse.ArgumentParser:
    parser = parent.add_parser(name, help=what, description=what)
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    if writes:
        parser.add_argument("--overwrite", action="store_true", help="replace an earlier result")
    return parser


def _number(text: str, kind: type, ok: Any, allowed: str) -> Any:
    try:
        value = kind(text)
        if ok(value):
            return value
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not {allowed}")


def _count(text: str) -> int:
    return _number(text, int, lambda x: x >= 0, "a whole number from 0")


def _positive_count(text: str) -> int:
    return _number(text, int, lambda x: x > 0, "a whole number from 1")


def _seed(text: str) -> int:
    return _number(text, int, lambda x: 0 <= x < 2**32, "a seed from 0 to 4294967295")


def _positive(text: str) -> float:
    return _number(text, float, lambda x: 0 < x < float("inf"), "a positive number")


def _nonnegative(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x < float("inf"), "a number from 0")


def _share(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x <= 1, "a share from 0 to 1")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    parser = build_parser()
    options = parser.parse_args(arguments)
    if options.version:
        from jshape import __version__

        print(__version__)
        return 0
    if not hasattr(options, "run"):
        getattr(options, "help_of", parser).print_help(sys.stderr)
        return 2
    try:
        result = options.run(options)
        if options.json:
            print(json.dumps(result))
        sys.stdout.flush()
    except JShapeError as problem:
        print(f"jshape: error: {' '.join(str(problem).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("jshape: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has left: nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as problem:
        print(f"jshape: error: output cannot be printed: {problem.strerror}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
