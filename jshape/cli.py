"""`jshape ...`: reads arguments, calls the library, prints.  Exit code 0, or 2 with one line."""

import io
import json
import os
import sys
from collections.abc import Sequence

from jshape.commands import (
    arguments,
    calibrate,
    camera,
    dataset,
    demo,
    evaluate,
    execute,
    experiment,
    mold,
    plan,
    record,
    train,
    waypoints,
)
from jshape.devices import remember_compiled
from jshape.errors import JShapeError

COMMANDS = (
    *(demo, plan, mold, execute, dataset, train, evaluate, experiment),
    *(record, camera, calibrate, waypoints),
)
"""Each adds its parser; a new command is one file and its name here."""


def build_parser() -> arguments.Parser:
    """All commands and their options."""
    parser = arguments.Parser(
        prog="jshape", description="Mold soft material by shaping depth images."
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", parser_class=arguments.Parser
    )
    for module in COMMANDS:
        module.add(commands)
    return parser


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
    remember_compiled()
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
