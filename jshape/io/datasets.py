"""Data sets on disk: a folder with `camera.json`, `pairs.csv` and 16-bit depth frames.

Frames are (H, W) uint16 counts of `depth_unit` metres, 0 = no reading.  ROI centres are `(u, v)`
and sizes `(w, h)`, pixels.  Where a program found the ROIs, the column `found` holds the box
`u v width height` that it wrote, and pictures lie beside the table.
"""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import check_shape, check_unit, to_metres
from jshape.data.pairs import Frames, Pairs
from jshape.errors import BadDataset, BadFile, BadImage, quoted
from jshape.io.cameras import CAMERA, read_camera, write_camera
from jshape.io.files import as_error, inside, write_atomic
from jshape.io.folders import atomic_folder, folder_of
from jshape.io.images import read_counts, write_counts_png
from jshape.io.pair_rows import BOX, COLUMNS, NAMES, OPTIONAL, PairRow, parse_row, read_row
from jshape.io.tables import Table, read_table

TABLE = "pairs.csv"
FRAMES = "frames"
FOUND = "found"
"""Name of the column."""
TIMELINE = "segments.png"
"""How a recording was cut."""
SHEETS = ("contact_sheet.png", *(f"contact_sheet_{page:03d}.png" for page in range(2, 1000)))
"""Pages of the pairs with their boxes."""
CONTENTS = (TABLE, CAMERA, FRAMES, TIMELINE, *SHEETS)
"""What a data set's folder holds, at the top."""
IN_MEMORY = 2 * 2**30
"""Most bytes of frames that are kept in memory; of more, each is read when it is needed."""

_STATES = ("prior", "posterior")


def load_pairs(folder: str | os.PathLike, left_out: Counter[str] | None = None) -> Pairs:
    """All pairs of a data set, in the order of `pairs.csv`.

    Columns may come in any order; those of other names are the pairs' `extra`.  Without the column
    `strength` it is 1 for all; without `path_mm`, or where its cell is empty, no action has a
    path.  Frames of more than 2 GiB are checked now and read again when they are needed.

    Args:
      folder: the data set's.
      left_out: adds up why pixels of the frames are no readings.

    Raises:
      BadDataset: no such folder, a file or a column is missing, no rows, a bad number, a frame
        that is missing, of another size or not 16-bit single-channel, a ROI that leaves the image,
        an id twice, or a path that leads out of the folder.
      BadCamera: camera.json makes no sense.
    """
    with as_error(BadDataset):
        folder = folder_of(folder, "a data set", CAMERA, TABLE)
        camera, depth_unit = read_camera(folder / CAMERA)
    table = read_table(folder / TABLE, COLUMNS)
    rows = _read_rows(table, folder / TABLE, camera)
    prior, posterior = _read_frames(folder, rows, camera, depth_unit, left_out)

    found = rows.values()
    whole = {name: np.array([getattr(row, name) for row in found]) for name in NAMES}
    return Pairs(
        camera=camera,
        depth_unit=depth_unit,
        prior=prior,
        posterior=posterior,
        centre=np.array([row.roi[0] for row in found], np.int32),
        size=np.array([row.roi[1] for row in found], np.int32),
        strength=np.array([row.strength for row in found], np.float32),
        path_mm=np.array([row.path_mm for row in found], np.float32),
        extra={
            name: np.array([cells[name] for cells in table.rows], object)
            for name in table.header
            if name not in (*COLUMNS, *OPTIONAL)
        },
        **whole,
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
    names = {name: str(getattr(pairs, name)[k]) for name in NAMES}
    frames = {"prior": pairs.prior[k], "posterior": pairs.posterior[k]}
    numbers = {"u": u, "v": v, "width": w, "height": h}
    numbers |= {name: float(getattr(pairs, name)[k]) for name in OPTIONAL}
    extra = {name: str(cells[k]) for name, cells in pairs.extra.items()}
    return {**names, **frames, **numbers, "extra": extra}


@contextmanager
def dataset_writer(
    folder: str | os.PathLike,
    camera: Camera,
    depth_unit: float,
    *,
    overwrite: bool = False,
) -> Iterator[Any]:
    """A data set written pair by pair: only one pair is in memory, and the folder appears whole.

        with dataset_writer(folder, camera, 1e-4) as add:
            add(id="poke_0", action="poke", agent="robot", material="flour",
                prior=counts, posterior=counts, u=240, v=197, width=40, height=45)

    Args:
      folder: where; it must not hold anything unless `overwrite`.
      camera: that sees all frames.
      depth_unit: metres per count.
      overwrite: replace the data set that is there.

    Yields:
      The adder, a function that adds a pair.

    Raises:
      BadDataset: no pair was added, or one that could not be read again.
      BadFile: the folder exists or cannot be written.
      BadCamera: the camera or the unit makes no sense.
    """
    with atomic_folder(folder, overwrite, contents=CONTENTS) as temp:
        write_camera(temp / CAMERA, camera, depth_unit)
        add = Adder(str(folder), temp, camera)
        yield add
        if not add.ids:
            raise BadDataset(f"{folder}: no pairs were added")
        for name, content in {TABLE: add.table(), **add.pictures}.items():
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
        prior: np.ndarray,
        posterior: np.ndarray,
        by_hand: bool | None = None,
        extra: Mapping[str, str] | None = None,
        **said: Any,
    ) -> None:
        """Write the two frames of a pair, (H, W) uint16 counts, and remember its row.

        `said` are the other fields of a `PairRow`; `by_hand` says whether a person drew the box or
        a program found it (None: neither); `extra` are columns of one's own: any text, by name.
        Raises BadDataset for a name, number or frame that could not be read again, BadFile for a
        frame that cannot be written.
        """
        where, own = f"{self.where}: pair {quoted(id)}", dict(extra or {})
        # Numbered, because an id need not be a file name.
        paths = {state: f"{FRAMES}/{len(self.ids):05d}_{state}.png" for state in _STATES}
        numbers = {n: x.item() if isinstance(x, np.number) else x for n, x in said.items()}
        row = vars(read_row({"id": id, **numbers, **paths}, self.camera, where))
        taken = [name for name in own if name in row]
        if taken:
            raise BadDataset(f"{where}: {taken[0]} is a column of every data set, not one's own")
        if by_hand is not None:
            own[FOUND] = "" if by_hand else " ".join(str(row[name]) for name in BOX)
        if id in self.ids:
            raise BadDataset(f"{where}: the id is there twice")
        for state, counts in zip(_STATES, (prior, posterior), strict=True):
            if counts.dtype != np.uint16 or counts.shape != self.camera.shape:
                raise BadDataset(
                    f"{where}: {state} has shape {counts.shape} and type {counts.dtype}; "
                    f"expected {self.camera.shape} (rows, columns) of uint16"
                )
            if not counts.any():
                raise BadDataset(f"{where}: no pixel of {state} has a reading")
        for state, counts in zip(_STATES, (prior, posterior), strict=True):
            write_counts_png(self.folder / paths[state], counts)
        # As short as float32 allows: 0.3, not 0.300000012.
        decimals = {
            name: np.format_float_positional(np.float32(row[name]), trim="-") for name in OPTIONAL
        }
        self.rows.append(row | decimals | own)
        self.extra |= dict.fromkeys(own)
        self.ids.add(id)

    def table(self) -> str:
        """The text of pairs.csv."""
        usual = zip(OPTIONAL, ("1", "0"), strict=True)
        told = [name for name, same in usual if any(row[name] != same for row in self.rows)]
        header = [*COLUMNS, *told, *self.extra]
        rows = [{name: row.get(name, "") for name in header} for row in self.rows]
        return Table(header, rows, []).text()


