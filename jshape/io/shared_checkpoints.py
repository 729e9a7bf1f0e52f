"""Checkpoints of a training that several processes share: process 0 writes, all go on from them.

They are one `.npz`, whose zip holds a CRC of each array: Orbax (see `checkpoints`) makes every call
a meeting of all processes, and so cannot be called by one of them.
"""

import io
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jax
import numpy as np

from jshape.io.arrays import read_arrays
from jshape.io.files import json_text, parse_json, read_bytes, write_atomic

FACTS = "facts"
LIMIT = 4 * 2**30
"""Largest checkpoint that is read, bytes: the paper's U-Net takes 0.13 GB."""


class SharedCheckpoints:
    """A `learn.training.Keep` for each process; the folder must be the same for all."""

    def __init__(self, folder: str | os.PathLike, action: str):
        """Where the training of an action is kept; nothing is made before the first `save`."""
        self.path = Path(folder) / f"action-{quote(action, safe='')}" / "shared.npz"
        self.where = str(self.path)

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """The checkpoint, as arrays by name and facts; None if there is none.

        Raises:
          BadFile: it is damaged.
        """
        if not self.path.exists():
            return None
        arrays = read_arrays(read_bytes(self.path, limit=LIMIT), self.where, LIMIT)
        facts = arrays.pop(FACTS, np.zeros(0, np.uint8))
        return arrays, parse_json(facts.tobytes(), self.where)

    def save(self, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Replace it, whole or not at all; only process 0 does.

        Raises:
          BadFile: it cannot be written.
        """
        if jax.process_index() == 0:
            text = np.frombuffer(json_text(facts, self.where).encode(), np.uint8)
            stream = io.BytesIO()
            np.savez(stream, allow_pickle=False, **arrays, **{FACTS: text})
            write_atomic(self.path, stream.getvalue())
