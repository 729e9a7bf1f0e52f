"""Checkpoints of a training in progress: one NPZ per action, with the facts as JSON inside.

A new one takes the place of the one before when it is whole: whenever the process is killed, one
whole checkpoint is there.  The NPZ's own checksums tell damage.
"""

import os
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from jshape.errors import BadFile, one_line
from jshape.io.arrays import npz_bytes, read_arrays
from jshape.io.files import json_text, parse_json, read_bytes, refused, write_atomic
from jshape.io.folders import check_writable

LIMIT = 64 * 2**30
"""Largest checkpoint that is read, bytes."""
_FACTS = "facts.json"


class Checkpoints:
    """The checkpoint of one action's training: a `learn.training.Keep`."""

    def __init__(self, folder: str | os.PathLike, action: str):
        """`folder` is that of the whole training; nothing is made before the first `save`."""
        self.path = Path(folder) / f"action-{quote(action, safe='')}.npz"
        self.where = str(self.path)

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """The checkpoint, as arrays by name and facts; None if there is none.

        Raises:
          BadFile: it is damaged.
        """
        if not os.path.lexists(self.path):
            return None
        try:
            arrays = read_arrays(read_bytes(self.path, limit=LIMIT), self.where, LIMIT)
            if _FACTS not in arrays:
                raise BadFile(f"{self.where}: has no {_FACTS}, so it is no checkpoint")
            return arrays, parse_json(arrays.pop(_FACTS).tobytes(), self.where)
        except BadFile as problem:
            raise BadFile(f"{problem}; remove {self.where} to start this action again") from None

    def save(self, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Replace the checkpoint, whole or not at all.  Raises BadFile: it cannot be written."""
        text = json_text(facts, self.where).encode()
        content = arrays | {_FACTS: np.frombuffer(text, np.uint8)}
        write_atomic(self.path, npz_bytes(content, packed=False))


def check_folder(folder: str | os.PathLike) -> bool:
    """Whether a training is kept in a folder; call it before long work.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    folder = check_writable(folder)
    with refused(folder, "cannot be read"):
        names = os.listdir(folder) if folder.is_dir() else []
    # A dot: a process was killed while it wrote.
    foreign = [name for name in names if not name.startswith(("action-", ".action-"))]
    if foreign:
        raise BadFile(f"{folder}: is for checkpoints, but holds {one_line(foreign[0], 80)}")
    return bool(names)


def discard(folder: str | os.PathLike) -> None:
    """Remove a training's folder, if there is one.

    Raises:
      BadFile: it holds something else than checkpoints.
    """
    check_folder(folder)
    if Path(folder).is_dir():
        with refused(folder, "cannot be removed"):
            shutil.rmtree(folder)
