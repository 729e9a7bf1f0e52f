"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.planning.evaluate import ONE_BY_ONE, Board, Candidates, How, fresh_board, refresh, touch
from jshape.planning.search.base import EVER, Found, Limits, Status, Task, nothing
from jshape.planning.search.local import polished
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


@jax.jit(static_argnames=["max_steps"])
def begin(terrain: Terrain, candidates: Candidates, max_steps: int) -> State:
    """Nothing done, nothing known."""
    actions = 1 + max((move.action for move in terrain.moves), default=0)
    used = jnp.zeros(actions, jnp.int32)
    return State(terrain.now, fresh_board(candidates), used, nothing(terrain, max_steps))


def search(task: Task) -> Found:
    """Greedy forward search within a budget.  See `run`."""
    terrain, candidates, how = task.terrain, task.candidates, task.how
    state = begin(terrain, candidates, task.max_steps)
    while True:
        before = int(state.found.evaluations)
        room, left = jnp.int32(task.budget.room()), jnp.int32(task.budget.left)
        state = task.budget.call(
            advance, state, terrain, candidates, task.limits, room, left, fine=task.fine, how=how
        )
        task.budget.spend(int(state.found.evaluations) - before)
        if int(state.found.status) >= 0:
            return state.found
        if task.budget.over:
            # Of what is known, take the best without looking further: an answer at any time.
            return last(state, terrain, candidates, task.limits)


@jax.jit(static_argnames=["max_steps", "fine", "how"])
def run(
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    *,
    max_steps: int,
    fine: int = 0,
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
    return advance(state, terrain, candidates, limits, ever, ever, fine, how).found


@jax.jit(static_argnames=["fine", "how"])
def advance(
    state: State,
    terrain: Terrain,
    candidates: Candidates,
    limits: Limits,
    room: Int[Array, ""],
    left: Int[Array, ""],
    fine: int = 0,
    how: How = ONE_BY_ONE,
) -> State:
    """Go on until the search ends or about `room` candidates were evaluated, of `left` at most."""
    began = state.found.evaluations

    def go_on(state: State) -> Array:
        return (state.found.status < 0) & (state.found.evaluations - began < room)

    def step(state: State) -> State:
        rest = room - (state.found.evaluations - began)
        board, spent = refresh(terrain, state.now, candidates, state.board, rest, how)
        found = replace(state.found, evaluations=state.found.evaluations + spent)
        state = replace(state, board=board, found=found)
        waiting = jnp.stack([stale.any() for stale in board.stale]).any()
        return lax.cond(waiting, lambda s: s, decide, state)

    def decide(state: State) -> State:
        best_ones = best_of_moves(state, terrain, candidates, limits)
        rest = left - (state.found.evaluations - began)
        chosen, firsts, strengths, gains, more = polished(
            terrain, state.now, candidates, *best_ones, limits, fine, left=rest
        )
        best = jnp.argmax(gains)
        gain, first, strength = gains[best], firsts[best], strengths[best]
        found = state.found
        near = found.distance <= limits.tolerance
        full = found.steps >= limits.max_steps
        worth = gain > 0
        status = jnp.where(
            near,
            Status.CONVERGED,
            jnp.where(~worth, Status.NO_IMPROVEMENT, jnp.where(full, Status.MAX_STEPS, -1)),
        ).astype(jnp.int32)
        found = replace(found, status=status, evaluations=found.evaluations + more)
        state = replace(state, found=found)
        return lax.cond(
            status < 0,
            lambda s: take(s, terrain, candidates, chosen[best], first, strength),
            lambda s: s,
            state,
        )

    if not terrain.moves or not len(candidates):
        near = state.found.distance <= limits.tolerance
        status = jnp.where(near, Status.CONVERGED, Status.NO_IMPROVEMENT).astype(jnp.int32)
        return replace(state, found=replace(state.found, status=status))
    return lax.while_loop(go_on, step, state)


def best_of_moves(
    state: State, terrain: Terrain, candidates: Candidates, limits: Limits
) -> tuple[Array, Array, Array]:
    """The best known candidate of each move; of equals the first.

    Returns:
      Gains of d, 0 where none exceeds what its action needs; first nodes; strengths.
    """
    gains, firsts, strengths = [], [], []
    for move, first, change in zip(
        terrain.moves, candidates.first, state.board.changes, strict=True
    ):
        if not first.shape[0]:
            gains.append(jnp.float32(0))
            firsts.append(jnp.zeros(2, jnp.int32))
            strengths.append(jnp.float32(0))
            continue
        gain = jnp.where(-change > limits.needed(move.action, candidates.strengths), -change, 0.0)
        gain = jnp.where(limits.allowed(move.action, state.used), gain, 0.0)
        best = jnp.argmax(gain)
        row, column = jnp.divmod(best, len(candidates.strengths))
        gains.append(gain[row, column])
        firsts.append(first[row])
        strengths.append(candidates.strengths[column])
    return jnp.stack(gains), jnp.stack(firsts), jnp.stack(strengths)


@jax.jit
def take(state: State, terrain: Terrain, candidates: Candidates, best, first, strength) -> State:
    """Apply a move to the map and note it."""

    def with_move(number: int):
        def act(now):
            return terrain.act(terrain.moves[number], now, first, strength)

        return act

    now = lax.switch(best, [with_move(m) for m in range(len(terrain.moves))], state.now)
    shapes = jnp.array([move.shape for move in terrain.moves], jnp.int32)
    middles = shapes // 2
    action = jnp.array([move.action for move in terrain.moves], jnp.int32)[best]
    found, k = state.found, state.found.steps
    return State(
        now=now,
        board=touch(state.board, candidates, terrain, first, shapes[best]),
        used=state.used.at[action].add(1),
        found=replace(
            found,
            steps=k + 1,
            move=found.move.at[k].set(best.astype(jnp.int32)),
            node=found.node.at[k].set((first + middles[best]).astype(jnp.float32)),
            strength=found.strength.at[k].set(strength),
            distance=terrain.distance_of(now),
        ),
    )


@jax.jit
def last(state: State, terrain: Terrain, candidates: Candidates, limits: Limits) -> Found:
    """One more action out of what is known, where it helps; then the budget is over."""
    fresh = [
        jnp.where(stale[:, None], 0.0, change)
        for stale, change in zip(state.board.stale, state.board.changes, strict=True)
    ]
    state = replace(state, board=replace(state.board, changes=tuple(fresh)))
    gains, firsts, strengths = best_of_moves(state, terrain, candidates, limits)
    best = jnp.argmax(gains)
    room = state.found.steps < limits.max_steps
    state = lax.cond(
        (gains[best] > 0) & room & (state.found.distance > limits.tolerance),
        lambda s: take(s, terrain, candidates, best, firsts[best], strengths[best]),
        lambda s: s,
        state,
    )
    return replace(state.found, status=jnp.int32(Status.BUDGET))
