"""A grid of banks: agents x actions x kinds x partitions, each cell fitted and tested on its own.

A finished cell is a bank's folder, whose manifest also says what the cell is, what it was made
from, and the errors on the pairs that were kept out.  So it stands for itself: it is found again
whatever the grid is that asks for it, and in whatever order.
"""

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, unquote

import numpy as np

from benchmarks.experiments.studies import scores_of
from jshape.data.pairs import PER_PAIR, Frames, Pairs
from jshape.errors import BadDataset, BadFile, JShapeError, UnknownName, one_line
from jshape.grid.engines import Engine, here
from jshape.io import banks, files
from jshape.io.cameras import camera_fields
from jshape.learn import scores as drawn
from jshape.learn.fit import FITTERS, fit
from jshape.learn.measure import Score, Trial, roi_errors_mm
from jshape.learn.partitions import Split, split_pairs, unrefined
from jshape.learn.settings import settings_from
from jshape.models.bank import Bank
from jshape.viz import style

CELLS = "cells"
SUMMARY = "summary.json"
TABLE = "scores.csv"
FIGURE = "scores.png"
CONTENTS = (CELLS, SUMMARY, TABLE, FIGURE)
"""What a grid's folder holds."""
UNTRAINED = ("D", "P")
"""Kinds that use no option of training but the seed."""


class Cell(NamedTuple):
    """One bank of the grid."""

    agent: str
    action: str
    kind: str
    partition: int
    """From 0."""

    @property
    def name(self) -> str:
        """Of its folder: "robot-poke-CR-0"."""
        parts = (quote(part, safe="").replace("-", "%2D") for part in map(str, self))
        return "-".join(parts)


class Done(NamedTuple):
    """A cell that was computed: its bank and test, or why there is none."""

    cell: Cell
    bank: Bank | None
    trial: Trial | None
    problem: str = ""


@dataclass(frozen=True)
class Grid:
    """What is fitted to what.

    Agents and actions are apart: a cell depends on its own pairs and its partition's number only,
    and stays what it is when the grid grows.  Its numbers are those that `evaluate.cross_validate`
    gives for the pairs of one action and agent.

    Raises:
      UnknownName: no such kind, agent or action.
      BadDataset: no pairs, or an action of an agent with too few to split.
      JShapeError: no partition; a share that is not between 0 and 1; an option of training that is
        unknown or out of its range.
    """

    pairs: Pairs
    kinds: Sequence[str] = ("D",)
    agents: Sequence[str] = ()
    """Empty: all."""
    actions: Sequence[str] = ()
    """Empty: all."""
    partitions: int = 4
    test_share: float = 0.25
    seed: int = 0
    """Of the partitions."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of training, see `learn.settings.Training`."""

    def __post_init__(self):
        settings_from(dict(self.options))
        for what, names, known in (
            ("kind of bank", self.kinds, FITTERS),
            ("agent", self.agents, dict.fromkeys(self.pairs.agent.tolist())),
            ("action", self.actions, self.pairs.actions),
        ):
            for name in names:
                if name not in known:
                    raise UnknownName(what, name, known)
        if not self._groups:
            raise BadDataset("no pairs of these agents and actions")
        for agent, action in self._groups:
            split_pairs(self.pairs.of(action, agent), self.partitions, self.test_share, self.seed)

    @cached_property
    def _groups(self) -> list[tuple[str, str]]:
        """(agent, action), in the order of the pairs."""
        there = zip(self.pairs.agent.tolist(), self.pairs.action.tolist(), strict=True)
        return [
            (agent, action)
            for agent, action in dict.fromkeys(there)
            if agent in (self.agents or (agent,)) and action in (self.actions or (action,))
        ]

    @cached_property
    def cells(self) -> list[Cell]:
        """All of them; those of a partition stand together, so that stopped early it is whole."""
        return [
            Cell(agent, action, kind, partition)
            for partition in range(self.partitions)
            for agent, action in self._groups
            for kind in dict.fromkeys(self.kinds)
        ]

    def split(self, cell: Cell) -> tuple[Pairs, Split]:
        """The pairs of a cell's agent and action, and which of them are fitted to and tested."""
        mine = self.pairs.of(cell.action, cell.agent)
        # Partitions are drawn one after the other, so more of them leave the first as they are.
        found = split_pairs(mine, cell.partition + 1, self.test_share, self.seed)
        return mine, found[-1][cell.agent]

    def facts(self, cell: Cell) -> dict[str, Any]:
        """All that a cell's result depends on, as JSON: what a finished one must agree with."""
        settings = asdict(settings_from(dict(self.options)))
        used = ("seed",) if cell.kind in UNTRAINED else sorted(settings.keys() - {"save_every"})
        return {
            **cell._asdict(),
            "test_share": self.test_share,
            "split_seed": self.seed,
            "training": {name: settings[name] for name in used},
            "pairs": self._digest_of(cell.agent, cell.action),
        }

    def _digest_of(self, agent: str, action: str) -> str:
        if (agent, action) not in self._digests:
            self._digests[agent, action] = _digest(self.pairs.of(action, agent))
        return self._digests[agent, action]

    @cached_property
    def _digests(self) -> dict[tuple[str, str], str]:
        """Of the pairs of each agent and action: 0.3 s for a hundred, and all cells ask."""
        return {}


