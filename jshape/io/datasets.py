"""Data sets on disk: a folder with `camera.json`, `pairs.csv` and 16-bit depth frames.

Frames are (H, W) uint16 counts of `depth_unit` metres, 0 = no reading.  ROI centres are `(u, v)`
and sizes `(w, h)`, pixels.
"""

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from jshape import actions
from jshape.camera import Camera
from jshape.data.depth import check_unit, to_metres
from jshape.data.pairs import Frames, Pairs
from jshape.errors import BadDataset, BadFile, BadImage, quoted
from jshape.io.cameras import CAMERA, read_camera, write_camera
from jshape.io.files import inside, write_atomic
from jshape.io.folders import atomic_folder
from jshape.io.images import read_counts, write_counts_png
from jshape.io.tables import Table, as_dataset, check_action, read_table

COLUMNS = (
    "id", "action", "agent", "material", "prior", "posterior", "u", "v", "width", "height"
)  # fmt: skip
"""The header of pairs.csv."""
STRENGTH = "strength"
"""A column that is there if some pair is not of strength 1: how many times as deep as the trained
action it goes."""
TABLE = "pairs.csv"
FRAMES = "frames"
CONTENTS = (TABLE, CAMERA, FRAMES)
"""What a data set's folder holds, at the top."""
STRENGTHS = (0.001, 100.0)
"""Least and greatest strength of a pair."""
NAME_LIMIT = 200
"""Most characters of an id, a name or a path."""
IN_MEMORY = 2 * 2**30
"""Most bytes of frames that are kept in memory; of more, each is read when it is needed."""

_NAMES = ("id", "action", "agent", "material")
_NUMBERS = ("u", "v", "width", "height")
_WHOLE = re.compile(r"-?[0-9]{1,6}")
_DECIMAL = re.compile(r"[0-9]{1,6}([.,][0-9]{1,17})?")
_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Control characters, and those that turn the order of others: a terminal obeys them."""


def load_pairs(folder: str | os.PathLike, left_out: Counter[str] | None = None) -> Pairs:
    """All pairs of a data set, in the order of `pairs.csv`.

    Columns may come in any order; those of other names are the pairs' `extra`.  Without the column
    `strength` it is 1 for all.  Frames of more than 2 GiB are checked now and read again when they
    are needed.

    Args:
      folder: the data set's.
      left_out: adds up why pixels of the frames are no readings.

    Raises:
      BadDataset: no such folder, a file or a column is missing, no rows, a bad number, a frame
        that is missing, of another size or not 16-bit single-channel, a ROI that leaves the image,
        an id twice, or a path that leads out of the folder.
      BadCamera: camera.json makes no sense.
    """
    folder = Path(folder)
    camera, depth_unit = _read_camera(folder)
    table = read_table(folder / TABLE, COLUMNS)
    rows = _read_rows(table, folder / TABLE, camera)
    prior, posterior = _read_frames(folder, rows, camera, depth_unit, left_out)

    def names(column: str) -> np.ndarray:
        return np.array([row.texts[column] for row in rows])

    return Pairs(
        camera=camera,
        depth_unit=depth_unit,
        prior=prior,
        posterior=posterior,
        action=names("action"),
        agent=names("agent"),
        material=names("material"),
        centre=np.array([row.centre for row in rows], np.int32),
        size=np.array([row.size for row in rows], np.int32),
        id=names("id"),
        strength=np.array([row.strength for row in rows], np.float32),
        extra={
            name: np.array([cells[name] for cells in table.rows], object)
            for name in table.header
            if name not in (*COLUMNS, STRENGTH)
        },
    )


def save_pairs(pairs: Pairs, folder: str | os.PathLike, overwrite: bool = False) -> Path:
    """Write pairs as a data set, whole or not at all.

    Args:
      pairs: what to write.
      folder: where; it must not hold anything unless `overwrite`.
      overwrite: replace the data set that is there.

    Returns:
      The folder.

    Raises:
      BadDataset: no pairs, or one that could not be read again.
      BadFile: the folder exists or cannot be written.
    """
    with dataset_writer(folder, pairs.camera, pairs.depth_unit, overwrite=overwrite) as add:
        for k in range(len(pairs)):
            add(**row_of(pairs, k))
    return Path(folder)


def row_of(pairs: Pairs, k: int) -> dict[str, Any]:
    """Pair number k as the arguments of a writer's `add`."""
    (u, v), (w, h) = pairs.centre[k].tolist(), pairs.size[k].tolist()
    names = {name: str(getattr(pairs, name)[k]) for name in _NAMES}
    frames = {"prior": pairs.prior[k], "posterior": pairs.posterior[k]}
    numbers = {"u": u, "v": v, "width": w, "height": h, "strength": float(pairs.strength[k])}
    extra = {name: str(cells[k]) for name, cells in pairs.extra.items()}
    return {**names, **frames, **numbers, "extra": extra}


