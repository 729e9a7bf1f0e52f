"""Beam search: the best few sequences are continued side by side; equal sets are merged.

Two sequences of the same actions in another order are one: only the better goes on.  From every
sequence the best candidate of each move is tried, so that a child differs from its siblings in
what is done, not by one node of where.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from jshape._typing import Array
from jshape.planning.evaluate import Candidates, refresh
from jshape.planning.search import greedy
from jshape.planning.search.base import Found, Limits, Status, Task, better, ended
from jshape.planning.search.greedy import State
from jshape.planning.search.local import polished
from jshape.planning.state import Terrain

WIDTH = 4
"""Sequences that go on."""


def search(task: Task) -> Found:
    """The best of all sequences that a beam of `WIDTH` meets; never worse than greedy's."""
    best = greedy.search(task)
    beam = [greedy.begin(task.terrain, task.candidates, task.max_steps)]
    for _ in range(task.max_steps):
        children: dict[tuple, State] = {}
        for state in beam:
            if task.budget.over:
                return ended(task, best, Status.BUDGET)
            for child in _children(task, state):
                best = better(best, replace(child.found, status=best.status))
                key = _as_set(child.found)
                known = children.get(key)
                if known is None or float(child.found.distance) < float(known.found.distance):
                    children[key] = child
        beam = sorted(children.values(), key=lambda child: float(child.found.distance))[:WIDTH]
        if not beam:
            break
        if float(best.distance) <= float(task.limits.tolerance):
            return ended(task, best, Status.CONVERGED)
    return ended(task, best, Status.BUDGET if task.budget.over else None)


def _children(task: Task, state: State) -> list[State]:
    """Up to `WIDTH` continuations of a sequence, each worth its action, best first."""
    while True:
        state, waiting, spent = task.budget.call(
            look, state, task.terrain, task.candidates, jnp.int32(task.budget.room()), how=task.how
        )
        task.budget.spend(int(spent))
        if not bool(waiting):
            break
        if task.budget.over:
            return []
    chosen, firsts, strengths, gains, more = task.budget.call(
        options, state, task.terrain, task.candidates, task.limits,
        jnp.int32(task.budget.left), fine=task.fine,
    )  # fmt: skip
    task.budget.spend(int(more))
    return [
        task.budget.call(
            greedy.take, state, task.terrain, task.candidates, chosen[k], firsts[k], strengths[k]
        )
        for k in range(len(gains))
        if float(gains[k]) > 0
    ]


@jax.jit(static_argnames=["how"])
def look(state: State, terrain: Terrain, candidates: Candidates, room: Array, how) -> tuple:
    """The state with its board refreshed as far as there is room; whether more waits; spent."""
    board, spent = refresh(terrain, state.now, candidates, state.board, room, how)
    waiting = jnp.stack([stale.any() for stale in board.stale]).any()
    return replace(state, board=board), waiting, spent


@jax.jit(static_argnames=["fine"])
def options(
    state: State,
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    left: Array,
    *,
    fine: int,
):
    """The best candidates of the `WIDTH` best moves; none after convergence."""
    gains, firsts, strengths = greedy.best_of_moves(state, terrain, candidates, limits)
    gains = jnp.where(state.found.distance > limits.tolerance, gains, 0.0)
    return polished(
        terrain, state.now, candidates, gains, firsts, strengths, limits, fine, WIDTH, left
    )


def _as_set(found: Found) -> tuple:
    """What a sequence does, whatever the order."""
    steps = int(found.steps)
    rows = zip(
        found.move[:steps].tolist(), map(tuple, found.node[:steps].tolist()),
        found.strength[:steps].tolist(), strict=True,
    )  # fmt: skip
    return tuple(sorted(rows))
