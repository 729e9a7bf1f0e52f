"""Recordings on disk: a folder with `camera.json` and numbered 16-bit depth frames.

Frames are (H, W) uint16 counts of `depth_unit` metres, 0 = no reading, in `frames/` or beside
`camera.json`; a frame's number is the digits at the end of its name.
"""

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import wrong_shape
from jshape.errors import BadDataset, BadFile, BadImage, one_line, quoted
from jshape.store.cameras import read_camera, write_camera
from jshape.store.files import read_bytes, write_atomic, write_json
from jshape.store.folders import atomic_folder
from jshape.store.images import read_counts, write_counts_png

CAMERA = "camera.json"
FRAMES = "frames"
TRUTH = "truth.json"
LABELS = "labels.csv"
CONTENTS = (CAMERA, FRAMES, TRUTH, LABELS)
"""What a simulated recording's folder holds, at the top."""
LEAVE_OUT = "-"
"""A label that makes no pair: an action that went wrong."""

_NUMBERED = re.compile(r"(.*?)([0-9]{1,12})")
_SUFFIXES = (".png", ".tif", ".tiff", ".npy")
_TABLE_LIMIT = 2**24


class Label(NamedTuple):
    """What was done at one change of the bed."""

    action: str
    agent: str
    material: str


@dataclass(frozen=True)
class Recording:
    """Frames of one camera that are read one at a time."""

    folder: Path
    camera: Camera
    depth_unit: float
    """Metres per count."""
    files: tuple[Path, ...]
    """In the order of their numbers."""

    def __len__(self) -> int:
        return len(self.files)

    def frame(self, index: int) -> np.ndarray:
        """Counts (H, W) uint16 of one frame; a frame without any reading is all 0.

        Raises:
          BadDataset: the file cannot be read, is not 16-bit single-channel or has another size.
        """
        path = self.files[index]
        try:
            counts = read_counts(path)
        except BadImage as problem:
            if "no pixel has a reading" in str(problem):  # a covered lens is no damage
                return np.zeros(self.camera.shape, np.uint16)
            raise BadDataset(str(problem)) from None
        except BadFile as problem:
            raise BadDataset(str(problem)) from None
        if counts.shape != self.camera.shape:
            raise BadDataset(wrong_shape(str(path), counts.shape, self.camera))
        return counts

    def frames(self, indices: Iterable[int] | None = None) -> Iterator[np.ndarray]:
        """The frames (of these indices), one at a time.  Raises as `frame`."""
        for index in range(len(self)) if indices is None else indices:
            yield self.frame(index)


