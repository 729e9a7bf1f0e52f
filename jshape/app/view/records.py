"""The actions of a run as its files tell them: `steps.jsonl`, and the journal if there is one."""

import math
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadFile, is_name, quoted
from jshape.io import journal
from jshape.robot.session import AT_THE_BED

SAME = 1e-4
"""Distances that differ relatively by less are of the same look."""

LARGEST = 1e6
"""Of numbers that are drawn: pixels, mm, Nm."""


@dataclass
class ActionRecord:
    """One action, done or begun."""

    name: str
    position: tuple[float, float]
    """(u, v) pixels."""
    strength: float = 1.0
    yaw: float = 0.0
    before_mm: float | None = None
    predicted_mm: float | None = None
    obtained_mm: float | None = None
    operations: list[Any] = field(default_factory=list)
    """How each ended, as far as it is known."""
    seconds: float | None = None
    """From the beginning of the run to the look after it; None: nobody looked, or noted when."""

    @property
    def effort_nm(self) -> float | None:
        """The greatest effort of its operations."""
        rows = [row for row in self.operations if isinstance(row, dict)]
        efforts = [row["effort_nm"] for row in rows if _is_number(row.get("effort_nm"))]
        return max(map(float, efforts), default=None)

    @property
    def touched(self) -> bool:
        """The bed may have changed."""
        return any(row.get("operation") in AT_THE_BED for row in self.operations)

    def is_planned_as(self, other: "ActionRecord") -> bool:
        """Both are one action, one of them perhaps with its place rounded to a pixel."""
        return (
            self.name == other.name
            and near(self.position, other.position)
            and same(self.predicted_mm, other.predicted_mm)
        )


def near(one: tuple[float, float] | np.ndarray, other: tuple[float, float]) -> bool:
    """Two places are one, rounded to a pixel or not."""
    return bool(np.abs(np.subtract(one, other)).max() <= 0.51)


def same(one: float | None, other: float | None) -> bool:
    """Two distances are of one look, or neither is known."""
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=SAME, abs_tol=1e-6)


def record_of(record: dict[str, Any], where: str) -> ActionRecord:
    """The action of a line of `steps.jsonl`, or of what a journal says was planned."""
    name, position = record.get("action"), record.get("position")
    if not is_name(name):
        raise BadFile(f"{where}: action is {quoted(name)}; expected a line of text")
    assert isinstance(name, str)
    if not isinstance(position, list) or len(position) != 2:
        raise BadFile(f"{where}: position is {quoted(position)}; expected two numbers")
    u, v = (_number(x, where, "position") for x in position)
    keys = ("strength", "yaw", "before_mm", "predicted_mm", "obtained_mm")
    known = {key: _number(record[key], where, key) for key in keys if record.get(key) is not None}
    operations = record.get("operations")
    operations = operations if isinstance(operations, list) else []
    return ActionRecord(name, (u, v), operations=operations, **known)


def begun(path: Path) -> list[ActionRecord]:
    """The actions that a journal says were begun; none if there is no journal."""
    found: list[ActionRecord] = []
    planned: dict[str, Any] = {}
    start: float | None = None
    for number, event in enumerate(journal.events(path) if path.is_file() else []):
        what, now = event.get("event"), _time(event.get("time"))
        start = now if start is None else start
        if what == "planned":
            planned = event
        elif what == "acting" and planned:
            found.append(record_of(planned, f"{path}: line {number + 1}"))
            planned = {}
        elif what == "operation" and found:
            found[-1].operations.append(event)
        elif what == "looked" and found and found[-1].seconds is None and not _ended(found[-1]):
            found[-1].seconds = None if now is None or start is None else now - start
        elif what in ("aborted", "stopped", "started", "resumed") and found:
            found[-1].operations.append({"event": what})
    return found


def _ended(done: ActionRecord) -> bool:
    """The run ended, or was begun again, before anybody looked."""
    return any("event" in row and "operation" not in row for row in done.operations)


def _time(text: Any) -> float | None:
    try:
        return datetime.fromisoformat(text).timestamp()
    except (TypeError, ValueError):
        return None


def _number(value: Any, where: str, name: str) -> float:
    if not _is_number(value):
        raise BadFile(f"{where}: {name} is {quoted(value)}; expected a number up to {LARGEST:g}")
    return float(value)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST
