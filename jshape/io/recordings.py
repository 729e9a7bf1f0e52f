"""Recordings on disk: a folder with `camera.json` and numbered 16-bit depth frames.

Frames are (H, W) uint16 counts of `depth_unit` metres, 0 = no reading, in `frames/` or beside
`camera.json`; their order is that of the numbers at the end of their names: 000007, 100.033333.
"""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import check_shape, check_unit, to_metres
from jshape.errors import BadDataset, one_line, quoted
from jshape.io.cameras import CAMERA, read_camera, write_camera
from jshape.io.files import as_error, refused, write_atomic, write_json
from jshape.io.folders import atomic_folder, folder_of
from jshape.io.formats import SUFFIXES
from jshape.io.images import read_counts, write_counts_png
from jshape.io.tables import check_action, read_table

FRAMES = "frames"
TRUTH = "truth.json"
LABELS = "labels.csv"
CONTENTS = (CAMERA, FRAMES, TRUTH, LABELS)
"""What a simulated recording's folder holds, at the top."""
LEAVE_OUT = "-"
"""A label that makes no pair: an action that went wrong."""

_NUMBERED = re.compile(r"(.*?)([0-9]{1,30})(?:\.([0-9]{1,30}))?", re.DOTALL)
_STAMPED = re.compile(
    r"(|.*[^0-9])((?:19|20)[0-9]{2})([-_.]?)(0[1-9]|1[0-2])\3(0[1-9]|[12][0-9]|3[01])[-_.T ]?"
    r"([01][0-9]|2[0-3])([-_.:]?)([0-5][0-9])\7([0-5][0-9])(?:[-_.,]([0-9]{1,9}))?",
    re.DOTALL,
)
"""A date and a time: 2024-05-01_12-00-00, 20240501_120000.25."""
_COUNTED = 10**9
"""Numbers from here on are times (seconds since 1970 and finer), between which nothing lacks."""
_NANOSECONDS = 9
"""Digits of the longest one of a second's nanoseconds."""


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
    numbers: tuple[Decimal, ...]

    @property
    def counted(self) -> bool:
        """Whether the numbers count the frames; else they are times."""
        whole = all(number == number.to_integral_value() for number in self.numbers)
        return whole and self.numbers[-1] < _COUNTED

    def __len__(self) -> int:
        return len(self.files)

    def frame(self, index: int) -> np.ndarray:
        """Counts (H, W) uint16 of one frame; a frame without any reading is all 0.

        Raises BadDataset: it cannot be read, is not 16-bit single-channel or has another size.
        """
        path = self.files[index]
        with as_error(BadDataset):
            counts = read_counts(path, covered=True)
        check_shape(counts, self.camera, str(path), BadDataset)
        return counts

    def frames(self, indices: Iterable[int] | None = None) -> Iterator[np.ndarray]:
        """The frames (of these indices), one at a time.  Raises as `frame`."""
        for index in range(len(self)) if indices is None else indices:
            yield self.frame(index)


def open_recording(folder: str | os.PathLike, *, allow_gaps: bool = False) -> Recording:
    """The recording in a folder; of its frames only the first is read, to check the unit.

    Raises:
      BadDataset: no such folder, no camera.json, no frames, files of two kinds among them, a
        number twice, or (unless `allow_gaps`) numbers missing.
      BadCamera: camera.json makes no sense.
    """
    with as_error(BadDataset):
        folder = folder_of(folder, "a recording", CAMERA)
        camera, depth_unit = read_camera(folder / CAMERA)
    within = folder / FRAMES if (folder / FRAMES).is_dir() else folder
    with as_error(BadDataset), refused(within, "cannot be read"):
        images = sorted(p for p in within.iterdir() if p.suffix.lower() in SUFFIXES)
    images = [path for path in images if not path.name.startswith(".")]
    found = in_order(images)
    if not found:
        ends = f" ({_names(images[:1])} does not end in a number)" * bool(images)
        raise BadDataset(
            f"{within}: holds no frames{ends}; expected numbered 16-bit depth images like "
            "000000.png"
        )
    recording = Recording(folder, camera, depth_unit, tuple(found.values()), tuple(found))
    between = pairwise(found) if recording.counted else ()
    gaps = [(int(a) + 1, int(b) - 1) for a, b in between if b > a + 1]
    if gaps and not allow_gaps:
        text = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in gaps[:5])
        more = f" and {len(gaps) - 5} more gaps" if len(gaps) > 5 else ""
        raise BadDataset(
            f"{within}: missing frames: {text}{more}; --allow-gaps takes the others all the same"
        )
    with as_error(BadDataset):
        counts, where = recording.frame(0), str(recording.files[0])
        check_unit(to_metres(counts, depth_unit, where), camera, where, depth_unit)
    return recording


