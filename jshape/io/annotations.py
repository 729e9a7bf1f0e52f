"""Boxes of a data set that a program found, and that a person changed.

A row whose own box is not the one in its column `found` was edited, and one without it was written
by hand; both count as drawn by hand.  Readers that only want pairs do not look at the column.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jshape.errors import BadDataset, quoted
from jshape.io.datasets import FOUND, TABLE
from jshape.io.files import write_atomic
from jshape.io.pair_rows import BOX, COLUMNS
from jshape.io.tables import read_table


def boxes_by_hand(folder: str | os.PathLike) -> np.ndarray:
    """Which boxes of a data set a person drew or changed: (N,) bool, in the order of `load_pairs`.

    The table must have been read by `load_pairs` before, which checks it.

    Raises BadDataset: the table cannot be read.
    """
    rows = read_table(Path(folder) / TABLE, COLUMNS).rows
    own = [[str(int(row[name])) for name in BOX] for row in rows]
    return np.array([a != b.get(FOUND, "").split() for a, b in zip(own, rows, strict=True)], bool)


def write_boxes(folder: str | os.PathLike, boxes: Mapping[str, tuple[int, int, int, int]]) -> None:
    """Give pairs the boxes that a person drew; all else in `pairs.csv` stays as it is.

    `boxes` are (left, top, width, height), inside the image, by the ids of pairs.  The data set has
    been read by `load_pairs`, which checks it.

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
            row |= dict(zip(BOX, map(str, box), strict=True))
    write_atomic(Path(folder) / TABLE, table.text())
