"""What experiments look at: pairs of a data set or of the simulator, and small cameras."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.pairs import Pairs
from jshape.data.simulate import simulate_pairs, together
from jshape.errors import BadDataset
from jshape.store import datasets

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
    progress: Progress = silent,
) -> Pairs:
    """The pairs of a data set, or simulated ones in flour if there is none.

    Args:
      data: folder of a data set; then only `actions` and `agents` matter.
      seed: of simulated pairs.
      count: simulated pairs per action and agent.
      actions: names; None is all that a data set has, or the paper's robot's three.
      agents: names; None is all that a data set has, or both.
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
    total = count * len(actions) * len(agents)
    key = jax.random.key(seed)
    made = simulate_pairs(key, count, actions=actions, agents=agents, beds=BEDS, frames=FRAMES)
    return together(progress(made, total, "simulating"))


def source(data: Path | None) -> str:
    """Where the pairs come from, for a page."""
    return "simulated pairs of flour" if data is None else f"the data set {Path(data).name}"
