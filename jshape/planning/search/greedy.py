"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Int
from jshape.planning.devices import Execution, cores, goals_together
from jshape.planning.evaluate import (
    MANY,
    Candidates,
    Work,
    evaluate,
)
from jshape.planning.search.base import (
    UNLIMITED,
    SearchLimits,
    SearchProblem,
    SearchResult,
    Status,
    compiled,
    ended,
    room_for,
)
from jshape.planning.search.sequence import measured, pruned, warm_start
from jshape.planning.search.step import (
    NextBatch,
    SearchProgress,
    begin,
    empty_batch,
    last,
    next_batch,
    resume,
    step,
)
from jshape.planning.state import SearchState

SIDE_BY_SIDE = 4
"""Calls that evaluate at the same time, at most."""


def search(problem: SearchProblem) -> SearchResult:
    """Greedy forward search within a budget.  See `run`."""
    return _priced(problem, begin(problem.state, problem.candidates, problem.max_steps))


def searched_on(problem: SearchProblem) -> SearchResult:
    """What the problem is to begin with, and greedy's actions after it; without it greedy's own."""
    start = warm_start(problem)
    if start is None:
        return search(problem)
    state, candidates, budget = problem.state, problem.candidates, problem.budget
    start, now, _ = budget.call(measured, state, pruned(problem, start, unsure=0.0))
    if int(start.steps) >= problem.max_steps:
        return ended(problem, start, Status.MAX_STEPS)
    found = _priced(problem, budget.call(resume, state, candidates, start, now))
    return budget.call(measured, state, found)[0]


def _priced(problem: SearchProblem, progress: SearchProgress) -> SearchResult:
    """The actions that gain at the price of material, and then those that gain at none."""
    state = problem.state
    progress = _searched(problem, progress)
    priced = state.price is not None and float(state.price) != 0
    if priced and int(progress.result.status) == Status.NO_IMPROVEMENT:
        # Nothing moves material to where it is missing: what is there is shaped at no price.
        free, result = problem.unpriced, progress.result
        again = problem.budget.call(resume, free.state, free.candidates, result, progress.now)
        counted = replace(again.result, evaluations=result.evaluations)
        progress = _searched(free, replace(again, result=counted))
    return progress.result


def _searched(problem: SearchProblem, progress: SearchProgress) -> SearchProgress:
    """The progress after as many actions as gain, and the budget allows."""
    state, candidates, limits = problem.state, problem.candidates, problem.limits
    budget, fine = problem.budget, np.int32(problem.fine)
    advanced = _in_turns(problem, progress) if len(candidates.first) >= MANY else None
    while True:
        before = int(progress.result.evaluations)
        if advanced is not None:
            progress = next(advanced)
        else:
            progress = budget.call(
                advance, progress, state, candidates, limits, np.int32(budget.room()),
                np.int32(budget.left), fine, execution=problem.execution,
            )  # fmt: skip
        budget.spend(int(progress.result.evaluations) - before)
        if int(progress.result.status) >= 0:
            return progress
        if budget.over and int(progress.local.round) < 0:
            # Of what is known, take the best without looking further: an answer at any time.
            result = budget.call(last, progress, state, candidates, limits)
            return replace(progress, result=result)


def _in_turns(problem: SearchProblem, progress: SearchProgress) -> Iterator[SearchProgress]:
    """`advance` for many candidates, as two compiled functions that take turns.

    One decides, the other evaluates what that asks for, in several calls side by side.  The two are
    compiled side by side too.
    """
    state, candidates, execution = problem.state, problem.candidates, problem.execution
    budget, fine = problem.budget, jnp.int32(problem.fine)
    alone = execution.mesh is not None or jax.default_backend() != "cpu"
    parts = 1 if alone else min(cores(), SIDE_BY_SIDE)

    def one_part(progress: SearchProgress, batch: NextBatch, part: int) -> Array:
        known = progress.cache.changes
        how = {"parts": parts, "execution": execution}
        new = evaluate_part(state, progress.now, batch.work, known, np.int32(part), **how)
        return jax.block_until_ready(new)

    def evaluated(progress: SearchProgress, batch: NextBatch) -> tuple[Array, ...]:
        # JAX runs the calls of one thread one after the other.
        return tuple(pool.map(partial(one_part, progress, batch), range(parts)))

    def decided(
        progress: SearchProgress, batch: NextBatch, changes: tuple[Array, ...]
    ) -> tuple[SearchProgress, NextBatch]:
        room, left = jnp.int32(budget.room()), jnp.int32(budget.left)
        return step(progress, batch, changes, state, candidates, problem.limits, room, left, fine)

    def first(progress: SearchProgress, batch: NextBatch) -> tuple[SearchProgress, NextBatch]:
        other = pool.submit(one_part, progress, batch, 0)
        found = decided(progress, batch, (progress.cache.changes,) * parts)
        other.result()
        return found

    with ThreadPoolExecutor(parts) as pool:
        progress, batch = budget.call(first, progress, empty_batch(progress, candidates))
        while True:
            changes = budget.call(evaluated, progress, batch)
            progress, batch = budget.call(decided, progress, batch, changes)
            yield progress


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


