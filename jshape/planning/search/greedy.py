"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.planning.evaluate import (
    ONE_BY_ONE,
    Board,
    Candidates,
    How,
    evaluate,
    fresh_board,
    stale_work,
    touch,
)  # fmt: skip
from jshape.planning.search.base import EVER, Found, Limits, Status, Task, compiled, nothing
from jshape.planning.search.local import Local, begin_local, local_work, next_local, no_local
from jshape.planning.state import Terrain


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class State:
    """What changes from step to step; all storage is allocated before the loop."""

    now: Float[Array, "R C"]
    board: Board
    used: Int[Array, "A"]
    """How often each action was taken."""
    found: Found
    local: Local


@jax.jit(static_argnames=["max_steps"])
def begin(terrain: Terrain, candidates: Candidates, max_steps: int) -> State:
    """Nothing done, nothing known."""
    used = jnp.zeros(1 + max(terrain.actions, default=0), jnp.int32)
    found = nothing(terrain, max_steps)
    return State(terrain.now, fresh_board(candidates), used, found, no_local(terrain))


def search(task: Task) -> Found:
    """Greedy forward search within a budget.  See `run`."""
    terrain, candidates, how = task.terrain, task.candidates, task.how
    state, fine = begin(terrain, candidates, task.max_steps), jnp.int32(task.fine)
    while True:
        before = int(state.found.evaluations)
        room, left = jnp.int32(task.budget.room()), jnp.int32(task.budget.left)
        state = task.budget.call(
            advance, state, terrain, candidates, task.limits, room, left, fine, how=how
        )
        task.budget.spend(int(state.found.evaluations) - before)
        if int(state.found.status) >= 0:
            return state.found
        if task.budget.over:
            # Of what is known, take the best without looking further: an answer at any time.
            return last(state, terrain, candidates, task.limits)


@jax.jit(static_argnames=["max_steps", "how"])
def run(
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    *,
    max_steps: int,
    fine: int | Array = 0,
    how: How = ONE_BY_ONE,
) -> Found:
    """The whole search as one compiled call, for `vmap` over goals and beds.

    Algorithm 1 with strict decrease and ties to the first candidate.  A candidate whose window the
    last action did not touch keeps its value: neither its own nodes nor the goal's have changed,
    so it is not evaluated again.
    """
    state = begin(terrain, candidates, max_steps)
    limits = replace(limits, max_steps=max_steps)
    ever = jnp.int32(EVER)
    return advance(state, terrain, candidates, limits, ever, ever, fine, how=how).found


@partial(compiled, static=("how",))
def advance(
    state: State,
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    room: Int[Array, ""],
    left: Int[Array, ""],
    fine: int | Array = 0,
    *,
    how: How = ONE_BY_ONE,
) -> State:
    """Go on until the search ends or about `room` candidates were evaluated, of `left` at most.

    Looking at the stale candidates and the rounds of a local search are evaluated by one loop
    body: what a move does is traced and compiled once.
    """
    began = state.found.evaluations
    if not terrain.moves:
        near = state.found.distance <= limits.tolerance
        status = jnp.where(near, Status.CONVERGED, Status.NO_IMPROVEMENT).astype(jnp.int32)
        return replace(state, found=replace(state.found, status=status))

    def go_on(state: State) -> Array:
        in_room = state.found.evaluations - began < room
        return (state.found.status < 0) & (in_room | (state.local.round >= 0))

    def step(state: State) -> State:
        looking = state.local.round < 0
        rest = room - (state.found.evaluations - began)
        nothing_due = jnp.zeros_like(state.board.stale)
        work, due = lax.cond(
            looking,
            lambda s: stale_work(terrain, candidates, s.board, rest),
            lambda s: (local_work(terrain, candidates, s.local, fine), nothing_due),
            state,
        )
        changes = evaluate(terrain, state.now, work, state.board.changes, how)
        state = replace(state, board=Board(changes, state.board.stale & ~due))
        spent = jnp.where(looking, work.start[-1] * candidates.tried, 0)
        local, more = lax.cond(looking, looked, moved, state, left - spent)
        evaluations = state.found.evaluations + spent + more
        state = replace(state, found=replace(state.found, evaluations=evaluations), local=local)
        return lax.cond(local.round == fine, decide, lambda s: s, state)

    def looked(state: State, left: Array) -> tuple[Local, Array]:
        """A local search begins when nothing is stale any more."""
        left = left - (state.found.evaluations - began)

        def begin_one(state):
            return begin_local(
                terrain, candidates, state.board, state.used, limits, fine, left=left
            )

        return lax.cond(
            state.board.stale.any(), lambda s: (s.local, jnp.int32(0)), begin_one, state
        )

    def moved(state: State, left: Array) -> tuple[Local, Array]:
        changes = state.board.changes
        local = next_local(terrain, candidates, state.local, changes, limits, fine)
        return local, jnp.int32(0)

    def decide(state: State) -> State:
        best = jnp.argmax(state.local.gain)
        found = state.found
        near = found.distance <= limits.tolerance
        full = found.steps >= limits.max_steps
        worth = state.local.gain[best] > 0
        status = jnp.where(
            near,
            Status.CONVERGED,
            jnp.where(~worth, Status.NO_IMPROVEMENT, jnp.where(full, Status.MAX_STEPS, -1)),
        ).astype(jnp.int32)
        local = replace(state.local, round=jnp.int32(-1))
        state = replace(state, found=replace(found, status=status), local=local)
        return lax.cond(
            status < 0,
            lambda s: _take(
                s, terrain, candidates, local.move[best], local.first[best], local.strength[best]
            ),
            lambda s: s,
            state,
        )

    return lax.while_loop(go_on, step, state)


def _take(state: State, terrain: Terrain, candidates: Candidates, move, first, strength) -> State:
    now = terrain.act(move, state.now, first, strength)
    shape = jnp.asarray(terrain.shapes)[move]
    found, k = state.found, state.found.steps
    return replace(
        state,
        now=now,
        board=touch(state.board, candidates, terrain, first, shape),
        used=state.used.at[jnp.asarray(terrain.actions)[move]].add(1),
        found=replace(
            found,
            steps=k + 1,
            move=found.move.at[k].set(move.astype(jnp.int32)),
            node=found.node.at[k].set((first + shape // 2).astype(jnp.float32)),
            strength=found.strength.at[k].set(strength),
            distance=terrain.distance_of(now),
        ),
    )


@compiled
def take(
    state: State, terrain: Terrain, candidates: Candidates, move: Array, first: Array,
    strength: Array,
) -> State:  # fmt: skip
    """Apply a move to the map and note it."""
    return _take(state, terrain, candidates, move, first, strength)


@jax.jit
def last(state: State, terrain: Terrain, candidates: Candidates, limits: Limits) -> Found:
    """One more action out of what is known, where it helps; then the budget is over."""
    if not terrain.moves:
        return replace(state.found, status=jnp.int32(Status.BUDGET))
    fresh = jnp.where(state.board.stale[:, None], 0.0, state.board.changes)
    board = replace(state.board, changes=fresh)
    best, _ = begin_local(terrain, candidates, board, state.used, limits, 0, width=1)
    room = state.found.steps < limits.max_steps
    state = lax.cond(
        (best.gain[0] > 0) & room & (state.found.distance > limits.tolerance),
        lambda s: _take(s, terrain, candidates, best.move[0], best.first[0], best.strength[0]),
        lambda s: s,
        state,
    )
    return replace(state.found, status=jnp.int32(Status.BUDGET))
