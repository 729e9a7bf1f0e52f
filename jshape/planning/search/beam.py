"""Beam search: the best few sequences are continued side by side; equal sets are merged.

Two sequences of the same actions in another order are one: only the better goes on.  From every
sequence the best candidate of each move is tried, so that a child differs from its siblings in
what is done, not by one node of where.
"""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp

from jshape._typing import Array
from jshape.planning.evaluate import Candidates, refresh
from jshape.planning.search import greedy
from jshape.planning.search.base import Found, Limits, Status, Task, better, compiled, ended
from jshape.planning.search.greedy import State
from jshape.planning.search.local import Local, improved_locally
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
    best, more = task.budget.call(
        best_candidates, state, task.terrain, task.candidates, task.limits,
        jnp.int32(task.fine), jnp.int32(task.budget.left), width=WIDTH,
    )  # fmt: skip
    task.budget.spend(int(more))
    return [
        task.budget.call(
            greedy.take, state, task.terrain, task.candidates,
            best.move[k], best.first[k], best.strength[k],
        )
        for k in range(len(best.gain))
        if float(best.gain[k]) > 0
    ]  # fmt: skip


@partial(compiled, static=("how",))
def look(state: State, terrain: Terrain, candidates: Candidates, room: Array, *, how) -> tuple:
    """The state with its board refreshed as far as there is room; whether more waits; spent."""
    board, spent = refresh(terrain, state.now, candidates, state.board, room, how)
    return replace(state, board=board), board.stale.any(), spent


@partial(compiled, static=("width",))
def best_candidates(
    state: State,
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    fine: Array,
    left: Array,
    *,
    width: int,
) -> tuple[Local, Array]:
    """The best candidates of the `width` best moves, improved; no gain after convergence."""
    best, spent = improved_locally(
        terrain, state.now, candidates, state.board, state.used, limits, fine, width, left
    )
    far = state.found.distance > limits.tolerance
    return replace(best, gain=jnp.where(far, best.gain, 0.0)), spent


def _as_set(found: Found) -> tuple:
    """What a sequence does, whatever the order."""
    steps = int(found.steps)
    rows = zip(
        found.move[:steps].tolist(), map(tuple, found.node[:steps].tolist()),
        found.strength[:steps].tolist(), strict=True,
    )  # fmt: skip
    return tuple(sorted(rows))
