"""A found sequence improved: one action at a time is taken out and greedy goes on from there.

Deleting is the case where it puts nothing in, inserting that where it puts in several; two actions
in a row that overlap are also tried in the other order.  Only what lowers d is kept.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jshape._typing import Array
from jshape.planning.evaluate import Board, Candidates, fresh_board, touch
from jshape.planning.search import greedy
from jshape.planning.search.base import Found, Status, Task, better, compiled, ended
from jshape.planning.search.greedy import State
from jshape.planning.search.local import no_local
from jshape.planning.search.sequence import begun, measured, without
from jshape.planning.state import Terrain

PASSES = 4
"""Times that the whole sequence is gone through, at most."""
LEAST = 1e-7
"""What d must fall by for a change to count: above the rounding of its sum."""


def search(task: Task) -> Found:
    """What greedy finds, or what was to begin with, improved; never worse than either."""
    best = greedy.search(task)
    start = begun(task)
    if start is not None:
        best = better(best, replace(start, status=best.status))
    return improved(task, best)


def improved(task: Task, found: Found) -> Found:
    """A sequence after exchanges and swaps until none helps or the budget is spent."""
    if not int(found.steps) or float(found.distance) <= float(task.limits.tolerance):
        return found
    board, seen = fresh_board(task.candidates), task.terrain.now
    for _ in range(PASSES):
        before = float(found.distance)
        for k in range(int(found.steps) - 2, -1, -1):
            found = _swapped(task, found, k)
        k = 0
        while k < int(found.steps):
            if task.budget.over:
                return ended(task, found, Status.BUDGET)
            found, board, seen, kept = _exchanged(task, found, k, board, seen)
            # What was exchanged moved to the end: the next one is at the same number.
            k += kept
        if float(found.distance) > before - LEAST:
            break
    return ended(task, found, None)


def _exchanged(
    task: Task, found: Found, k: int, board: Board, seen: Array
) -> tuple[Found, Board, Array, bool]:
    """The sequence with its k-th action exchanged, if that helps; the board of the map seen."""
    fewer, now, _ = task.budget.call(measured, task.terrain, without(found, k))
    task.budget.spend(int(found.steps))
    state = task.budget.call(at_map, task.terrain, task.candidates, fewer, now, board, seen)
    while True:  # greedy from there, in pieces that keep the budget
        spent = int(state.found.evaluations)
        state = task.budget.call(
            greedy.advance, state, task.terrain, task.candidates, task.limits,
            jnp.int32(task.budget.room()), jnp.int32(task.budget.left),
            jnp.int32(task.fine), how=task.how,
        )  # fmt: skip
        task.budget.spend(int(state.found.evaluations) - spent)
        if int(state.found.status) >= 0 or task.budget.over:
            break
    tried, _, _ = task.budget.call(measured, task.terrain, state.found)
    kept = float(tried.distance) > float(found.distance) - LEAST
    result = found if kept else replace(tried, status=found.status)
    return result, state.board, state.now, kept


@compiled
def at_map(
    terrain: Terrain, candidates: Candidates, found: Found, now: Array, board: Board, seen: Array
) -> State:
    """Greedy's state after a sequence: of the board, what lies where the map differs is stale."""
    apart = jnp.abs(now - seen) > 0
    rows, columns = apart.any(1), apart.any(0)
    first = jnp.array([jnp.argmax(rows), jnp.argmax(columns)], jnp.int32)
    ends = jnp.array([jnp.argmax(rows[::-1]), jnp.argmax(columns[::-1])], jnp.int32)
    last = jnp.array(apart.shape, jnp.int32) - ends
    shape = jnp.where(apart.any(), last - first, 0)
    board = touch(board, candidates, terrain, first, shape)
    actions = jnp.asarray(terrain.actions)
    used = jnp.zeros(1 + max(terrain.actions), jnp.int32)
    used = used.at[actions[found.move]].add(found.move >= 0)
    status, none = jnp.int32(-1), jnp.int32(0)
    found = replace(found, status=status, evaluations=none)
    return State(now, board, used, found, no_local(terrain))


def _swapped(task: Task, found: Found, k: int) -> Found:
    """The k-th and the next action in the other order, if they overlap and that helps."""
    node, move = np.asarray(found.node), np.asarray(found.move)
    shapes = task.terrain.shapes[move[k : k + 2]]
    if (np.abs(node[k] - node[k + 1]) >= (shapes[0] + shapes[1]) / 2).any() or task.budget.over:
        return found
    order = np.arange(len(move))
    order[[k, k + 1]] = k + 1, k
    other = replace(
        found, move=found.move[order], node=found.node[order], strength=found.strength[order]
    )
    other, _, _ = task.budget.call(measured, task.terrain, other)
    task.budget.spend(int(found.steps))
    return other if float(other.distance) < float(found.distance) - LEAST else found