@contextmanager
def dataset_writer(
    folder: str | os.PathLike,
    camera: Camera,
    depth_unit: float,
    *,
    overwrite: bool = False,
    contents: Sequence[str] = CONTENTS,
) -> "Iterator[Adder]":
    """A data set written pair by pair: only one pair is in memory, and the folder appears whole.

        with dataset_writer(folder, camera, 1e-4) as add:
            add(id="poke_0", action="poke", agent="robot", material="flour",
                prior=counts, posterior=counts, u=240, v=197, width=40, height=45)

    Args:
      folder: where; it must not hold anything unless `overwrite`.
      camera: that sees all frames.
      depth_unit: metres per count.
      overwrite: replace the data set that is there.
      contents: what the folder of one that is replaced may hold.

    Yields:
      The function that adds a pair.

    Raises:
      BadDataset: no pair was added, or one that could not be read again.
      BadFile: the folder exists or cannot be written.
      BadCamera: the camera or the unit makes no sense.
    """
    with atomic_folder(folder, overwrite, contents=contents) as temp:
        write_camera(temp / CAMERA, camera, depth_unit)
        adder = Adder(str(folder), temp, camera)
        yield adder
        if not adder.ids:
            raise BadDataset(f"{folder}: no pairs were added")
        for name, content in {TABLE: adder.table(), **adder.pictures}.items():
            write_atomic(temp / name, content)