def in_order(paths: Iterable[Path]) -> dict[Decimal, Path]:
    """Files in the order of the numbers at the end of their names; those without are left out.

    A number may have a fraction, since names are often times: 100.1 comes after 100.033333; a date
    and a time are one number.

    Raises BadDataset: the names differ in more than that number, two have the same one, or the dot
    may as well stand between two numbers (1.9, 1.10).
    """
    found: dict[Decimal, Path] = {}
    kinds: dict[tuple[str, str], Path] = {}
    fractions: dict[Path, str] = {}
    for path, (start, whole, fraction) in _read(sorted(paths)).items():
        kinds.setdefault((start, path.suffix.lower()), path)
        if len(kinds) > 1:
            raise BadDataset(
                f"{path.parent}: holds frames of two kinds, {_names(kinds.values())}; only the "
                "number at the end may differ; keep one of them, or rename all in the order of "
                "time, as 000000.png"
            )
        number = Decimal(f"{whole}.{fraction}" if fraction else whole)
        if number in found:
            raise BadDataset(f"{path.parent}: {_names([found[number], path])} have the same number")
        found[number] = path
        if fraction:
            fractions[path] = fraction
    _check_fractions(fractions)
    return {number: found[number] for number in sorted(found)}


def _check_fractions(fractions: dict[Path, str]) -> None:
    """Refuse digits behind a dot that are no decimal's: a count (1.9, 1.10), or nanoseconds.

    A decimal whose length varies has lost its trailing zeros; nanoseconds without their leading
    ones are up to nine digits.
    """
    by_length = sorted(fractions, key=lambda path: len(fractions[path]))
    lengths = [len(fractions[path]) for path in by_length]
    if not lengths or lengths[0] == lengths[-1]:
        return
    zeros = any(len(one) > 1 and one.endswith("0") for one in fractions.values())
    if zeros or lengths[-1] == _NANOSECONDS:
        raise BadDataset(
            f"{by_length[0].parent}: which comes first, {_names((by_length[0], by_length[-1]))}? "
            "The dot may be a decimal point or stand between two numbers; rename them, as "
            "000000.png"
        )


def _read(paths: Sequence[Path]) -> dict[Path, tuple[str, str, str | None]]:
    """What names start with, and the number at their end, of which a date and time makes one."""
    numbered = {path: match for path in paths if (match := _NUMBERED.fullmatch(path.stem))}
    stamps = {path: match for path in numbered if (match := _STAMPED.fullmatch(path.stem))}
    # 20240501_000007 may as well be the eighth frame of a day.
    times = all(m[7] for m in stamps.values()) or len({m[1] for m in numbered.values()}) > 1
    if len(stamps) == len(numbered) and times:
        return {
            path: (m[1], m[2] + m[4] + m[5] + m[6] + m[8] + m[9], m[10])
            for path, m in stamps.items()
        }
    return {path: (m[1], m[2], m[3]) for path, m in numbered.items()}


def by_number(name: str) -> list[str | Decimal]:
    """What to sort names by, so that 2 comes before 10."""
    parts = re.split(r"([0-9]{1,30}(?:\.[0-9]{1,30})?)", name)
    return [Decimal(part) if k % 2 else part for k, part in enumerate(parts)]


def _names(paths: Iterable[Path]) -> str:
    return " and ".join(one_line(path.name, 60) for path in paths)


@contextmanager
def recording_writer(
    folder: str | os.PathLike, camera: Camera, depth_unit: float, *, overwrite: bool = False
) -> Iterator["FrameAdder"]:
    """The function that adds a frame to a recording, which appears whole or not at all.

    Set its `truth` and `labels` before the block ends.

    Raises BadFile: the folder exists or cannot be written; BadDataset: no frame was added.
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

    One row per change of the bed, in order; the action `-` makes no pair.  `agent` and `material`
    stand where the file has no such column, or an empty cell.  The labels are in order, by the
    column `name` if they are `named`, else by their numbers "1", "2" ...

    Raises BadDataset: it cannot be read, has no rows or unknown columns, a name is missing or
    twice.
    """
    needed = ["name", "action"] if named else ["action"]
    table = read_table(path, needed)
    other = [name for name in table.header if name not in (*needed, *Label._fields)]
    if other:
        raise BadDataset(
            f"{path}: the header is {quoted(','.join(table.header))}; expected "
            f"{','.join(needed)}, and if need be agent and material"
        )
    labels: dict[str, Label] = {}
    for line, cells in zip(table.lines, table.rows, strict=True):
        where = f"{path}: line {line}"
        row = {"agent": agent, "material": material}
        row |= {name: text.strip() for name, text in cells.items() if text.strip()}
        left_out = row.get("action") == LEAVE_OUT  # of which nothing else is asked
        asked = needed if left_out else (*needed, *Label._fields)
        lacking = [name for name in asked if not row.get(name)]
        if lacking:
            hint = "" if lacking[0] in needed else f"; give a column or --{lacking[0]}"
            raise BadDataset(f"{where}: has no {lacking[0]}{hint}")
        name = str(row["name"]) if named else str(len(labels) + 1)
        if name in labels:
            raise BadDataset(f"{where}: {quoted(name)} is there twice")
        if not left_out:
            check_action(str(row["action"]), f"{where} ('{LEAVE_OUT}' leaves it out)")
        labels[name] = Label(*(str(row[field] or "") for field in Label._fields))
    if not labels:
        raise BadDataset(f"{path}: has no rows, so there are no labels")
    return labels