def _read_rows(table: Table, path: Path, camera: Camera) -> dict[str, PairRow]:
    """The rows, by where they are."""
    if not table.rows:
        raise BadDataset(f"{path}: has no rows, so there are no pairs")
    rows, seen = {}, {}
    for line, cells in zip(table.lines, table.rows, strict=True):
        where = f"{path}: line {line}"
        row = parse_row(cells, camera, where)
        if row.id in seen:
            raise BadDataset(f"{where}: id {quoted(row.id)} is already on line {seen[row.id]}")
        seen[row.id] = line
        rows[where] = row
    return rows


def _read_frames(
    folder: Path,
    rows: dict[str, PairRow],
    camera: Camera,
    depth_unit: float,
    left_out: Counter[str] | None,
) -> tuple[np.ndarray | Frames, np.ndarray | Frames]:
    """Frames before and after, (N, H, W); several rows may name the same file."""
    first: dict[str, tuple[int, str]] = {}
    which = np.array(
        [
            [
                first.setdefault(getattr(row, state), (len(first), f"{where}: {state}"))[0]
                for where, row in rows.items()
            ]
            for state in _STATES
        ]
    )
    files, size = [(name, where) for name, (_, where) in first.items()], 2 * np.prod(camera.shape)

    def read(k: int, left_out: Counter[str] | None = None) -> np.ndarray:
        name, where = files[k]
        try:
            counts = read_counts(inside(folder, name), left_out)
        except (BadFile, BadImage) as problem:
            raise BadDataset(f"{where}: {problem}") from None
        check_shape(counts, camera, f"{where}: {name}", BadDataset)
        return counts

    # One frame first: a camera.json of absurd size is refused before memory is asked for.
    where = f"{folder}: {files[0][0]}"
    with as_error(BadDataset):
        check_unit(to_metres(read(0), depth_unit, where), camera, where, depth_unit)
    if size * which.size <= IN_MEMORY:
        try:
            found = np.empty((2, len(rows), *camera.shape), np.uint16)
        except MemoryError:
            raise BadDataset(f"{folder}: {len(rows)} pairs do not fit into memory") from None
        for k in range(len(files)):
            found[which == k] = read(k, left_out)
        return found[0], found[1]

    @lru_cache(int(IN_MEMORY // size))
    def kept(k: int) -> np.ndarray:
        counts = read(k)
        counts.flags.writeable = False
        return counts

    for k in range(len(files)):  # so that a damaged one is named now
        read(k, left_out)
    return Frames(kept, which[0], camera.shape), Frames(kept, which[1], camera.shape)
