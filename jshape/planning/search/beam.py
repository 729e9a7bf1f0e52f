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
from jshape.planning.search.base import (
    SearchLimits,
    SearchProblem,
    SearchResult,
    Status,
    better,
    compiled,
    ended,
)
from jshape.planning.search.local import Local, improved_locally
from jshape.planning.search.step import Carry, begin, take
from jshape.planning.state import SearchState

WIDTH = 4
"""Sequences that go on."""


def search(problem: SearchProblem) -> SearchResult:
    """The best of all sequences that a beam of `WIDTH` meets; never worse than greedy's."""
    best = greedy.search(problem)
    beam = [begin(problem.state, problem.candidates, problem.max_steps)]
    for _ in range(problem.max_steps):
        children: dict[tuple, Carry] = {}
        for carry in beam:
            if problem.budget.over:
                return ended(problem, best, Status.BUDGET)
            for child in _children(problem, carry):
                best = better(best, replace(child.result, status=best.status))
                key = _as_set(child.result)
                known = children.get(key)
                if known is None or float(child.result.distance) < float(known.result.distance):
                    children[key] = child
        beam = sorted(children.values(), key=lambda child: float(child.result.distance))[:WIDTH]
        if not beam:
            break
        if float(best.distance) <= float(problem.limits.tolerance):
            return ended(problem, best, Status.CONVERGED)
    return ended(problem, best, Status.BUDGET if problem.budget.over else None)


def _children(problem: SearchProblem, carry: Carry) -> list[Carry]:
    """Up to `WIDTH` continuations of a sequence, each worth its action, best first."""
    best, carry = listed(problem, carry, WIDTH)
    if best is None:
        return []
    where = carry, problem.state, problem.candidates
    return [
        problem.budget.call(take, *where, best.move[k], best.first[k], best.strength[k])
        for k in range(len(best.gain))
        if float(best.gain[k]) > 0
    ]


def listed(problem: SearchProblem, carry: Carry, width: int) -> tuple[Local | None, Carry]:
    """The best `width` candidates once all were looked at; None if the budget ends before."""
    while True:
        carry, waiting, spent = problem.budget.call(
            look,
            carry,
            problem.state,
            problem.candidates,
            jnp.int32(problem.budget.room()),
            execution=problem.execution,
        )
        problem.budget.spend(int(spent))
        if not bool(waiting):
            break
        if problem.budget.over:
            return None, carry
    where = carry, problem.state, problem.candidates, problem.limits
    numbers = jnp.int32(problem.fine), jnp.int32(problem.budget.left)
    best, more = problem.budget.call(best_candidates, *where, *numbers, width=width)
    problem.budget.spend(int(more))
    return best, carry


@partial(compiled, static=("execution",))
def look(
    carry: Carry, state: SearchState, candidates: Candidates, room: Array, *, execution
) -> tuple:
    """The carry with its cache filled as far as there is room; whether more waits; spent."""
    cache, spent = refresh(state, carry.now, candidates, carry.cache, room, execution)
    return replace(carry, cache=cache), cache.stale.any(), spent


@partial(compiled, static=("width",))
def best_candidates(
    carry: Carry,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    fine: Array,
    left: Array,
    *,
    width: int,
) -> tuple[Local, Array]:
    """The best candidates of the `width` best moves, improved; no gain after convergence."""
    best, spent = improved_locally(
        state, carry.now, candidates, carry.cache, carry.used, limits, fine, width, left
    )
    far = carry.result.distance > limits.tolerance
    return replace(best, gain=jnp.where(far, best.gain, 0.0)), spent


def _as_set(result: SearchResult) -> tuple:
    """What a sequence does, whatever the order."""
    steps = int(result.steps)
    done = (one[:steps].tolist() for one in (result.move, result.node, result.strength))
    return tuple(sorted((move, tuple(node), deep) for move, node, deep in zip(*done, strict=True)))
