"""What commands print for people: tables, and progress on long work."""

import sys
from collections.abc import Iterable
from typing import Any

from jshape.commands.colours import coloured


def print_table(head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> None:
    """Print columns under a head, as wide as they need."""
    lines = [head, *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for number, line in enumerate(lines):
        text = "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        print(text if number else coloured(text, "head"))


def warn(line: str) -> None:
    """Print what to be careful with, beside the results."""
    print(f"{coloured('warning:', 'warning')} {line}")


def progress(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    """A progress bar on stderr; none when that is not a terminal."""
    from tqdm import tqdm  # not above: `jshape doctor` prints tables where it does not import

    return tqdm(items, total=total, desc=what, disable=not sys.stderr.isatty(), leave=False)
