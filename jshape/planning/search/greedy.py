"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Int
from jshape.planning.devices import cores
from jshape.planning.evaluate import (
    MANY,
    ONE_BY_ONE,
    Candidates,
    Execution,
    Work,
    empty_cache,
    evaluate,
)
from jshape.planning.search.base import (
    UNLIMITED,
    SearchLimits,
    SearchProblem,
    SearchResult,
    Status,
    compiled,
)
from jshape.planning.search.local import no_local
from jshape.planning.search.step import (
    NextBatch,
    SearchProgress,
    begin,
    empty_batch,
    last,
    next_batch,
    step,
)
from jshape.planning.state import SearchState

SIDE_BY_SIDE = 4
"""Calls that evaluate at the same time, at most."""


def search(problem: SearchProblem) -> SearchResult:
    """Greedy forward search within a budget.  See `run`."""
    state = problem.state
    carry = _searched(problem, begin(state, problem.candidates, problem.max_steps))
    priced = state.price is not None and float(state.price) != 0
    if priced and int(carry.result.status) == Status.NO_IMPROVEMENT:
        # Nothing moves material to where it is missing: what is there is shaped at no price.
        free = replace(problem, state=replace(state, price=np.zeros((), np.float32)))
        again = replace(carry.result, status=jnp.int32(-1))
        cache = empty_cache(problem.candidates)
        carry = _searched(free, replace(carry, cache=cache, local=no_local(state), result=again))
    return carry.result


def _searched(problem: SearchProblem, carry: SearchProgress) -> SearchProgress:
    """The carry after as many actions as gain, and the budget allows."""
    state, candidates, limits = problem.state, problem.candidates, problem.limits
    budget, fine = problem.budget, np.int32(problem.fine)
    advanced = _in_turns(problem, carry) if len(candidates.first) >= MANY else None
    while True:
        before = int(carry.result.evaluations)
        if advanced is not None:
            carry = next(advanced)
        else:
            carry = budget.call(
                advance, carry, state, candidates, limits, np.int32(budget.room()),
                np.int32(budget.left), fine, execution=problem.execution,
            )  # fmt: skip
        budget.spend(int(carry.result.evaluations) - before)
        if int(carry.result.status) >= 0:
            return carry
        if budget.over and int(carry.local.round) < 0:
            # Of what is known, take the best without looking further: an answer at any time.
            result = budget.call(last, carry, state, candidates, limits)
            return replace(carry, result=result)


def _in_turns(problem: SearchProblem, carry: SearchProgress) -> Iterator[SearchProgress]:
    """`advance` for many candidates, as two compiled functions that take turns.

    One decides, the other evaluates what that asks for, in several calls side by side.  The two are
    compiled side by side too.
    """
    state, candidates, execution = problem.state, problem.candidates, problem.execution
    budget, fine = problem.budget, jnp.int32(problem.fine)
    alone = execution != ONE_BY_ONE or jax.default_backend() != "cpu"
    parts = 1 if alone else min(cores(), SIDE_BY_SIDE)

    def one_part(carry: SearchProgress, batch: NextBatch, part: int) -> Array:
        known = carry.cache.changes
        how = {"parts": parts, "execution": execution}
        new = evaluate_part(state, carry.now, batch.work, known, np.int32(part), **how)
        return jax.block_until_ready(new)

    def evaluated(carry: SearchProgress, batch: NextBatch) -> tuple[Array, ...]:
        # JAX runs the calls of one thread one after the other.
        return tuple(pool.map(partial(one_part, carry, batch), range(parts)))

    def decided(
        carry: SearchProgress, batch: NextBatch, changes: tuple[Array, ...]
    ) -> tuple[SearchProgress, NextBatch]:
        room, left = jnp.int32(budget.room()), jnp.int32(budget.left)
        return step(carry, batch, changes, state, candidates, problem.limits, room, left, fine)

    def first(carry: SearchProgress, batch: NextBatch) -> tuple[SearchProgress, NextBatch]:
        other = pool.submit(one_part, carry, batch, 0)
        found = decided(carry, batch, (carry.cache.changes,) * parts)
        other.result()
        return found

    with ThreadPoolExecutor(parts) as pool:
        carry, batch = budget.call(first, carry, empty_batch(carry, candidates))
        while True:
            changes = budget.call(evaluated, carry, batch)
            carry, batch = budget.call(decided, carry, batch, changes)
            yield carry


@partial(compiled, static=("parts", "execution"))
def evaluate_part(
    state: SearchState,
    now: Array,
    work: Work,
    changes: Array,
    part: Int[Array, ""],
    *,
    parts: int,
    execution: Execution,
) -> Array:
    """`changes` with one of several parts of the work computed anew."""
    return evaluate(state, now, work, changes, execution, (part, parts))


@jax.jit(static_argnames=["max_steps", "execution"])
def run(
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    *,
    max_steps: int,
    fine: int | Array = 0,
    execution: Execution = ONE_BY_ONE,
) -> SearchResult:
    """The whole search as one compiled call, for `vmap` over goals and beds.

    Algorithm 1 with strict decrease and ties to the first candidate.  A candidate whose window the
    last action did not touch keeps its value: neither its own nodes nor the goal's have changed,
    so it is not evaluated again.  Nor is one that cannot gain as much any more as others do.
    A price of material is paid to the end: `search` goes on without.
    """
    carry = begin(state, candidates, max_steps)
    limits = replace(limits, max_steps=max_steps)
    ever = jnp.int32(UNLIMITED)
    return advance(carry, state, candidates, limits, ever, ever, fine, execution=execution).result


@partial(compiled, static=("execution",))
def advance(
    carry: SearchProgress,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    room: Int[Array, ""],
    left: Int[Array, ""],
    fine: int | Array = 0,
    *,
    execution: Execution = ONE_BY_ONE,
) -> SearchProgress:
    """Go on until the search ends or about `room` candidates were evaluated, of `left` at most."""
    if not state.moves:
        near = carry.result.distance <= limits.tolerance
        status = jnp.where(near, Status.CONVERGED, Status.NO_IMPROVEMENT).astype(jnp.int32)
        return replace(carry, result=replace(carry.result, status=status))
    began = carry.result.evaluations

    def rest(carry: SearchProgress, whole: Array) -> Array:
        return whole - (carry.result.evaluations - began)

    def go_on(now: tuple[SearchProgress, NextBatch]) -> Array:
        carry, _ = now
        return (carry.result.status < 0) & ((rest(carry, room) > 0) | (carry.local.round >= 0))

    def one(now: tuple[SearchProgress, NextBatch]) -> tuple[SearchProgress, NextBatch]:
        carry, batch = now
        changes = evaluate(state, carry.now, batch.work, carry.cache.changes, execution)
        ahead = rest(carry, room) - jnp.where(carry.local.round < 0, batch.count(candidates), 0)
        given = carry, batch, (changes,), state, candidates, limits
        return step(*given, ahead, rest(carry, left), fine)

    batch = next_batch(carry, state, candidates, limits, room, fine)
    return lax.while_loop(go_on, one, (carry, batch))[0]
