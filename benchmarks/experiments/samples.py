"""What experiments look at: pairs of a data set or of the simulator, and small cameras."""

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.pairs import Pairs
from jshape.data.simulate import SimulatedPair, simulate_pairs, together
from jshape.errors import BadDataset
from jshape.io import datasets

ACTIONS = ("grasp", "knock", "poke")
"""What the paper's robot and human do."""
AGENTS = ("robot", "human")
BEDS = ("flat", "irregular")
"""Kinds of bed that simulated pairs are made on, in turn."""
FRAMES = 5
"""Frames averaged into each simulated look."""
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]
Say = Callable[[str], Any]


def silent(items: Iterable[Any], *_: Any) -> Iterable[Any]:
    """No progress bar."""
    return items


def unheard(_: str) -> None:
    """Nobody is told."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What experiments are asked for; each takes what it knows of it, and None is its usual."""

    data: Path | None = None
    """A data set; None simulates pairs."""
    quick: bool = False
    """Few and small of everything."""
    seed: int = 0
    """Of everything random."""
    kinds: Sequence[str] | None = None
    """Of banks."""
    actions: Sequence[str] | None = None
    """Names."""
    sizes: Sequence[int] | None = None
    """Pairs per action to fit to."""
    pairs: int | None = None
    """Simulated per action and agent."""
    partitions: int | None = None
    """Of the pairs."""
    width: int | None = None
    """Of the networks' first block."""
    epochs: int | None = None
    """Of the networks."""
    overwrite: bool = False
    """Replace an earlier result."""
    say: Say = unheard
    """Told each line for people."""
    progress: Progress = silent
    """Wraps what takes long."""


def smaller(camera: Camera, times: int) -> Camera:
    """The same view in pixels `times` as wide."""
    return replace(
        camera, width=camera.width // times, height=-(-camera.height // times),
        fx=camera.fx / times, fy=camera.fy / times,
        u0=(camera.u0 - (times - 1) / 2) / times, v0=(camera.v0 - (times - 1) / 2) / times,
    )  # fmt: skip


CAMERAS = {"240x198": smaller(PAPER_BOX, 2), "480x395": PAPER_BOX, "848x480": D435_BAZAR}
"""By size, in pixels."""


def pairs_of(
    data: Path | None,
    *,
    seed: int,
    count: int,
    actions: Sequence[str] | None = None,
    agents: Sequence[str] | None = None,
    strengths: tuple[float, float] = (1.0, 1.0),
    progress: Progress = silent,
) -> Pairs:
    """The pairs of a data set, or simulated ones in flour if there is none.

    Simulated pairs are kept in memory: another experiment that asks for as many or fewer of the
    same gets the first of them, and only more are made anew.

    Args:
      data: folder of a data set; then only `actions` and `agents` matter.
      seed: of simulated pairs.
      count: simulated pairs per action and agent.
      actions: names; None is all that a data set has, or the paper's robot's three.
      agents: names; None is all that a data set has, or both.
      strengths: least and greatest strength of simulated pairs.
      progress: wraps the pairs that are simulated.

    Raises:
      BadDataset: the data set cannot be read, or has none of the actions or agents.
    """
    if data is not None:
        pairs = datasets.load_pairs(data)
        keep = np.ones(len(pairs), bool)
        for wanted, names in ((actions, pairs.action), (agents, pairs.agent)):
            if wanted is not None:
                keep &= np.isin(names, wanted)
        if not keep.any():
            asked = ", ".join([*(actions or ()), *(agents or ())])
            raise BadDataset(f"{data}: has no pairs of {asked}")
        return pairs.select(keep)
    actions, agents = actions or ACTIONS, agents or AGENTS
    made = (
        pair
        for agent in agents
        for action in actions
        for pair in _supply(seed, agent, action, strengths).first(count)
    )
    # A list, since the tests' type checks look into iterators and would use it up.
    return together(list(progress(made, count * len(actions) * len(agents), "simulating")))


def pairs_for(
    asked: Asked, count: int, *, usual: Sequence[str] | None = None, agents: Any = None, **more: Any
) -> Pairs:
    """`pairs_of` for what is asked; `usual` actions and the `agents` are of simulated pairs."""
    simulated = asked.data is None
    return pairs_of(
        asked.data,
        seed=asked.seed,
        count=asked.pairs or count,
        actions=asked.actions or (usual if simulated else None),
        agents=agents if simulated else None,
        progress=asked.progress,
        **more,
    )


class _Supply:
    """Simulated pairs of one action and agent: made when they are asked for, and kept."""

    def __init__(self, more: Iterator[SimulatedPair]):
        self._made: list[SimulatedPair] = []
        self._more = more

    def first(self, count: int) -> Iterator[SimulatedPair]:
        """The first so many, always the same."""
        for k in range(count):
            if k == len(self._made):
                self._made.append(next(self._more))
            yield self._made[k]


@lru_cache
def _supply(seed: int, agent: str, action: str, strengths: tuple[float, float]) -> _Supply:
    # Each has its own key, so that what is drawn does not depend on what else is asked for.
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(f"{agent} {action}".encode()))
    endless = 2**31
    return _Supply(
        simulate_pairs(
            key, endless, actions=(action,), agents=(agent,), beds=BEDS, frames=FRAMES,
            strengths=strengths,
        )
    )  # fmt: skip


def forget() -> None:
    """Let go of the simulated pairs that are kept in memory."""
    _supply.cache_clear()


def source(data: Path | None) -> str:
    """Where the pairs come from, for a page."""
    return "simulated pairs of flour" if data is None else f"the data set {Path(data).name}"
