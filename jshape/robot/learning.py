"""A run that learns: its bank is corrected between looks, and so by whoever goes on with it.

Nothing but the run itself is kept: `replayed` reads its frames again, and learns the same.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jshape.actions import PlacedAction
from jshape.camera import Camera
from jshape.data.view import image_of_depth
from jshape.errors import BadDataset, BadFile, UnknownName, one_line
from jshape.io import banks, runs
from jshape.io.cameras import camera_from
from jshape.learn.lessons import Lesson, hand_of, lesson
from jshape.learn.online import Evidence
from jshape.models.bank import Bank
from jshape.planning.maps import bank_for
from jshape.robot.run_actions import done_of

KNOWN = {
    "pressed-flour-robot": "flour molded by a robot",
    "pressed-flour-human": "flour molded by a person",
    "pressed-sand-robot": "sand molded by a robot",
    "pressed-sand-human": "sand molded by a person",
}
"""Bundled banks of one hand in one material."""
MOST_RUNS = 8
"""Most runs that went on with one another's bank."""

Note = Callable[..., Any]
"""Called with what happened, and more by keyword: for a journal."""


class Learning:
    """The bank of a run, corrected by each of its actions."""

    def __init__(self, bank: Bank, note: Note = lambda event, **more: None):
        """`bank` is what the run begins with; BadBank: it cannot learn."""
        self.evidence = Evidence(bank)
        self.note = note

    @property
    def bank(self) -> Bank:
        """The bank to predict with now."""
        return self.evidence.bank

    def __call__(self, act: PlacedAction, before: np.ndarray, after: np.ndarray) -> Bank:
        """The bank after one more action.

        Args:
          act: what was done.
          before: (H, W) weighed image I before it, NaN where there was no reading.
          after: the same after it.
        """
        start = self.evidence.start
        try:
            seen = lesson(start, act, before, after)
        except (BadDataset, UnknownName) as problem:
            self.note("not learned from", action=act.action, why=one_line(problem))
            return self.bank
        self.evidence = self.evidence.note(seen)
        last = self.evidence.judged[-1]
        self.note(
            "learned",
            action=act.action,
            start_mm=last.start_mm,
            learned_mm=last.learned_mm,
            used_mm=last.used_mm,
            numbers=dict(zip(start.actions, self.evidence.numbers.tolist(), strict=True)),
            **self.told(),
        )
        return self.bank

    def told(self) -> dict[str, Any]:
        """What was learned, for a journal and a summary."""
        errors = self.bank.errors_mm
        known = {} if errors is None else dict(zip(self.bank.actions, errors.tolist(), strict=True))
        return {
            "looks": self.evidence.count,
            "kept_start": self.evidence.keeps_start,
            "errors_mm": {name: mm for name, mm in known.items() if np.isfinite(mm)},
        }

    def looks_like(self) -> str:
        """What hand and material the run's actions look most like, in words; "" before any."""
        lessons = [judged.lesson for judged in self.evidence.judged]
        errors = {name: _error(name, self.evidence.start, lessons) for name in KNOWN}
        errors = {name: mm for name, mm in errors.items() if mm is not None}
        if not errors:
            return ""
        near, *others = sorted(errors, key=lambda name: errors[name])
        beside = "".join(f"; {KNOWN[name]} {errors[name]:.2f}" for name in others[:1])
        return f"looks like {KNOWN[near]}: {near} is {errors[near]:.2f} mm off{beside}"


def _error(name: str, start: Bank, lessons: list[Lesson]) -> float | None:
    """Mean error of a bundled bank on a run's lessons, mm; None: it does not know its actions."""
    bank, found = banks.load_bank(name), []
    for one in lessons:
        action = start.actions[one.action]
        if action in bank.actions:
            hand = hand_of(bank, action)
            if hand.grid.shape == one.before.shape:
                found.append(one.error_mm(hand))
    return float(np.mean(found)) if found else None


def learned_from(run: runs.Run, bank: Bank, note: Note = lambda event, **more: None) -> Learning:
    """What a run's actions so far teach a bank of the run's camera; `note` is told of later ones.

    Raises:
      BadBank: the bank cannot learn.
      BadFile, BadImage: the run is damaged, or of another camera.
    """
    learning = Learning(bank)
    for done in done_of(run):
        learning(done.act, *(_image(one, bank.camera, run) for one in (done.before, done.after)))
    learning.note = note
    return learning


def _image(depth: np.ndarray, camera: Camera, run: runs.Run) -> np.ndarray:
    seen = image_of_depth(depth, camera, max_missing=1.0, where=str(run.folder))
    return np.where(seen.known, seen.image, np.float32(np.nan))


def bank_of(name_or_folder: str | Path) -> Bank:
    """A bank by name or folder; of the folder of a run, its bank with what the run taught it.

    Raises:
      BadBank, BadFile: no such bank or run, or a damaged one.
    """
    return _bank_of(name_or_folder, MOST_RUNS)


def _bank_of(name_or_folder: str | Path, most: int) -> Bank:
    folder = Path(name_or_folder)
    if not (folder / runs.DESCRIPTION).is_file():
        return banks.load_bank(name_or_folder)
    run = runs.Run.open(folder)
    name = run.meta.get("bank")
    if not isinstance(name, str) or most == 0:
        raise BadFile(f"{folder}: the run names no bank, or a chain of over {MOST_RUNS} runs")
    start = _bank_of(name, most - 1)
    learned = learned_from(run, bank_seeing(run.meta, start, str(folder))).bank
    # The same hands, for the camera that the bank was made for.
    hands = tuple(
        replace(hand_of(learned, action), grid=hand_of(start, action).grid)
        for action in start.actions
    )
    known = {"errors_mm": learned.errors_mm, "intervals": learned.intervals}
    return replace(start, predictors=hands, **known)


def bank_seeing(known: Mapping[str, Any], bank: Bank, where: str) -> Bank:
    """The bank for the camera of a run's frames, which may be one above the bed.

    Raises:
      BadFile: what the run says of that camera makes no sense.
    """
    fields = known.get("view")
    if fields is None:
        return bank
    if not isinstance(fields, dict):
        raise BadFile(f"{where}: the run's view is no object with the fields of a camera")
    return bank_for(bank, camera_from(fields, f"{where}: the run's view"))
