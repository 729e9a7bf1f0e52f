"""Checkpoints of a training in progress: one folder per action.  Orbax is used here and only here.

Orbax hands damaged array data on without a word (one flipped bit in a chunk came back as another
number), and answers other damage with pages.  So the checksum of every file is written beside what
Orbax wrote, and Orbax is only given files that match.  A checkpoint gets a new folder and the one
before is removed after it: whenever the process is killed, one whole checkpoint is there.
"""

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np

from jshape.errors import BadFile, needs, one_line
from jshape.io.files import check_sums, read_json, refused, sha256, write_json
from jshape.io.folders import atomic_folder, check_writable
from jshape.io.records import read_record

FORMAT = "jshape-checkpoint"
FACTS = "checkpoint.json"
ARRAYS = "arrays"
_FOLDER = re.compile(r"saved-(\d{8})")


@dataclass(frozen=True)
class _Facts:
    format: Literal["jshape-checkpoint"]
    facts: dict
    checksums: dict[str, str]


class Checkpoints:
    """The checkpoint of one action's training, as `learn.training.Hooks` keeps it."""

    def __init__(self, folder: str | os.PathLike, action: str):
        """Where the training of an action is kept; nothing is made before the first `save`.

        Args:
          folder: of the whole training.
          action: its name.
        """
        self.folder = Path(folder) / f"action-{quote(action, safe='')}"
        self.where = str(self.folder)

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """The newest checkpoint, as arrays by name and facts; None if there is none.

        Raises BadFile: it is damaged; the message says which folder to remove.
        """
        numbers = self._numbers()
        if not numbers:
            return None
        try:
            return _load(self.folder / _name(numbers[-1]))
        except BadFile as problem:
            cure = f"remove {self.where} to start this action again"
            if any(_whole(self.folder / _name(number)) for number in numbers[:-1]):
                cure = f"remove {self.folder / _name(numbers[-1])} to go on from the one before"
            raise BadFile(f"{problem}; {cure}") from None

    def save(self, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Write a new checkpoint, whole or not at all, then remove the one before.

        Raises BadFile: it cannot be written.
        """
        before = self._numbers()
        place = self.folder / _name(before[-1] + 1 if before else 1)
        with atomic_folder(place) as temp:
            _write(temp / ARRAYS, arrays)
            names = sorted(
                path.relative_to(temp).as_posix() for path in temp.rglob("*") if path.is_file()
            )
            checksums = {name: sha256(temp / name) for name in names}
            write_json(temp / FACTS, {"format": FORMAT, "facts": facts, "checksums": checksums})
        for number in before:
            shutil.rmtree(self.folder / _name(number), ignore_errors=True)

    def _numbers(self) -> list[int]:
        """Numbers of the checkpoints that are there, oldest first."""
        return sorted(int(m[1]) for m in map(_FOLDER.fullmatch, _names(self.folder)) if m)


def check_folder(folder: str | os.PathLike) -> bool:
    """Whether a training is kept in a folder; call it before long work.

    Raises BadFile: the folder holds something else, or cannot be written.
    """
    names = _names(check_writable(folder))
    foreign = [name for name in names if not name.startswith("action-")]
    if foreign:
        raise BadFile(f"{folder}: is for checkpoints, but holds {one_line(foreign[0], 80)}")
    return bool(names)


def discard(folder: str | os.PathLike) -> None:
    """Remove a training's folder, if there is one.

    Raises BadFile: it holds something else than checkpoints.
    """
    if check_folder(folder):
        for path in Path(folder).glob("action-*"):
            shutil.rmtree(path, ignore_errors=True)
    if Path(folder).is_dir():
        with refused(folder, "cannot be removed"):
            os.rmdir(folder)


def _names(folder: Path) -> list[str]:
    with refused(folder, "cannot be read"):
        return os.listdir(folder) if folder.is_dir() else []


def _name(number: int) -> str:
    return f"saved-{number:08d}"


def _load(place: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and facts of one checkpoint, whose files are all there and as they were written."""
    found = read_record(_Facts, read_json(place / FACTS), str(place / FACTS))
    there = {path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file()}
    wrong = sorted((there - {FACTS}) ^ set(found.checksums))
    if wrong or not found.checksums:
        named = one_line(wrong[0] if wrong else ARRAYS, 80)
        raise BadFile(f"{place}: {named} is missing or has no checksum; damaged?")
    check_sums(place, found.checksums)
    return _read(place / ARRAYS), found.facts


def _whole(place: Path) -> bool:
    try:
        _load(place)
    except BadFile:
        return False
    return True


def _orbax() -> Any:
    with needs("networks", "a checkpoint"):
        from orbax.checkpoint import v1  # 0.6 s
    return v1


def _write(place: Path, arrays: dict[str, np.ndarray]) -> None:
    ocp = _orbax()
    try:
        # An absolute path: Orbax fails on others.
        ocp.save(str(place.resolve()), {name: np.asarray(array) for name, array in arrays.items()})
    except Exception as problem:  # Orbax promises no type
        raise BadFile(f"{place}: cannot be written: {one_line(problem)}") from None


def _read(place: Path) -> dict[str, np.ndarray]:
    ocp = _orbax()
    try:
        found = ocp.load(str(place.resolve()))
        return {str(name): np.asarray(array) for name, array in found.items()}
    except Exception as problem:
        raise BadFile(f"{place}: not a readable checkpoint: {one_line(problem)}") from None