def run(
    grid: Grid, out: Path, engine: Engine = here, *, overwrite: bool = False
) -> Generator[Done, None, None]:
    """Compute the cells that are not in the folder yet; gives each when it is written.

    Args:
      grid: what to compute.
      out: folder of the grid.
      engine: what computes.
      overwrite: compute cells again that were made from other pairs or settings, or are damaged.

    Raises:
      BadFile: the folder holds something else, or such a cell.
    """
    kept = finished(grid, out, overwrite)
    tasks = in_tasks([cell for cell in grid.cells if cell not in kept])
    for _, found in engine(fitted, grid, tasks):
        for done in found:
            if done.bank is not None and done.trial is not None:
                _save(grid, out, done.cell, done.bank, done.trial)
            yield done


def in_tasks(cells: Sequence[Cell]) -> list[tuple[Cell, ...]]:
    """Cells in tasks: f_C is what is inside f_CR, so asked for together they are one training."""
    found: dict[Cell, list[Cell]] = {}
    for cell in cells:
        found.setdefault(cell._replace(kind=cell.kind.removesuffix("R")), []).append(cell)
    return [tuple(task) for task in found.values()]


def fitted(grid: Grid, task: tuple[Cell, ...]) -> list[Done]:
    """A task: fit one bank, and test it as each of the task's kinds."""
    try:
        mine, split = grid.split(task[0])
        training, tested = mine.select(np.sort(split.train)), mine.select(split.test)
        whole = fit(training, max((cell.kind for cell in task), key=len), **grid.options)
        found = []
        for cell in task:
            bank = whole if cell.kind == whole.kind else unrefined(whole, cell.kind)
            size = mine.roi_size(cell.action)
            errors, changes = roi_errors_mm(bank, tested, cell.action, size=size)
            who = cell.kind, cell.agent, cell.agent, cell.action, len(training)
            found.append(Done(cell, bank, Trial(*who, tested.id, errors, changes)))
        return found
    except Exception as problem:  # whatever it is, the other cells do not depend on it
        own = isinstance(problem, JShapeError)
        why = str(problem) if own else f"{type(problem).__name__}: {one_line(problem)}"
        return [Done(cell, None, None, why) for cell in task]


def finished(grid: Grid, out: Path, overwrite: bool = False) -> dict[Cell, Trial]:
    """The tests of the grid's cells that are in the folder.

    Raises:
      BadFile: the folder holds something else, or cannot be written; or a cell of other pairs or
        settings, or a damaged one, unless those are to be overwritten.
    """
    files.check_writable(out)
    foreign = sorted({path.name for path in out.iterdir()} - {*CONTENTS}) if out.is_dir() else []
    if foreign:
        raise BadFile(f"{out}: is for a grid, but holds {one_line(foreign[0], 80)}")
    found = {}
    for cell in grid.cells:
        folder = out / CELLS / cell.name
        if folder.exists():
            try:
                found[cell] = _load(folder, grid.facts(cell))
            except JShapeError as problem:
                if not overwrite:
                    raise BadFile(
                        f"{problem}; choose another folder, or compute it again (--overwrite)"
                    ) from None
    return found


