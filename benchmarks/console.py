"""What the commands of `benchmarks` share: values of options, tables, progress, one-line errors."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

from jshape.errors import JShapeError, one_line


def positive_count(text: str) -> int:
    """A whole number from 1."""
    return _number(text, int, lambda x: x > 0, "a whole number from 1")


def positive(text: str) -> float:
    """A finite number above 0."""
    return _number(text, float, lambda x: 0 < x < float("inf"), "a positive number")


def seed(text: str) -> int:
    """A seed of 32 bits."""
    return _number(text, int, lambda x: 0 <= x < 2**32, "a seed from 0 to 4294967295")


def _number(text: str, kind: Callable, allowed: Callable, what: str) -> Any:
    try:
        if allowed(value := kind(text)):
            return value
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not {what}")


def run(program: str, parser: argparse.ArgumentParser, words: Sequence[str] | None) -> int:
    """Run the function that a parsed command line names; an error of ours is one line.

    Args:
      program: what errors begin with.
      parser: sets `run`, a function of the options, for each command.
      words: the command line; None is that of this process.

    Returns:
      The exit code.
    """
    options = parser.parse_args(words)
    try:
        return options.run(options) or 0
    except JShapeError as problem:
        print(f"{program}: error: {one_line(problem, 2000)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return 130
