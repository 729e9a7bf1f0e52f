"""Rows of pairs.csv, the table of a data set: what each must say."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np

from jshape import actions
from jshape.camera import Camera
from jshape.errors import BadDataset
from jshape.io.records import OneLine, Range, read_record
from jshape.io.tables import check_action

STRENGTH = "strength"
"""A column that is there if some pair is not of strength 1: how many times as deep as the trained
action it goes."""
PATH = "path_mm"
"""A column that is there if some action has a path: its length along the hand's x, 0 for none."""
OPTIONAL = (STRENGTH, PATH)

_WHOLE = re.compile(r"-?[0-9]{1,6}")
_DECIMAL = re.compile(r"[0-9]{1,6}([.,][0-9]{1,17})?")
_Name = Annotated[str, OneLine(strict=False)]


@dataclass(frozen=True)
class PairRow:
    """A row of pairs.csv, without a user's own columns."""

    id: _Name
    action: _Name
    agent: _Name
    material: _Name
    prior: _Name
    posterior: _Name
    u: int
    v: int
    width: int
    height: int
    strength: Annotated[float, Range(0.001, 100)] = 1.0
    path_mm: Annotated[float, Range(0, 2000, metres_below=2)] = 0.0

    @property
    def roi(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Centre and size."""
        return (self.u, self.v), (self.width, self.height)


COLUMNS = tuple(one.name for one in fields(PairRow) if one.name not in OPTIONAL)
"""The header of pairs.csv."""
NAMES, BOX = COLUMNS[:4], COLUMNS[6:]


def read_row(content: Mapping[str, Any], camera: Camera, where: str) -> PairRow:
    """A row whose ROI lies in the camera's image; else BadDataset."""
    row = read_record(PairRow, content, where, error=BadDataset)
    check_action(row.action, where)
    centre, (w, h) = row.roi
    if w <= 0 or h <= 0:
        raise BadDataset(f"{where}: the ROI is {w}x{h}; its sides must be positive")
    if not actions.fits(camera, np.array([centre]), (w, h))[0]:
        raise BadDataset(
            f"{where}: the {w}x{h} ROI at {centre} leaves the {camera.width}x{camera.height} image"
        )
    return row


def parse_row(cells: Mapping[str, str], camera: Camera, where: str) -> PairRow:
    """The row of a table's cells; raises as `read_row`."""
    there = (name for name in (*COLUMNS, *OPTIONAL) if name in cells)
    return read_row({name: _value(name, cells[name].strip()) for name in there}, camera, where)


def _value(column: str, text: str) -> str | int | float:
    """What a cell says; a number that is not as it should be stays a text."""
    if column in BOX and _WHOLE.fullmatch(text):
        return int(text)
    if column == PATH and not text:
        return 0.0
    if column in OPTIONAL and _DECIMAL.fullmatch(text):
        return float(text.replace(",", "."))
    return text