@dataclass
class Adder:
    """Adds pairs to a data set that is being written."""

    where: str
    folder: Path
    camera: Camera
    rows: list[dict[str, Any]] = field(default_factory=list)
    ids: set[str] = field(default_factory=set)
    extra: dict[str, None] = field(default_factory=dict)
    """Names of the pairs' own columns, in order."""
    pictures: dict[str, bytes] = field(default_factory=dict)
    """PNG files to write beside the table, by their names."""

    def __call__(
        self,
        *,
        id: str,
        action: str,
        agent: str,
        material: str,
        prior: np.ndarray,
        posterior: np.ndarray,
        u: int,
        v: int,
        width: int,
        height: int,
        strength: float = 1.0,
        extra: Mapping[str, str] | None = None,
    ) -> None:
        """Write the two frames of a pair, (H, W) uint16 counts, and remember its row.

        `extra` are columns of one's own: any text, by name.  Raises BadDataset for a name, number
        or frame that could not be read again, BadFile for a frame that cannot be written.
        """
        where = f"{self.where}: pair {quoted(id)}"
        texts = {"id": id, "action": action, "agent": agent, "material": material}
        for column, text in texts.items():
            _check_text(text, column, where)
        check_action(action, where)
        own = dict(extra or {})
        taken = [name for name in own if name in (*COLUMNS, STRENGTH)]
        if taken:
            raise BadDataset(f"{where}: {taken[0]} is a column of every data set, not one's own")
        numbers = {"u": u, "v": v, "width": width, "height": height}
        for column, number in numbers.items():
            if isinstance(number, bool) or not isinstance(number, int | np.integer):
                raise BadDataset(
                    f"{where}: {column} is {quoted(number)}; it must be a whole number"
                )
        _check_strength(strength, repr(strength), where)
        if id in self.ids:
            raise BadDataset(f"{where}: the id is there twice")
        _check_roi(self.camera, (int(u), int(v)), (int(width), int(height)), where)
        for column, counts in (("prior", prior), ("posterior", posterior)):
            if counts.dtype != np.uint16 or counts.shape != self.camera.shape:
                raise BadDataset(
                    f"{where}: {column} has shape {counts.shape} and type {counts.dtype}; "
                    f"expected {self.camera.shape} (rows, columns) of uint16"
                )
            if not counts.any():
                raise BadDataset(f"{where}: no pixel of {column} has a reading")
        # Numbered, because an id need not be a file name.
        paths = {c: f"{FRAMES}/{len(self.ids):05d}_{c}.png" for c in ("prior", "posterior")}
        for column, counts in (("prior", prior), ("posterior", posterior)):
            write_counts_png(self.folder / paths[column], counts)
        # As short as float32 allows: 0.3, not 0.300000012.
        decimal = np.format_float_positional(np.float32(strength), trim="-")
        self.rows.append(texts | paths | numbers | {STRENGTH: decimal} | own)
        self.extra |= dict.fromkeys(own)
        self.ids.add(id)

    def table(self) -> str:
        """The text of pairs.csv."""
        all_one = all(row[STRENGTH] == "1" for row in self.rows)
        header = [*COLUMNS, *([] if all_one else [STRENGTH]), *self.extra]
        rows = [{name: row.get(name, "") for name in header} for row in self.rows]
        return Table(header, rows, []).text()


@dataclass(frozen=True)
class _Row:
    where: str
    texts: dict[str, str]
    centre: tuple[int, int]
    size: tuple[int, int]
    strength: float


def _read_camera(folder: Path) -> tuple[Camera, float]:
    if not folder.is_dir():
        what = "is a file; a data set is a folder" if folder.exists() else "no such folder"
        raise BadDataset(f"{folder}: {what}")
    for name in (CAMERA, TABLE):
        if not (folder / name).is_file():
            raise BadDataset(f"{folder}: has no {name}, so it is not a data set")
    with as_dataset():
        return read_camera(folder / CAMERA)


def _read_rows(table: Table, path: Path, camera: Camera) -> list["_Row"]:
    if not table.rows:
        raise BadDataset(f"{path}: has no rows, so there are no pairs")
    rows, seen = [], {}
    for line, cells in zip(table.lines, table.rows, strict=True):
        row = _parse_row(cells, f"{path}: line {line}", camera)
        name = row.texts["id"]
        if name in seen:
            raise BadDataset(f"{row.where}: id {quoted(name)} is already on line {seen[name]}")
        seen[name] = line
        rows.append(row)
    return rows


def _parse_row(cells: dict[str, str], where: str, camera: Camera) -> _Row:
    texts = {column: cells[column].strip() for column in COLUMNS}
    for column in (*_NAMES, "prior", "posterior"):
        if not texts[column]:
            raise BadDataset(f"{where}: {column} is empty")
        _check_text(texts[column], column, where)
    check_action(texts["action"], where)
    numbers = []
    for column in _NUMBERS:
        if not _WHOLE.fullmatch(texts[column]):
            raise BadDataset(
                f"{where}: {column} is {quoted(texts[column])}; it must be a whole number of pixels"
            )
        numbers.append(int(texts[column]))
    u, v, width, height = numbers
    _check_roi(camera, (u, v), (width, height), where)
    return _Row(where, texts, (u, v), (width, height), _parse_strength(cells, where))


