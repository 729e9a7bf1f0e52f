"""The actions of a run as its files tell them: `steps.jsonl`, and the journal if there is one."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.actions import Place, PlacedAction
from jshape.io import images, journal, runs
from jshape.io.records import OneLine, Range, read_record
from jshape.robot.procedure import NAMES

START = "start.png"
"""The look before anything, in a run's folder."""
AT_THE_BED = NAMES[NAMES.index("contact") :]
"""Operations after which the bed may have changed."""
SAME = 1e-4
"""Distances that differ relatively by less are of the same look."""

_Number = Annotated[float, Range(-1e6, 1e6)]  # what is drawn: pixels, mm, Nm


@dataclass
class ActionRecord:
    """One action, done or begun: a line of `steps.jsonl`, or what a journal says was planned."""

    allow_unknown: ClassVar[bool] = True

    action: Annotated[str, OneLine()]
    position: Annotated[tuple[float, float], Range(-1e6, 1e6)]
    """(u, v) pixels."""
    strength: _Number = 1.0
    yaw: _Number = 0.0
    length: _Number = 1.0
    stroke: Annotated[tuple[float, float], Range(-1e6, 1e6)] = (0.0, 0.0)
    before_mm: _Number | None = None
    predicted_mm: _Number | None = None
    obtained_mm: _Number | None = None
    unlikely: bool = False
    """It was nothing that the bank's action could leave: see `loop.Step`."""
    operations: list[dict] = field(default_factory=list)
    """How each ended, as far as it is known."""
    seconds: _Number | None = None
    """From the beginning of the run to the look after it; None: nobody looked, or noted when."""

    @property
    def placed(self) -> PlacedAction:
        """What was done, and where."""
        how = self.strength, self.yaw, self.length, self.stroke
        return PlacedAction(self.action, self.position, *how)

    @property
    def effort_nm(self) -> float | None:
        """The greatest effort of its operations."""
        said = (row.get("effort_nm") for row in self.operations)
        efforts = [float(nm) for nm in said if isinstance(nm, int | float)]
        return max(efforts, default=None)

    @property
    def touched(self) -> bool:
        """The bed may have changed."""
        return any(row.get("operation") in AT_THE_BED for row in self.operations)

    def is_planned_as(self, other: "ActionRecord") -> bool:
        """Both are one action, one of them perhaps with its place rounded to a pixel."""
        return (
            self.action == other.action
            and near(self.position, other.position)
            and same(self.predicted_mm, other.predicted_mm)
        )


def near(one: Place, other: Place) -> bool:
    """Two places are one, rounded to a pixel or not."""
    return bool(np.abs(np.subtract(one, other)).max() <= 0.51)


def same(one: float | None, other: float | None) -> bool:
    """Two distances are of one look, or neither is known."""
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=SAME, abs_tol=1e-6)


def begun(path: Path) -> list[ActionRecord]:
    """The actions that a journal says were begun; none if there is no journal."""
    found: list[ActionRecord] = []
    planned: dict[str, Any] = {}
    start: float | None = None
    under_way = False  # nothing has ended the last action's run before anybody looked
    for number, event in enumerate(journal.events(path) if path.is_file() else [], 1):
        what, now = event.get("event"), _time(event.get("time"))
        start = now if start is None else start
        if what == "planned":
            planned = event
        elif what == "acting" and planned:
            found.append(read_record(ActionRecord, planned, f"{path}: line {number}"))
            planned, under_way = {}, True
        elif what == "operation" and found:
            found[-1].operations.append(event)
        elif what == "looked" and under_way:
            found[-1].seconds = None if now is None or start is None else now - start
            under_way = False
        elif what in ("aborted", "stopped", "started", "resumed"):
            under_way = False
    return found


def _time(text: Any) -> float | None:
    try:
        return datetime.fromisoformat(text).timestamp()
    except (TypeError, ValueError):
        return None


class Done(NamedTuple):
    """An action of a run that was looked at just before and just after."""

    number: int
    """Of the run's step, from 0."""
    act: PlacedAction
    before: Float[np.ndarray, "H W"]
    """Depth, metres, NaN = no reading."""
    after: Float[np.ndarray, "H W"]


def done_of(run: runs.Run) -> Iterator[Done]:
    """The actions of a run that frames on disk tell the beginning and the end of, in order.

    Without those that left what none of them can, as when the bed was moved.

    A run that was gone on with looked again first, and that look is not kept: the first action
    after it is left out, which its distance before tells.

    Raises:
      BadFile, BadImage: the run is damaged.
    """
    where, start = run.folder / runs.STEPS, run.folder / START
    journal_file = run.folder / journal.NAME
    events = journal.events(journal_file) if journal_file.is_file() else []
    anew = any(e.get("event") == "resumed" and e.get("seen", e.get("steps")) == 0 for e in events)
    before, before_mm = None, None
    if start.is_file() and not anew:
        before = images.read_depth(start, depth_unit=run.depth_unit)
    for k, row in enumerate(run.steps):
        done = read_record(ActionRecord, row, f"{where}: line {k + 1}")
        after = run.depth(k) if "frame" in row else None
        likely = not done.unlikely and (k == 0 or same(before_mm, done.before_mm))
        if likely and before is not None and after is not None:
            yield Done(k, done.placed, before, after)
        before, before_mm = after, done.obtained_mm