def open_recording(folder: str | os.PathLike, *, allow_gaps: bool = False) -> Recording:
    """The recording in a folder; its frames are listed but not read.

    Args:
      folder: with `camera.json` and numbered frames.
      allow_gaps: take frames whose numbers are not consecutive.

    Raises:
      BadDataset: no such folder, no camera.json, no frames, files of two kinds among them, a
        number twice, or numbers missing.
      BadCamera: camera.json makes no sense.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file; a recording is a folder" if folder.exists() else "no such folder"
        raise BadDataset(f"{folder}: {what}")
    if not (folder / CAMERA).is_file():
        raise BadDataset(f"{folder}: has no {CAMERA}, so nothing says what its frames mean")
    try:
        camera, depth_unit = read_camera(folder / CAMERA)
    except BadFile as problem:
        raise BadDataset(str(problem)) from None
    within = folder / FRAMES if (folder / FRAMES).is_dir() else folder
    found: dict[int, Path] = {}
    kinds: dict[tuple[str, str], Path] = {}
    try:
        names = sorted(os.listdir(within))
    except OSError as problem:
        raise BadDataset(f"{within}: cannot be read: {one_line(problem)}") from None
    for name in names:
        path = within / name
        match = _NUMBERED.fullmatch(path.stem)
        if name.startswith(".") or path.suffix.lower() not in _SUFFIXES or not match:
            continue
        kinds.setdefault((match[1], path.suffix.lower()), path)
        number = int(match[2])
        if len(kinds) > 1:
            first, second = (p.name for p in list(kinds.values())[:2])
            raise BadDataset(
                f"{within}: holds frames of two kinds, {first} and {second}; keep one of them"
            )
        if number in found:
            raise BadDataset(f"{within}: {found[number].name} and {name} have the same number")
        found[number] = path
    if not found:
        raise BadDataset(
            f"{within}: holds no frames; expected numbered 16-bit depth images like 000000.png"
        )
    numbers = sorted(found)
    gaps = [(a + 1, b - 1) for a, b in zip(numbers, numbers[1:], strict=False) if b > a + 1]
    if gaps and not allow_gaps:
        text = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in gaps[:5])
        more = f" and {len(gaps) - 5} more gaps" if len(gaps) > 5 else ""
        raise BadDataset(
            f"{within}: missing frames: {text}{more}; --allow-gaps takes the others all the same"
        )
    return Recording(folder, camera, depth_unit, tuple(found[n] for n in numbers))


@contextmanager
def recording_writer(
    folder: str | os.PathLike, camera: Camera, depth_unit: float, *, overwrite: bool = False
) -> Iterator["FrameAdder"]:
    """A recording written frame by frame; the folder appears whole or not at all.

    Yields:
      The function that adds a frame; set its `truth` and `labels` before the block ends.

    Raises:
      BadFile: the folder exists or cannot be written.
      BadDataset: no frame was added.
    """
    with atomic_folder(folder, overwrite, contents=CONTENTS) as temp:
        write_camera(temp / CAMERA, camera, depth_unit)
        adder = FrameAdder(temp)
        yield adder
        if not adder.count:
            raise BadDataset(f"{folder}: no frames were added")
        if adder.truth is not None:
            write_json(temp / TRUTH, adder.truth)
        if adder.labels:
            lines = "".join(f"{name}\n" for name in ("action", *adder.labels))
            write_atomic(temp / LABELS, lines)


@dataclass
class FrameAdder:
    """Adds frames to a recording that is being written."""

    folder: Path
    count: int = 0
    truth: dict[str, Any] | None = None
    """What `truth.json` is to hold."""
    labels: Sequence[str] = ()
    """Actions for `labels.csv`, in order."""

    def __call__(self, counts: np.ndarray) -> None:
        """Write the next frame, (H, W) uint16 counts."""
        write_counts_png(self.folder / FRAMES / f"{self.count:06d}.png", counts)
        self.count += 1


def read_labels(
    path: str | os.PathLike, agent: str | None, material: str | None, *, named: bool = False
) -> dict[str, Label]:
    """The labels of a recording: a CSV with the columns action, and if need be agent and material.

    One row per change of the bed, in order; the action `-` makes no pair.

    Args:
      path: the file.
      agent: where it has no such column.
      material: likewise.
      named: there is a column `name` that says what a row is about; else rows are numbered.

    Returns:
      The labels in order, by their names ("1", "2" ... without names).

    Raises:
      BadDataset: it cannot be read, has no rows or unknown columns, a name is missing or twice.
    """
    path = Path(path)
    try:
        text = read_bytes(path, limit=_TABLE_LIMIT).decode("utf-8-sig")
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text))]
    except BadFile as problem:
        raise BadDataset(str(problem)) from None
    except UnicodeDecodeError:
        raise BadDataset(f"{path}: is not UTF-8 text") from None
    except csv.Error as problem:
        raise BadDataset(f"{path}: not CSV that can be read: {one_line(problem)}") from None
    header, *rows = rows or [[]]
    needed = ["name", "action"] if named else ["action"]
    allowed = {*needed, *Label._fields}
    if not set(needed) <= set(header) <= allowed or len(set(header)) < len(header):
        raise BadDataset(
            f"{path}: the header is {quoted(','.join(header))}; expected "
            f"{','.join(needed)}, and if need be agent and material"
        )
    labels: dict[str, Label] = {}
    for line, cells in enumerate(rows, 2):
        if not any(cells):
            continue
        where = f"{path}: line {line}"
        if len(cells) != len(header):
            raise BadDataset(f"{where}: has {len(cells)} columns; the header has {len(header)}")
        row = {"agent": agent, "material": material} | dict(zip(header, cells, strict=True))
        lacking = [name for name in (*needed, *Label._fields) if not row.get(name)]
        if lacking:
            hint = "" if lacking[0] in needed else f"; give a column or --{lacking[0]}"
            raise BadDataset(f"{where}: has no {lacking[0]}{hint}")
        name = str(row["name"]) if named else str(len(labels) + 1)
        if name in labels:
            raise BadDataset(f"{where}: {quoted(name)} is there twice")
        labels[name] = Label(*(str(row[field]) for field in Label._fields))
    if not labels:
        raise BadDataset(f"{path}: has no rows, so there are no labels")
    return labels
