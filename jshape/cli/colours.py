"""Colours on a terminal: of errors, warnings and heads of tables, and nowhere else."""

import os
import sys
from typing import Any

CODES = {"error": "1;31", "warning": "33", "good": "32", "head": "1", "quiet": "2"}
"""What is coloured, and how a terminal is told (ANSI)."""


def coloured(text: str, what: str, stream: Any = None) -> str:
    """The text with colour codes around it, if whoever reads the stream sees colours.

    Args:
      text: one line.
      what: a name of `CODES`.
      stream: where it will be printed; None is stdout.
    """
    return f"\033[{CODES[what]}m{text}\033[0m" if shows_colours(stream or sys.stdout) else text


def shows_colours(stream: Any) -> bool:
    """Whether a stream is a terminal that shows colours, and nobody said no (no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    try:
        return stream.isatty()
    except (AttributeError, ValueError):  # closed, or not even a stream
        return False
