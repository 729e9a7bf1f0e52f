"""Runs on disk: a folder with `run.json`, depth frames, and `steps.jsonl`, one line a step.

A step is on disk, frame first and line last, before `append` returns; after a crash the run opens
with all steps that were complete and goes on from there.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape._typing import Float
from jshape.data.depth import check_depth_unit, to_metres
from jshape.errors import BadFile
from jshape.io.files import inside, json_text, read_json, refused, write_atomic, write_json
from jshape.io.folders import atomic_folder
from jshape.io.images import read_counts, write_depth_png
from jshape.io.journal import append, read_lines
from jshape.io.records import check_format, read_value

FORMAT = "jshape-run"
VERSION = 1
DESCRIPTION = "run.json"
STEPS = "steps.jsonl"
FRAMES = "frames"
CONTENTS = (DESCRIPTION, STEPS, FRAMES)
"""What a run's folder holds, at the top."""
DEPTH_UNIT = 0.0001
"""Default metres per count of a run's frames: 0.1 mm, up to 6.5 m."""

_RESERVED = ("index", "frame")


@dataclass(eq=False, repr=False)
class Run:
    """A recording that grows by one step at a time.  Made by `create` or `open`, not directly."""

    folder: Path
    meta: dict[str, Any]
    """What was said of the run when it was made."""
    depth_unit: float
    """Metres per count of its frames."""
    _steps: list[dict[str, Any]]
    _size: int
    """Bytes of the complete lines of steps.jsonl."""
    _end: int
    """Bytes of all of it."""

    @classmethod
    def create(
        cls,
        folder: str | os.PathLike,
        meta: Mapping[str, Any] | None = None,
        *,
        depth_unit: float = DEPTH_UNIT,
        overwrite: bool = False,
        contents: Sequence[str] = (),
        more: Mapping[str, bytes] | None = None,
    ) -> "Run":
        """Start a run in a new folder.

        Args:
          folder: where; it must not hold anything unless `overwrite`.
          meta: what to say of the run; anything that JSON can hold.
          depth_unit: metres per count of its frames.
          overwrite: replace the run that is there.
          contents: names of what the caller puts beside the run, and that goes with an old one;
            a folder that holds anything else is not replaced.
          more: files that are there from the start, by name.

        Raises:
          BadFile: the folder exists or cannot be written, or JSON cannot hold `meta`.
          BadCamera: depth_unit is not a positive number.
        """
        folder = Path(folder)
        unit = check_depth_unit(depth_unit, str(folder))
        content = {"format": FORMAT, "version": VERSION, "depth_unit": unit}
        with atomic_folder(folder, overwrite, contents=(*CONTENTS, *contents)) as temp:
            write_json(temp / DESCRIPTION, content | {"meta": dict(meta or {})})
            write_atomic(temp / STEPS, "")
            for name, data in (more or {}).items():
                write_atomic(temp / name, data)
        return cls.open(folder)

    @classmethod
    def open(cls, folder: str | os.PathLike) -> "Run":
        """Open a run to read it or to go on with it.  A last line cut off by a crash is left out.

        Raises BadFile: not a run, from a newer version, or damaged before its last line.
        """
        folder = Path(folder)
        where, steps_file = str(folder / DESCRIPTION), folder / STEPS
        content = read_json(where)
        check_format(content, FORMAT, VERSION, where)
        unit = check_depth_unit(content.get("depth_unit"), where)
        meta = read_value(dict, content.get("meta"), f"{where}: meta")
        steps, size = read_lines(steps_file)
        for number, step in enumerate(steps):
            if step.get("index") != number:
                raise BadFile(f"{steps_file}: line {number + 1}: index is not {number}")
        return cls(folder, meta, unit, steps, size, steps_file.stat().st_size)

    @property
    def steps(self) -> tuple[dict[str, Any], ...]:
        """The steps so far: what was appended, with `index` and, where there is one, `frame`."""
        return tuple(dict(step) for step in self._steps)

    def __len__(self) -> int:
        """How many steps there are."""
        return len(self._steps)

    def append(self, step: Mapping[str, Any], depth: np.ndarray | None = None) -> int:
        """Add a step, and the depth image that belongs to it; both are on disk afterwards.

        A step is anything that JSON can hold, except the names `index` and `frame`; the depth is
        in metres, 0 and NaN: no reading.  Returns the step's number, from 0.

        Raises:
          BadFile: it cannot be written, or another program has written to the run meanwhile.
          BadImage: a depth that 16 bits cannot hold in the run's unit.
        """
        path = self.folder / STEPS
        taken = [name for name in _RESERVED if name in step]
        if taken:
            raise BadFile(f"{path}: a step must not set {', '.join(taken)}")
        index = len(self._steps)
        record: dict[str, Any] = {"index": index, **step}
        if depth is not None:
            record["frame"] = f"{FRAMES}/{index:03d}.png"
        line = json_text(record, str(path), indent=None)
        if depth is not None:
            write_depth_png(self.folder / record["frame"], depth, self.depth_unit)
        with refused(path, "cannot be written"):
            if path.stat().st_size != self._end:
                raise BadFile(f"{path}: has changed; another program is writing to the run")
            self._end = self._size  # a torn line behind the complete ones goes
            self._size = self._end = self._size + append(path, line, self._size)
        # As it will be read again: a tuple is a list by then, an array too.
        self._steps.append(json.loads(line))
        return index

    def depth(self, index: int) -> Float[np.ndarray, "H W"]:
        """The depth image of a step, metres, NaN = no reading.

        Raises:
          BadFile: there is no such step, or it has no frame, or the file cannot be read.
          BadImage: the frame is not a 16-bit depth image.
        """
        if not 0 <= index < len(self):
            raise BadFile(f"{self.folder}: no step {index}; it has {len(self)}")
        name = self._steps[index].get("frame")
        if name is None:
            raise BadFile(f"{self.folder}: step {index} has no frame")
        path = inside(self.folder, name)
        return to_metres(read_counts(path), self.depth_unit, str(path))
