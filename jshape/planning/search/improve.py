"""A sequence improved: one action at a time is taken out and greedy goes on from there.

Deleting is the case where it puts nothing in, inserting that where it puts in several; two actions
in a row that overlap are also tried in the other order.  Only what lowers d is kept.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jshape._typing import Array
from jshape.planning.evaluate import CandidateCache, Candidates, empty_cache, touch
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchProblem, SearchResult, Status, better, compiled, ended
from jshape.planning.search.local import no_local
from jshape.planning.search.sequence import measured, warm_start, without
from jshape.planning.search.step import SearchProgress
from jshape.planning.state import SearchState

PASSES = 4
"""Times that the whole sequence is gone through, at most."""
LEAST = 1e-7
"""What d must fall by for a change to count: above the rounding of its sum."""


def search(problem: SearchProblem) -> SearchResult:
    """What greedy finds, or what was to begin with, improved; never worse than either."""
    best = greedy.search(problem)
    start = warm_start(problem)
    if start is not None:
        best = better(best, replace(start, status=best.status))
    return improved(problem, best)


def improved(problem: SearchProblem, result: SearchResult) -> SearchResult:
    """A sequence after exchanges and swaps until none helps or the budget is spent."""
    if not int(result.steps) or float(result.distance) <= float(problem.limits.tolerance):
        return result
    cache, seen = empty_cache(problem.candidates), problem.state.now
    for _ in range(PASSES):
        before = float(result.distance)
        for k in range(int(result.steps) - 2, -1, -1):
            result = _swapped(problem, result, k)
        k = 0
        while k < int(result.steps):
            if problem.budget.over:
                return ended(problem, result, Status.BUDGET)
            result, cache, seen, kept = _exchanged(problem, result, k, cache, seen)
            # What was exchanged moved to the end: the next one is at the same number.
            k += kept
        if float(result.distance) > before - LEAST:
            break
    return ended(problem, result, None)


def _exchanged(
    problem: SearchProblem, result: SearchResult, k: int, cache: CandidateCache, seen: Array
) -> tuple[SearchResult, CandidateCache, Array, bool]:
    """The sequence with its k-th action exchanged, if that helps; the cache of the map seen."""
    fewer, now, _ = problem.budget.call(measured, problem.state, without(result, k))
    problem.budget.spend(int(result.steps))
    carry = problem.budget.call(at_map, problem.state, problem.candidates, fewer, now, cache, seen)
    while True:  # greedy from there, in pieces that keep the budget
        spent = int(carry.result.evaluations)
        carry = problem.budget.call(
            greedy.advance, carry, problem.state, problem.candidates, problem.limits,
            jnp.int32(problem.budget.room()), jnp.int32(problem.budget.left),
            jnp.int32(problem.fine), execution=problem.execution,
        )  # fmt: skip
        problem.budget.spend(int(carry.result.evaluations) - spent)
        if int(carry.result.status) >= 0 or problem.budget.over:
            break
    tried, _, _ = problem.budget.call(measured, problem.state, carry.result)
    kept = float(tried.distance) > float(result.distance) - LEAST
    result = result if kept else replace(tried, status=result.status)
    return result, carry.cache, carry.now, kept


@compiled
def at_map(
    state: SearchState,
    candidates: Candidates,
    result: SearchResult,
    now: Array,
    cache: CandidateCache,
    seen: Array,
) -> SearchProgress:
    """Greedy's carry after a sequence.  In the cache, what lies where the map differs is stale."""
    apart = jnp.abs(now - seen) > 0
    rows, columns = apart.any(1), apart.any(0)
    first = jnp.array([jnp.argmax(rows), jnp.argmax(columns)], jnp.int32)
    ends = jnp.array([jnp.argmax(rows[::-1]), jnp.argmax(columns[::-1])], jnp.int32)
    last = jnp.array(apart.shape, jnp.int32) - ends
    shape = jnp.where(apart.any(), last - first, 0)
    cache = touch(cache, candidates, state, first, shape)
    actions = jnp.asarray(state.actions)
    used = jnp.zeros(1 + max(state.actions), jnp.int32)
    used = used.at[actions[result.move]].add((result.move >= 0).astype(jnp.int32))
    status, none = jnp.int32(-1), jnp.int32(0)
    result = replace(result, status=status, evaluations=none)
    none = jnp.zeros((), jnp.float32)
    return SearchProgress(now, cache, used, result, no_local(state), none)


def _swapped(problem: SearchProblem, result: SearchResult, k: int) -> SearchResult:
    """The k-th and the next action in the other order, if they overlap and that helps."""
    node, move = np.asarray(result.node), np.asarray(result.move)
    shapes = problem.state.shapes[move[k : k + 2]]
    if (np.abs(node[k] - node[k + 1]) >= (shapes[0] + shapes[1]) / 2).any() or problem.budget.over:
        return result
    order = np.arange(len(move))
    order[[k, k + 1]] = k + 1, k
    other = replace(
        result, move=result.move[order], node=result.node[order], strength=result.strength[order]
    )
    other, _, _ = problem.budget.call(measured, problem.state, other)
    problem.budget.spend(int(result.steps))
    return other if float(other.distance) < float(result.distance) - LEAST else result
