"""A sequence improved: one action at a time is taken out and greedy goes on from there.

Deleting is the case where it puts nothing in, inserting that where it puts in several; two actions
in a row that overlap are also tried in the other order.  Only what lowers d is kept.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from jshape._typing import Array
from jshape.planning.evaluate import CandidateCache, empty_cache
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchProblem, SearchResult, Status, ended
from jshape.planning.search.sequence import (
    measured,
    measured_without,
    numbers_of,
    units,
    with_numbers,
)

PASSES = 4
"""Times that the whole sequence is gone through, at most."""
LEAST = 1e-7
"""What d must fall by for a change to count: above the rounding of its sum."""


def search(problem: SearchProblem) -> SearchResult:
    """What greedy finds, or what was to begin with and greedy after it, improved; never worse."""
    return improved(problem, greedy.searched_on(problem))


def improved(problem: SearchProblem, result: SearchResult) -> SearchResult:
    """A sequence after exchanges and swaps until none helps or the budget is spent."""
    if not int(result.steps) or float(result.distance) <= float(problem.limits.tolerance):
        return result
    problem, state = problem.unpriced, problem.state
    cache, seen = empty_cache(problem.candidates), state.now
    for _ in range(PASSES):
        before = float(result.distance)
        for later, earlier in pairwise(units(state, result)[::-1]):
            if later.stop - earlier.start == 2:  # two actions; a carry is two by itself
                result = _swapped(problem, result, earlier.start)
        k = 0
        while k < len(every := units(state, result)):
            if problem.budget.over:
                return ended(problem, result, Status.BUDGET)
            result, cache, seen, kept = _exchanged(problem, result, every[k], cache, seen)
            # What was exchanged moved to the end: the next one is at the same number.
            k += kept
        if float(result.distance) > before - LEAST:
            break
    return ended(problem, result, None)


def _exchanged(
    problem: SearchProblem, result: SearchResult, unit: slice, cache: CandidateCache, seen: Array
) -> tuple[SearchResult, CandidateCache, Array, bool]:
    """The sequence with one action or carry exchanged, if it helps; the cache of the map seen."""
    given, count = (problem.state, result, unit.start), unit.stop - unit.start
    fewer, now, _ = problem.budget.call(measured_without, *given, count=count)
    problem.budget.spend(int(result.steps))
    progress = greedy.continued(problem, fewer, now, cache, seen)
    tried, _, _ = problem.budget.call(measured, problem.state, progress.result)
    kept = float(tried.distance) > float(result.distance) - LEAST
    result = result if kept else replace(tried, status=result.status)
    return result, progress.cache, progress.now, kept


def _swapped(problem: SearchProblem, result: SearchResult, k: int) -> SearchResult:
    """The k-th and the next action in the other order, if they overlap and that helps."""
    node, move = np.asarray(result.node), np.asarray(result.move)
    shapes = problem.state.shapes[move[k : k + 2]]
    if (np.abs(node[k] - node[k + 1]) >= (shapes[0] + shapes[1]) / 2).any() or problem.budget.over:
        return result
    order = np.arange(len(move))
    order[[k, k + 1]] = k + 1, k
    other = with_numbers(replace(result, move=result.move[order]), numbers_of(result)[order])
    other, _, _ = problem.budget.call(measured, problem.state, other)
    problem.budget.spend(int(result.steps))
    return other if float(other.distance) < float(result.distance) - LEAST else result