@partial(compiled, static=("max_steps", "execution"))
def run(
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    *,
    max_steps: int,
    fine: int | Array = 0,
    room: int | Array = UNLIMITED,
    execution: Execution = Execution(),
) -> SearchResult:
    """The whole search as one compiled call, for `vmap` over goals and beds; without `room` none.

    Algorithm 1 with strict decrease and ties to the first candidate.  A candidate whose window the
    last action did not touch keeps its value: neither its own nodes nor the goal's have changed,
    so it is not evaluated again.  Nor is one that cannot gain as much any more as others do.
    """
    limits = replace(limits, max_steps=jnp.minimum(limits.max_steps, max_steps))
    room, ever = jnp.asarray(room, jnp.int32), jnp.int32(UNLIMITED)

    def searched(state: SearchState, progress: SearchProgress) -> SearchProgress:
        given = progress, state, candidates, limits, room, ever, fine
        return advance(*given, execution=execution)

    progress = begin(state, candidates, max_steps)
    if state.price is None:
        return searched(state, progress).result
    price = jnp.asarray(state.price, jnp.float32)

    def at_price(progress: SearchProgress, paid: Array) -> tuple[SearchProgress, None]:
        """As `_priced`: at the price, then on at none."""
        now, result = replace(state, price=jnp.where(paid, price, 0.0)), progress.result
        again = resume(now, candidates, result, progress.now)
        again = replace(again, result=replace(again.result, evaluations=result.evaluations))
        goes_on = paid | ((price != 0) & (result.status == Status.NO_IMPROVEMENT))
        progress = lax.cond(goes_on, lambda: again, lambda: progress)
        return searched(now, progress), None

    return lax.scan(at_price, progress, jnp.array([True, False]))[0].result


@partial(compiled, static=("max_steps", "execution"))
def _together(
    state: SearchState, candidates: Candidates, limits: SearchLimits, each: Any, **how: Any
) -> SearchResult:
    """`run` of several goals and beds, vmapped: what differs between them has a leading axis."""

    def one(each: Any) -> SearchResult:
        maps, numbers = each
        return run(replace(state, **maps), candidates, replace(limits, **numbers), **how)

    return jax.vmap(one)(each)


def search_each(
    problems: Sequence[SearchProblem], together: int | None = None
) -> list[SearchResult]:
    """What `search` finds for problems that differ in goal and bed alone, without a budget (host).

    On a CPU side by side on its cores, by one program for any number of problems: in a vmapped loop
    all would wait for the slowest, and slices become gathers.  On an accelerator vmapped.

    Args:
      problems: with one set of candidates.
      together: how many in one vmapped call; None: by the device and its memory.
    """
    one, count = problems[0], len(problems)
    rooms, maps = one.candidates.first.shape[0] * len(one.candidates.strengths), one.state.now.size
    together = together or goals_together(16 * (rooms + maps), count)
    how: dict[str, Any] = {"max_steps": room_for(one.max_steps), "fine": np.int32(one.fine)}
    if together == 1:

        def alone(problem: SearchProblem, room: int = UNLIMITED) -> SearchResult:
            given = problem.state, problem.candidates, problem.limits
            found = run(*given, room=np.int32(room), execution=problem.execution, **how)
            return jax.block_until_ready(found)

        one.budget.call(alone, one, 0)  # compiled once, not by every thread
        with ThreadPoolExecutor(min(cores(), count)) as pool:
            return list(pool.map(alone, problems))
    how["execution"] = replace(one.execution, chunk=max(one.execution.nodes // together, 1))
    found = []
    for start in range(0, count, together):
        some = list(problems[start : start + together])
        full = some + some[-1:] * (together - len(some))
        each = jax.tree.map(lambda *x: jnp.stack(x), *map(_own, full))
        given = one.state, one.candidates, one.limits, each
        many = jax.device_get(one.budget.call(_together, *given, **how))
        found += [jax.tree.map(lambda x, k=k: x[k], many) for k in range(len(some))]
    return found


def _own(problem: SearchProblem) -> Any:
    """What is a problem's own: of its state, and of its limits."""
    state, limits = problem.state, problem.limits
    maps = {name: getattr(state, name) for name in ("now", "goal", "weight", "price")}
    return maps, {name: jnp.float32(getattr(limits, name)) for name in ("min_gain", "stock")}


@partial(compiled, static=("execution",))
def advance(
    progress: SearchProgress,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    room: Int[Array, ""],
    left: Int[Array, ""],
    fine: int | Array = 0,
    *,
    execution: Execution = Execution(),
) -> SearchProgress:
    """Go on until the search ends or about `room` candidates were evaluated, of `left` at most."""
    if not state.moves:
        near = progress.result.distance <= limits.tolerance
        status = jnp.where(near, Status.CONVERGED, Status.NO_IMPROVEMENT).astype(jnp.int32)
        return replace(progress, result=replace(progress.result, status=status))
    began = progress.result.evaluations

    def rest(progress: SearchProgress, whole: Array) -> Array:
        return whole - (progress.result.evaluations - began)

    def go_on(now: tuple[SearchProgress, NextBatch]) -> Array:
        progress, _ = now
        unfinished = (rest(progress, room) > 0) | (progress.local.round >= 0)
        return (progress.result.status < 0) & unfinished

    def one(now: tuple[SearchProgress, NextBatch]) -> tuple[SearchProgress, NextBatch]:
        progress, batch = now
        changes = evaluate(state, progress.now, batch.work, progress.cache.changes, execution)
        spent = jnp.where(progress.local.round < 0, batch.count(candidates), 0)
        given = progress, batch, (changes,), state, candidates, limits
        return step(*given, rest(progress, room) - spent, rest(progress, left), fine)

    batch = next_batch(progress, state, candidates, limits, room, fine)
    return lax.while_loop(go_on, one, (progress, batch))[0]
