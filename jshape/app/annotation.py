"""Boxes of a data set, looked at pair by pair and corrected; no browser here.

Methods raise a BadDataset, in one line for people, and then have changed nothing.
"""

from pathlib import Path

import numpy as np

from jshape.data.annotate import Box, Effect, find_effect
from jshape.errors import BadDataset
from jshape.io import annotations, datasets

LEAST = 5
"""Least side of a box, pixels."""


class Annotation:
    """A data set that is corrected: what is changed is kept until `save` writes `pairs.csv`."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.pairs = datasets.load_pairs(folder)
        self.by_hand = annotations.boxes_by_hand(folder)
        self.changed: dict[int, Box] = {}
        """Boxes that are not written yet, by the number of the pair."""
        self._effects: dict[int, Effect] = {}

    def __len__(self) -> int:
        return len(self.pairs)

    def box(self, k: int) -> Box:
        """(left, top, width, height) of pair k as it is now, pixels."""
        if k in self.changed:
            return self.changed[k]
        (u, v), (w, h) = self.pairs.centre[k].tolist(), self.pairs.size[k].tolist()
        return u - w // 2, v - h // 2, w, h

    def effect(self, k: int) -> Effect:
        """What changed between the two frames of pair k."""
        if k not in self._effects:
            pairs = self.pairs
            frames, hidden = (pairs.prior[k], pairs.posterior[k]), pairs.camera.orthographic
            self._effects[k] = find_effect(*frames, pairs.depth_unit, hidden=hidden)
        return self._effects[k]

    def correct(self, k: int, corner: tuple[float, float], other: tuple[float, float]) -> Box:
        """Draw the box of pair k anew, from one corner (u, v) to the opposite one."""
        size = np.array([self.pairs.camera.width, self.pairs.camera.height])
        ends = np.clip(np.rint([corner, other]).astype(int), 0, size)
        first, last = ends.min(0), ends.max(0)
        w, h = (last - first).tolist()
        if min(w, h) < LEAST:
            raise BadDataset(f"a box of {w}x{h} pixels; at least {LEAST}x{LEAST} is needed")
        left, top = first.tolist()
        self.changed[k] = left, top, w, h
        return self.changed[k]

    def take_found(self, k: int) -> Box:
        """Take the box that is found in the frames of pair k."""
        found = self.effect(k).box
        if found is None:
            noise = self.effect(k).noise_mm
            raise BadDataset(f"{self.pairs.id[k]}: nothing changed beyond {noise:.2f} mm of noise")
        self.changed[k] = found
        return found

    def put_back(self, k: int) -> None:
        """Forget what was changed of pair k since the last `save`."""
        self.changed.pop(k, None)

    def save(self) -> int:
        """Write the changed boxes to `pairs.csv`; returns how many."""
        boxes = {str(self.pairs.id[k]): box for k, box in self.changed.items()}
        annotations.write_boxes(self.folder, boxes)
        for k, (left, top, w, h) in self.changed.items():
            self.pairs.centre[k] = left + w // 2, top + h // 2
            self.pairs.size[k] = w, h
        self.by_hand = annotations.boxes_by_hand(self.folder)
        self.changed.clear()
        return len(boxes)