def _parse_strength(cells: dict[str, str], where: str) -> float:
    """1 where there is no such column."""
    text = cells.get(STRENGTH, "1").strip()
    strength = float(text.replace(",", ".")) if _DECIMAL.fullmatch(text) else np.nan
    _check_strength(strength, quoted(text), where)
    return strength


def _check_text(text: Any, column: str, where: str) -> None:
    line = isinstance(text, str) and text.strip() and not _UNPRINTABLE.search(text)
    if not line or len(text) > NAME_LIMIT:
        raise BadDataset(
            f"{where}: {column} is {quoted(text)}; it must be a line of text, "
            f"at most {NAME_LIMIT} characters"
        )


def _check_strength(strength: float, said: str, where: str) -> None:
    least, most = STRENGTHS
    if not least <= strength <= most:
        raise BadDataset(
            f"{where}: {STRENGTH} is {said}; it must be a number from {least:g} to {most:g}"
        )


def _check_roi(camera: Camera, centre: tuple[int, int], size: tuple[int, int], where: str) -> None:
    if size[0] <= 0 or size[1] <= 0:
        raise BadDataset(f"{where}: the ROI is {size[0]}x{size[1]}; its sides must be positive")
    if not actions.fits(camera, np.array([centre]), size)[0]:
        raise BadDataset(
            f"{where}: the {size[0]}x{size[1]} ROI at {centre} leaves the "
            f"{camera.width}x{camera.height} image"
        )


def _read_frames(
    folder: Path,
    rows: list[_Row],
    camera: Camera,
    depth_unit: float,
    left_out: Counter[str] | None,
) -> tuple[np.ndarray | Frames, np.ndarray | Frames]:
    """Frames before and after, (N, H, W); several rows may name the same file."""
    first: dict[str, tuple[_Row, str, int]] = {}
    which = np.array([
        [first.setdefault(row.texts[column], (row, column, len(first)))[2] for row in rows]
        for column in ("prior", "posterior")
    ])  # fmt: skip
    files, frame = list(first.values()), 2 * camera.width * camera.height
    # One frame first: a camera.json of absurd size is refused before memory is asked for.
    counts, where = _read_frame(folder, *files[0][:2], camera), f"{folder}: {next(iter(first))}"
    with as_dataset():
        check_unit(to_metres(counts, depth_unit, where), camera, where, depth_unit)
    if frame * which.size <= IN_MEMORY:
        try:
            read = np.empty((2, len(rows), *camera.shape), np.uint16)
        except MemoryError:
            raise BadDataset(f"{folder}: {len(rows)} pairs do not fit into memory") from None
        there: dict[int, np.ndarray] = {}
        for place in np.ndindex(which.shape):
            if (k := int(which[place])) not in there:
                read[place] = _read_frame(folder, *files[k][:2], camera, left_out)
            read[place] = there.setdefault(k, read[place])
        return read[0], read[1]

    @lru_cache(IN_MEMORY // frame)
    def read_one(k: int) -> np.ndarray:
        counts = _read_frame(folder, *files[k][:2], camera)
        counts.flags.writeable = False
        return counts

    for k in range(len(files)):  # so that a damaged one is named now
        _read_frame(folder, *files[k][:2], camera, left_out)
    return Frames(read_one, which[0], camera.shape), Frames(read_one, which[1], camera.shape)


def _read_frame(
    folder: Path,
    row: _Row,
    column: str,
    camera: Camera,
    left_out: Counter[str] | None = None,
) -> np.ndarray:
    try:
        counts = read_counts(inside(folder, row.texts[column]), left_out)
    except (BadFile, BadImage) as problem:
        raise BadDataset(f"{row.where}: {column}: {problem}") from None
    if counts.shape != camera.shape:
        raise BadDataset(
            f"{row.where}: {column}: {row.texts[column]} is {counts.shape[1]}x{counts.shape[0]} "
            f"pixels; the camera makes {camera.width}x{camera.height}"
        )
    return counts
