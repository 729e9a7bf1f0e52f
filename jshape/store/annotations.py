"""Data sets whose boxes were found by a program: what it found, what a person changed, pictures.

`pairs.csv` gets one column more, `found`: the box `u v width height` that the program wrote.  A row
whose own box says something else was edited, and one without it was written by hand; both count as
drawn by hand.  Readers that only want pairs do not look at the column.
"""

import csv
import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.errors import BadDataset, quoted
from jshape.store.cameras import write_camera
from jshape.store.datasets import CAMERA, COLUMNS, CONTENTS, TABLE, TABLE_LIMIT, Adder
from jshape.store.files import read_bytes, write_atomic
from jshape.store.folders import atomic_folder

FOUND = "found"
"""Name of the column."""
TIMELINE = "segments.png"
"""How a recording was cut."""
_PAGES = 999


def sheet_name(page: int) -> str:
    """File name of a page of the contact sheet, counted from 0.

    Raises:
      BadDataset: more pages than a folder is allowed.
    """
    if page >= _PAGES:
        raise BadDataset(f"a contact sheet has at most {_PAGES} pages; annotate fewer pairs")
    return "contact_sheet.png" if page == 0 else f"contact_sheet_{page + 1:03d}.png"


FOUND_CONTENTS = (*CONTENTS, TIMELINE, *(sheet_name(page) for page in range(_PAGES)))
"""What the folder of such a data set holds, at the top."""


@contextmanager
def found_writer(
    folder: str | os.PathLike, camera: Camera, depth_unit: float, *, overwrite: bool = False
) -> Iterator["FoundAdder"]:
    """A data set written pair by pair, with the column `found` and pictures beside it.

    Raises:
      BadDataset: no pair was added.
      BadFile: the folder exists or cannot be written.
    """
    with atomic_folder(folder, overwrite, contents=FOUND_CONTENTS) as temp:
        write_camera(temp / CAMERA, camera, depth_unit)
        adder = FoundAdder(Adder(str(folder), temp, camera))
        yield adder
        if not adder.by_hand:
            raise BadDataset(f"{folder}: no pairs were added")
        rows = list(csv.reader(io.StringIO(adder.pairs.table(), newline="")))
        table = io.StringIO()
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow([*rows[0], FOUND])
        for row, by_hand in zip(rows[1:], adder.by_hand, strict=True):
            box = row[len(COLUMNS) - 4 : len(COLUMNS)]
            writer.writerow([*row, "" if by_hand else " ".join(box)])
        write_atomic(temp / TABLE, table.getvalue())
        for name, content in adder.pictures.items():
            write_atomic(temp / name, content)


@dataclass
class FoundAdder:
    """Adds pairs to a data set whose boxes were found."""

    pairs: Adder
    by_hand: list[bool] = field(default_factory=list)
    pictures: dict[str, bytes] = field(default_factory=dict)
    """PNG files to write beside the table, by their names."""

    def __call__(self, *, by_hand: bool = False, **pair: Any) -> None:
        """Add a pair, as `dataset_writer` takes it; `by_hand`: a person drew its box."""
        self.pairs(**pair)
        self.by_hand.append(by_hand)


def boxes_by_hand(folder: str | os.PathLike) -> np.ndarray:
    """Which boxes of a data set a person drew or changed: (N,) bool, in the order of `load_pairs`.

    The table must have been read by `load_pairs` before, which checks it.

    Raises:
      BadDataset: the table cannot be read.
    """
    _, rows = _table(Path(folder))
    return np.array([_own(row) != row.get(FOUND, "").split() for row in rows], bool)


def write_boxes(folder: str | os.PathLike, boxes: Mapping[str, tuple[int, int, int, int]]) -> None:
    """Give pairs the boxes that a person drew; all else in `pairs.csv` stays as it is.

    Args:
      folder: a data set that `load_pairs` has read.
      boxes: (left, top, width, height) by the pairs' ids, inside the image.

    Raises:
      BadDataset: the table cannot be read, or has no such pair.
      BadFile: it cannot be written.
    """
    header, rows = _table(Path(folder))
    unknown = boxes.keys() - {row["id"] for row in rows}
    if unknown:
        raise BadDataset(f"{folder}: has no pair {quoted(sorted(unknown)[0])}")
    table = io.StringIO()
    writer = csv.DictWriter(table, header, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        if row["id"] in boxes:
            left, top, width, height = boxes[row["id"]]
            row |= {"u": left + width // 2, "v": top + height // 2}
            row |= {"width": width, "height": height}
        writer.writerow(row)
    write_atomic(Path(folder) / TABLE, table.getvalue())


def _table(folder: Path) -> tuple[list[str], list[dict[str, Any]]]:
    """Header and rows of a table that `load_pairs` has read."""
    text = read_bytes(folder / TABLE, limit=TABLE_LIMIT).decode("utf-8-sig")
    lines = csv.reader(io.StringIO(text, newline=""))
    header = [name.strip() for name in next(lines)]
    rows = [[cell.strip() for cell in cells] for cells in lines]
    return header, [dict(zip(header, cells, strict=True)) for cells in rows if any(cells)]


def _own(row: dict[str, str]) -> list[str]:
    return [str(int(row[name])) for name in COLUMNS[-4:]]
