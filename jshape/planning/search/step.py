"""One step of a greedy search: what is evaluated next, and the best action once it is known."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Bool, Float, Int
from jshape.planning.evaluate import (
    CandidateCache,
    Candidates,
    Work,
    first_cache,
    touch,
    work_of,
)
from jshape.planning.search.base import (
    SearchLimits,
    SearchResult,
    Status,
    compiled,
    empty_result,
)
from jshape.planning.search.local import (
    Local,
    begin_local,
    local_work,
    next_local,
    no_local,
    pending,
)
from jshape.planning.search.transfer import best_transfer
from jshape.planning.state import SearchState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SearchProgress:
    """What changes from step to step; all storage is allocated before the loop."""

    now: Float[Array, "R C"]
    cache: CandidateCache
    used: Int[Array, "A"]
    """How often each action was taken."""
    result: SearchResult
    local: Local
    stocked: Float[Array, ""]
    """What a stock beside the bed holds more than at first, in units of Σ now."""


@jax.jit(static_argnames=["max_steps"])
def begin(state: SearchState, candidates: Candidates, max_steps: int) -> SearchProgress:
    """Nothing done, nothing known."""
    return resume(state, candidates, empty_result(state, max_steps), state.now)


@compiled
def resume(
    state: SearchState, candidates: Candidates, result: SearchResult, now: Array
) -> SearchProgress:
    """After a sequence that leads to the map `now`."""
    used = jnp.zeros(1 + max(state.actions, default=0), jnp.int32)
    taken = (result.move >= 0).astype(jnp.int32)
    used = used.at[jnp.asarray(state.actions)[result.move]].add(taken)
    result = replace(result, status=jnp.int32(-1), evaluations=jnp.int32(0))
    none = jnp.zeros((), jnp.float32)
    cache = first_cache(state, candidates, now)
    return SearchProgress(now, cache, used, result, no_local(state), none)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NextBatch:
    """What is to be evaluated next."""

    work: Work
    due: Bool[Array, "N"]
    """Candidates that are then known; none while a local search is in progress."""

    def count(self, candidates: Candidates) -> Array:
        """Evaluations, where candidates are evaluated."""
        return self.work.start[-1] * candidates.num_strengths


def empty_batch(progress: SearchProgress, candidates: Candidates) -> NextBatch:
    """Nothing (host)."""
    places, strengths = progress.cache.changes.shape
    moves = len(candidates.start) - 1
    due, order = np.zeros(places, bool), np.zeros(places, np.int32)
    start, tried = np.zeros(moves + 1, np.int32), np.zeros((moves, strengths), np.float32)
    due, order, start, tried = jax.device_put((due, order, start, tried))
    return NextBatch(Work(candidates.first, order, start, tried, candidates.num_strengths), due)


def next_batch(
    progress: SearchProgress,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    room: Array,
    fine: int | Array,
    due: Bool[Array, "N"] | None = None,
) -> NextBatch:
    """Stale candidates, as far as there is room, or the next round of a local search.

    `due`, where it is known, is what is `pending`.
    """

    def look(progress: SearchProgress) -> tuple[Work, Array]:
        known = due
        if known is None:
            known = pending(state, candidates, progress.cache, progress.used, limits)
        return work_of(state, candidates, known, room)

    def move(progress: SearchProgress) -> tuple[Work, Array]:
        nothing = jnp.zeros_like(progress.cache.stale)
        return local_work(state, candidates, progress.local, fine), nothing

    return NextBatch(*lax.cond(progress.local.round < 0, look, move, progress))


@compiled
def step(
    progress: SearchProgress,
    batch: NextBatch,
    changes: tuple[Array, ...],
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    room: Array,
    left: Array,
    fine: int | Array,
) -> tuple[SearchProgress, NextBatch]:
    """What follows from candidates that were evaluated, in parts; and what to evaluate next.

    At most `left` evaluations are made, with those; of what comes next about `room` before the next
    look at the clock.
    """
    known_before, began = progress.cache.changes, progress.result.evaluations
    whole = changes[0]
    for part in changes[1:]:  # each part left the others' rows as they were
        whole = jnp.where(part == known_before, whole, part)
    cache = replace(progress.cache, changes=whole, stale=progress.cache.stale & ~batch.due)
    progress = replace(progress, cache=cache)
    looking = progress.local.round < 0
    spent = jnp.where(looking, batch.count(candidates), 0)

    def waiting(progress: SearchProgress) -> Array:
        return pending(state, candidates, progress.cache, progress.used, limits)

    due = lax.cond(looking, waiting, lambda s: jnp.zeros_like(s.cache.stale), progress)

    def looked(progress: SearchProgress) -> tuple[Local, Array]:
        """A local search begins when nothing is pending any more."""
        return lax.cond(due.any(), lambda s: (s.local, jnp.int32(0)), begun, progress)

    def begun(progress: SearchProgress) -> tuple[Local, Array]:
        cache = known(progress.cache)
        return begin_local(state, candidates, cache, progress.used, limits, fine, left=left - spent)

    def moved(progress: SearchProgress) -> tuple[Local, Array]:
        local = next_local(state, candidates, progress.local, whole, limits, fine)
        return local, jnp.int32(0)

    local, more = lax.cond(looking, looked, moved, progress)
    result = replace(progress.result, evaluations=began + spent + more)
    progress = replace(progress, result=result, local=local)
    decided = partial(_decided, state=state, candidates=candidates, limits=limits, fine=fine)
    ends = local.round == fine
    progress = lax.cond(ends, decided, lambda s: s, progress)
    due = lax.cond(ends, waiting, lambda _: due, progress)
    rest = jnp.maximum(jnp.minimum(room, left - spent) - more, 0)
    return progress, next_batch(progress, state, candidates, limits, rest, fine, due)


def _decided(
    progress: SearchProgress,
    state: SearchState,
    candidates: Candidates,
    limits: SearchLimits,
    fine: int | Array,
) -> SearchProgress:
    """The end, or the best action taken, or a carry if it gains more per action."""
    local, result = progress.local, progress.result
    best = jnp.argmax(local.gain)

    def one(progress: SearchProgress) -> SearchProgress:
        chosen = local.move[best], local.first[best], local.strength[best]
        return take(progress, state, candidates, *chosen)

    worth, act = local.gain[best] > 0, one
    if state.carries:
        left = jnp.asarray(limits.stock, jnp.float32) + progress.stocked
        where = state, progress.now, candidates, progress.cache, progress.used, left, limits
        pair = best_transfer(*where, fine)
        room = result.steps + pair.cost.astype(jnp.int32) <= limits.max_steps
        pays = room & (pair.gain > pair.cost * local.gain[best])
        worth |= pays

        def both(progress: SearchProgress) -> SearchProgress:
            for half, done in ((pair.take, pair.takes), (pair.bring, pair.brings)):
                progress = lax.cond(
                    done,
                    lambda c, h=half: take(c, state, candidates, h.move, h.first, h.strength),
                    lambda c: c,
                    progress,
                )
            return replace(progress, stocked=progress.stocked + pair.stock)

        def act(progress: SearchProgress) -> SearchProgress:
            return lax.cond(pays, both, one, progress)

    def judged(progress: SearchProgress, other: Array | int) -> SearchProgress:
        """With the status; `other` where the search has neither converged nor enough actions."""
        result = progress.result
        status = jnp.where(result.steps >= limits.max_steps, Status.MAX_STEPS, other)
        status = jnp.where(result.distance <= limits.tolerance, Status.CONVERGED, status)
        return replace(progress, result=replace(result, status=status.astype(jnp.int32)))

    progress = replace(progress, local=replace(local, round=jnp.int32(-1)))
    progress = judged(progress, jnp.where(worth, -1, Status.NO_IMPROVEMENT))
    # Judged at once, not when all candidates are known again: in a closed loop that is half of it.
    return lax.cond(progress.result.status < 0, lambda c: judged(act(c), -1), lambda c: c, progress)


def known(cache: CandidateCache) -> CandidateCache:
    """The cache with stale values set to 0."""
    return replace(cache, changes=jnp.where(cache.stale[:, None], 0.0, cache.changes))


@compiled
def take(
    progress: SearchProgress, state: SearchState, candidates: Candidates, move, first, strength
) -> SearchProgress:
    """Apply a move to the map and note it."""
    now = state.act(move, progress.now, first, strength)
    shape = jnp.asarray(state.shapes)[move]
    result, k = progress.result, progress.result.steps
    return replace(
        progress,
        now=now,
        cache=touch(progress.cache, candidates, state, first, shape, (progress.now, now)),
        used=progress.used.at[jnp.asarray(state.actions)[move]].add(1),
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
def last(
    progress: SearchProgress, state: SearchState, candidates: Candidates, limits: SearchLimits
) -> SearchResult:
    """One more action out of what is known, where it helps; then the budget is over."""
    if not state.moves:
        return replace(progress.result, status=jnp.int32(Status.BUDGET))
    cache = known(progress.cache)
    best, _ = begin_local(state, candidates, cache, progress.used, limits, 0, width=1)
    room = progress.result.steps < limits.max_steps
    progress = lax.cond(
        (best.gain[0] > 0) & room & (progress.result.distance > limits.tolerance),
        lambda s: take(s, state, candidates, best.move[0], best.first[0], best.strength[0]),
        lambda s: s,
        progress,
    )
    return replace(progress.result, status=jnp.int32(Status.BUDGET))
