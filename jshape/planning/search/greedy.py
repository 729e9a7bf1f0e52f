"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.planning.evaluate import (
    ONE_BY_ONE,
    CandidateCache,
    Candidates,
    Execution,
    empty_cache,
    evaluate,
    stale_work,
    touch,
)  # fmt: skip
from jshape.planning.search.base import (
    UNLIMITED,
    SearchLimits,
    SearchProblem,
    SearchResult,
    Status,
    compiled,
    empty_result,
)
from jshape.planning.search.local import Local, begin_local, local_work, next_local, no_local
from jshape.planning.state import SearchState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Carry:
    """What changes from step to step; all storage is allocated before the loop."""

    now: Float[Array, "R C"]
    cache: CandidateCache
    used: Int[Array, "A"]
    """How often each action was taken."""
    result: SearchResult
    local: Local


@jax.jit(static_argnames=["max_steps"])
def begin(state: SearchState, candidates: Candidates, max_steps: int) -> Carry:
    """Nothing done, nothing known."""
    used = jnp.zeros(1 + max(state.actions, default=0), jnp.int32)
    result = empty_result(state, max_steps)
    return Carry(state.now, empty_cache(candidates), used, result, no_local(state))


def search(problem: SearchProblem) -> SearchResult:
    """Greedy forward search within a budget.  See `run`."""
    state, candidates, execution = problem.state, problem.candidates, problem.execution
    carry, fine = begin(state, candidates, problem.max_steps), jnp.int32(problem.fine)
    while True:
        before = int(carry.result.evaluations)
        room, left = jnp.int32(problem.budget.room()), jnp.int32(problem.budget.left)
        carry = problem.budget.call(
            advance, carry, state, candidates, problem.limits, room, left, fine, execution=execution
        )
        problem.budget.spend(int(carry.result.evaluations) - before)
        if int(carry.result.status) >= 0:
            return carry.result
        if problem.budget.over:
            # Of what is known, take the best without looking further: an answer at any time.
            return last(carry, state, candidates, problem.limits)


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
    so it is not evaluated again.
    """
    carry = begin(state, candidates, max_steps)
    limits = replace(limits, max_steps=max_steps)
    ever = jnp.int32(UNLIMITED)
    return advance(carry, state, candidates, limits, ever, ever, fine, execution=execution).result


@partial(compiled, static=("execution",))
def advance(
    carry: Carry,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    room: Int[Array, ""],
    left: Int[Array, ""],
    fine: int | Array = 0,
    *,
    execution: Execution = ONE_BY_ONE,
) -> Carry:
    """Go on until the search ends or about `room` candidates were evaluated, of `left` at most.

    Looking at the stale candidates and the rounds of a local search are evaluated by one loop
    body: what a move does is traced and compiled once.
    """
    began = carry.result.evaluations
    if not state.moves:
        near = carry.result.distance <= limits.tolerance
        status = jnp.where(near, Status.CONVERGED, Status.NO_IMPROVEMENT).astype(jnp.int32)
        return replace(carry, result=replace(carry.result, status=status))

    def go_on(carry: Carry) -> Array:
        in_room = carry.result.evaluations - began < room
        return (carry.result.status < 0) & (in_room | (carry.local.round >= 0))

    def step(carry: Carry) -> Carry:
        looking = carry.local.round < 0
        rest = room - (carry.result.evaluations - began)
        nothing_due = jnp.zeros_like(carry.cache.stale)
        work, due = lax.cond(
            looking,
            lambda s: stale_work(state, candidates, s.cache, rest),
            lambda s: (local_work(state, candidates, s.local, fine), nothing_due),
            carry,
        )
        changes = evaluate(state, carry.now, work, carry.cache.changes, execution)
        carry = replace(carry, cache=CandidateCache(changes, carry.cache.stale & ~due))
        spent = jnp.where(looking, work.start[-1] * candidates.num_strengths, 0)
        local, more = lax.cond(looking, looked, moved, carry, left - spent)
        evaluations = carry.result.evaluations + spent + more
        carry = replace(carry, result=replace(carry.result, evaluations=evaluations), local=local)
        return lax.cond(local.round == fine, decide, lambda s: s, carry)

    def looked(carry: Carry, left: Array) -> tuple[Local, Array]:
        """A local search begins when nothing is stale any more."""
        left = left - (carry.result.evaluations - began)

        def begin_one(carry):
            return begin_local(state, candidates, carry.cache, carry.used, limits, fine, left=left)

        return lax.cond(
            carry.cache.stale.any(), lambda s: (s.local, jnp.int32(0)), begin_one, carry
        )

    def moved(carry: Carry, left: Array) -> tuple[Local, Array]:
        changes = carry.cache.changes
        local = next_local(state, candidates, carry.local, changes, limits, fine)
        return local, jnp.int32(0)

    def decide(carry: Carry) -> Carry:
        best = jnp.argmax(carry.local.gain)
        result = carry.result
        near = result.distance <= limits.tolerance
        full = result.steps >= limits.max_steps
        worth = carry.local.gain[best] > 0
        status = jnp.where(
            near,
            Status.CONVERGED,
            jnp.where(~worth, Status.NO_IMPROVEMENT, jnp.where(full, Status.MAX_STEPS, -1)),
        ).astype(jnp.int32)
        local = replace(carry.local, round=jnp.int32(-1))
        carry = replace(carry, result=replace(result, status=status), local=local)
        return lax.cond(
            status < 0,
            lambda s: _take(
                s, state, candidates, local.move[best], local.first[best], local.strength[best]
            ),
            lambda s: s,
            carry,
        )

    return lax.while_loop(go_on, step, carry)


def _take(carry: Carry, state: SearchState, candidates: Candidates, move, first, strength) -> Carry:
    now = state.act(move, carry.now, first, strength)
    shape = jnp.asarray(state.shapes)[move]
    result, k = carry.result, carry.result.steps
    return replace(
        carry,
        now=now,
        cache=touch(carry.cache, candidates, state, first, shape),
        used=carry.used.at[jnp.asarray(state.actions)[move]].add(1),
        result=replace(
            result,
            steps=k + 1,
            move=result.move.at[k].set(move.astype(jnp.int32)),
            node=result.node.at[k].set((first + shape // 2).astype(jnp.float32)),
            strength=result.strength.at[k].set(strength),
            distance=state.distance_of(now),
        ),
    )


@compiled
def take(
    carry: Carry, state: SearchState, candidates: Candidates, move: Array, first: Array,
    strength: Array,
) -> Carry:  # fmt: skip
    """Apply a move to the map and note it."""
    return _take(carry, state, candidates, move, first, strength)


@jax.jit
def last(
    carry: Carry, state: SearchState, candidates: Candidates, limits: SearchLimits
) -> SearchResult:
    """One more action out of what is known, where it helps; then the budget is over."""
    if not state.moves:
        return replace(carry.result, status=jnp.int32(Status.BUDGET))
    fresh = jnp.where(carry.cache.stale[:, None], 0.0, carry.cache.changes)
    cache = replace(carry.cache, changes=fresh)
    best, _ = begin_local(state, candidates, cache, carry.used, limits, 0, width=1)
    room = carry.result.steps < limits.max_steps
    carry = lax.cond(
        (best.gain[0] > 0) & room & (carry.result.distance > limits.tolerance),
        lambda s: _take(s, state, candidates, best.move[0], best.first[0], best.strength[0]),
        lambda s: s,
        carry,
    )
    return replace(carry.result, status=jnp.int32(Status.BUDGET))
