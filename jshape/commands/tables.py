"""What commands print for people: tables, and progress on long work."""

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm


def print_table(head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> None:
    """Print columns under a head, as wide as they need."""
    lines = [head, *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for line in lines:
        print("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip())


def progress(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    """A progress bar on stderr; none when that is not a terminal."""
    return tqdm(items, total=total, desc=what, disable=not sys.stderr.isatty(), leave=False)
