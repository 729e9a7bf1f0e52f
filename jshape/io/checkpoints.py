"""Checkpoints of a training in progress: one NPZ per action, replaced whole.

Whenever the process is killed, one whole checkpoint is there.  A ZIP holds a checksum of each of
its parts, so that damage is noticed.
"""

import io
import os
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from jshape.errors import BadFile, one_line
from jshape.io.arrays import read_arrays
from jshape.io.files import json_text, parse_json, read_bytes, refused, write_atomic
from jshape.io.folders import check_writable

FILE_LIMIT = 16 * 2**30
"""Largest checkpoint that is read, bytes: parameters, their best, and two moments of Adam."""
_FACTS = "facts"


class Checkpoints:
    """The checkpoint of one action's training: a `learn.training.Keep`."""

    def __init__(self, folder: str | os.PathLike, action: str):
        """Where the training of an action is kept; nothing is made before the first `save`.

        Args:
          folder: of the whole training.
          action: its name.
        """
        self.path = Path(folder) / f"action-{quote(action, safe='')}.npz"
        self.where = str(self.path)

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """The checkpoint, as arrays by name and facts; None if there is none.

        Raises:
          BadFile: it is damaged; the message says what to remove.
        """
        if not os.path.lexists(self.path):
            return None
        try:
            content = read_bytes(self.path, limit=FILE_LIMIT)
            arrays = read_arrays(content, self.where, FILE_LIMIT)
            if _FACTS not in arrays:
                raise BadFile(f"{self.where}: has no {_FACTS}; damaged?")
            return arrays, parse_json(arrays.pop(_FACTS).tobytes(), self.where)
        except BadFile as problem:
            raise BadFile(f"{problem}; remove it to start this action again") from None

    def save(self, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Replace the checkpoint, whole or not at all.

        Raises:
          BadFile: it cannot be written.
        """
        text = np.frombuffer(json_text(facts, self.where).encode(), np.uint8)
        np.savez(stream := io.BytesIO(), allow_pickle=False, **arrays, **{_FACTS: text})
        write_atomic(self.path, stream.getvalue())


def check_folder(folder: str | os.PathLike) -> bool:
    """Whether a training is kept in a folder; call it before long work.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    folder = check_writable(folder)
    with refused(folder, "cannot be read"):
        names = os.listdir(folder) if folder.is_dir() else []
    # A write that was cut short leaves a hidden file.
    foreign = [name for name in names if not name.startswith(("action-", ".action-"))]
    if foreign:
        raise BadFile(f"{folder}: is for checkpoints, but holds {one_line(foreign[0], 80)}")
    return bool(names)


def discard(folder: str | os.PathLike) -> None:
    """Remove a training's folder, if there is one.

    Raises:
      BadFile: it holds something else than checkpoints, or cannot be removed.
    """
    check_folder(folder)
    if Path(folder).is_dir():
        with refused(folder, "cannot be removed"):
            shutil.rmtree(folder)
