"""Searches without a model, to know what a plan is worth: siblings of those in `planners/`.

They work on images, and so with a bank of f_D, of which they use no prediction: its ROIs say what
an action can reach.  What is predicted of their plans is the bank's own.
"""

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jshape.errors import BadBank
from jshape.planning.search import PLANNERS
from jshape.planning.search.base import SearchProblem, SearchResult, Status, empty_result

Taken = tuple[int, np.ndarray]
"""Move number, and first node (v, u) of its window."""


def random(problem: SearchProblem) -> SearchResult:
    """Any candidate, as often as is allowed; nominal strength.

    The image decides which; what is left of an earlier plan is kept.
    """
    if problem.start is not None:
        return replace(problem.start, status=jnp.int32(Status.MAX_STEPS))
    rng = np.random.default_rng(zlib.crc32(np.asarray(problem.state.now).tobytes()))
    counts = np.array(problem.candidates.counts)
    taken = []
    for drawn in rng.integers(counts.sum(), size=problem.max_steps):
        move = int(np.searchsorted(counts.cumsum(), drawn, side="right"))
        place = drawn - counts[:move].sum()
        taken.append((move, problem.candidates.of_move(move)[place]))
    return _found(problem, taken, Status.MAX_STEPS)


def surplus(problem: SearchProblem) -> SearchResult:
    """The action whose ROI has the largest mean surplus over the goal, where it has it.

    Ends where no ROI stands above the goal by as much as d has to be lowered.  What an action
    does is not known, so the plan takes it that its ROI is as wanted afterwards.
    """
    state = problem.state
    if state.weight is not None:
        raise BadBank("the surplus is one of images: the bank must be of kind D or a network's")
    above = np.asarray(state.now, np.float64) - np.asarray(state.goal)
    least = float(jnp.asarray(problem.limits.min_gain))
    taken: list[Taken] = []
    while len(taken) < problem.max_steps:
        best, most = None, 0.0
        total = np.pad(above.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        for number, move in enumerate(state.moves):
            first = problem.candidates.of_move(number)
            if not len(first):
                continue
            (top, left), (bottom, right) = first.T, (first + move.shape).T
            inside = total[bottom, right] - total[top, right]
            inside = inside - total[bottom, left] + total[top, left]
            mean = np.where(inside / above.size > least, inside / np.prod(move.shape), 0.0)
            if mean.max() > most:
                best, most = (number, first[mean.argmax()]), mean.max()
        if best is None:
            return _found(problem, taken, Status.NO_IMPROVEMENT)
        taken.append(best)
        (top, left), (rows, columns) = best[1], state.moves[best[0]].shape
        above[top : top + rows, left : left + columns] = 0.0
    return _found(problem, taken, Status.MAX_STEPS)


FLOORS = {"random": random, "surplus": surplus}
"""By name, as in `PLANNERS`."""


@contextmanager
def floors() -> Iterator[None]:
    """While it lasts, plans can be made with the floors by their names."""
    PLANNERS.update(FLOORS)
    try:
        yield
    finally:
        for name in FLOORS:
            del PLANNERS[name]


def _found(problem: SearchProblem, taken: Sequence[Taken], status: Status) -> SearchResult:
    """What a search gives back, of moves at nominal strength."""
    found = empty_result(problem.state, problem.max_steps)
    move, node, strength = (np.array(x) for x in (found.move, found.node, found.strength))
    for k, (number, first) in enumerate(taken):
        move[k], node[k] = number, first + problem.state.moves[number].middle
        strength[k] = 1.0
    return replace(
        found, steps=jnp.int32(len(taken)), move=jnp.asarray(move), node=jnp.asarray(node),
        strength=jnp.asarray(strength), status=jnp.int32(status),
    )  # fmt: skip
