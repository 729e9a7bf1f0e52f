"""Data sets whose boxes were found by a program: what it found, what a person changed, pictures.

`pairs.csv` gets one column more, `found`: the box `u v width height` that the program wrote.  A row
whose own box says something else was edited, and one without it was written by hand; both count as
drawn by hand.  Readers that only want pairs do not look at the column.
"""

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.errors import BadDataset, quoted
from jshape.io.datasets import COLUMNS, CONTENTS, TABLE, Adder, dataset_writer
from jshape.io.files import write_atomic
from jshape.io.tables import read_table

FOUND = "found"
"""Name of the column."""
TIMELINE = "segments.png"
"""How a recording was cut."""
_PAGES = 999
_BOX = COLUMNS[-4:]


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


class FoundAdder(Adder):
    """Adds pairs to a data set whose boxes were found."""

    def __call__(self, *, by_hand: bool = False, extra: Any = None, **pair: Any) -> None:
        """Add a pair, as `Adder` does; `by_hand`: a person drew its box."""
        own = {name: text for name, text in (extra or {}).items() if name != FOUND}
        box = " ".join(str(pair[name]) for name in _BOX)
        super().__call__(**pair, extra=own | {FOUND: "" if by_hand else box})


def found_writer(
    folder: str | os.PathLike, camera: Camera, depth_unit: float, *, overwrite: bool = False
) -> AbstractContextManager[FoundAdder]:
    """A data set with the column `found` and pictures beside it: see `dataset_writer`."""
    return dataset_writer(
        folder, camera, depth_unit, overwrite=overwrite, contents=FOUND_CONTENTS, adder=FoundAdder
    )


def boxes_by_hand(folder: str | os.PathLike) -> np.ndarray:
    """Which boxes of a data set a person drew or changed: (N,) bool, in the order of `load_pairs`.

    The table must have been read by `load_pairs` before, which checks it.

    Raises:
      BadDataset: the table cannot be read.
    """
    rows = read_table(Path(folder) / TABLE, COLUMNS).rows
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
    table = read_table(Path(folder) / TABLE, COLUMNS)
    unknown = boxes.keys() - {row["id"].strip() for row in table.rows}
    if unknown:
        raise BadDataset(f"{folder}: has no pair {quoted(min(unknown))}")
    for row in table.rows:
        if row["id"].strip() in boxes:
            left, top, width, height = boxes[row["id"].strip()]
            box = (left + width // 2, top + height // 2, width, height)
            row |= dict(zip(_BOX, map(str, box), strict=True))
    write_atomic(Path(folder) / TABLE, table.text())


def _own(row: dict[str, str]) -> list[str]:
    return [str(int(row[name])) for name in _BOX]