def others(grid: Grid, out: Path) -> dict[Cell, Trial]:
    """The tests of cells in the folder that have the grid's pairs and settings but are not its own.

    What else is there (cells of other pairs or settings, damaged ones) is passed over.
    """
    asked, found = {cell.name for cell in grid.cells}, {}
    for folder in sorted((out / CELLS).glob("*")):
        if folder.name in asked:
            continue
        with suppress(JShapeError, ValueError):
            agent, action, kind, partition = map(unquote, folder.name.split("-"))
            cell = Cell(agent, action, kind, int(partition))
            found[cell] = _load(folder, grid.facts(cell))
    return found


def conclude(grid: Grid, out: Path, problems: Mapping[Cell, str]) -> tuple[list[Score], dict]:
    """Means over the partitions that are finished, as table and figure in the folder.

    They show all finished cells there of the same pairs and settings, so that asking for fewer
    cells takes nothing away.

    Args:
      grid: which cells.
      out: folder of the grid.
      problems: what went wrong, by cell.

    Returns:
      The scores, and what `summary.json` holds.
    """
    trials, besides = finished(grid, out, overwrite=True), others(grid, out)
    scores = scores_of([*trials.values(), *besides.values()], grid.pairs)
    summary = {
        "out": str(out), "cells": len(grid.cells), "finished": len(trials),
        "others": len(besides), "scores": [score._asdict() for score in scores],
        "failed": [{**cell._asdict(), "why": why} for cell, why in problems.items()],
    }  # fmt: skip
    if scores:
        files.write_atomic(out / TABLE, drawn.scores_csv(scores))
    files.write_json(out / SUMMARY, summary)
    if scores:
        for name, picture in style.drawn({FIGURE: partial(drawn.scores_figure, scores)}).items():
            files.write_atomic(out / name, picture)
    return scores, summary


def _save(grid: Grid, out: Path, cell: Cell, bank: Bank, trial: Trial) -> None:
    info = {
        "data": f"{trial.pairs} pairs of {cell.action} by {cell.agent}, partition {cell.partition}",
        "errors": [{"action": cell.action, "mm": float(trial.error_mm.mean())}],
        "cell": grid.facts(cell),
        "trial": {name: np.asarray(part).tolist() for name, part in trial._asdict().items()},
    }
    banks.save_bank(bank, out / CELLS / cell.name, info=info, overwrite=True)


def _load(folder: Path, facts: Mapping[str, Any]) -> Trial:
    """The test of a finished cell, if it was made from what it would be made from now."""
    manifest = banks.bank_manifest(folder)
    before, trial = manifest.get("cell"), manifest.get("trial")
    if not isinstance(before, dict) or not isinstance(trial, dict):
        raise BadFile(f"{folder}: is a bank, but not a cell of a grid")
    if before != facts:
        raise BadFile(f"{folder}: was made with {_difference(before, facts)}")
    try:
        types = {"id": str, "error_mm": np.float64, "change_mm": np.float64}
        arrays = {name: np.array(trial[name], kind) for name, kind in types.items()}
        return Trial(**{**trial, **arrays})
    except (KeyError, TypeError, ValueError):
        raise BadFile(f"{folder}: the errors in its manifest are incomplete") from None


def _difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first fact that differs, for people."""
    flat = [{**facts, **facts.get("training", {})} for facts in (before, now)]
    for name, value in flat[1].items():
        if name == "pairs" and flat[0].get(name) != value:
            return "other pairs"
        if name != "training" and flat[0].get(name) != value:
            was = one_line(flat[0].get(name), 60)
            return f"another {name}: {was}, now {one_line(value, 60)}"
    return "other settings"


def _digest(pairs: Pairs) -> str:
    """SHA-256 of everything about pairs."""
    digest = hashlib.sha256(repr((camera_fields(pairs.camera), pairs.depth_unit)).encode())
    for name in PER_PAIR:
        if isinstance(getattr(pairs, name), Frames):  # as below, of one array
            digest.update(f"{name}{getattr(pairs, name).shape}{Frames.dtype}".encode())
            for frame in getattr(pairs, name):
                digest.update(np.ascontiguousarray(frame).data)
            continue
        array = np.ascontiguousarray(getattr(pairs, name))
        # Names by themselves: their array is as wide as the longest of the whole data set.
        text = array.dtype.kind == "U"
        digest.update(f"{name}{array.shape}{'' if text else array.dtype}".encode())
        digest.update("\0".join(array.tolist()).encode() if text else array.data)
    return digest.hexdigest()
