"""A whole sequence carried out on the map, at places between nodes too: differentiable."""

from collections import Counter
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Float
from jshape.planning.evaluate import Candidates
from jshape.planning.kernels import Kernel
from jshape.planning.search.base import SearchProblem, SearchResult, compiled, empty_result
from jshape.planning.state import SearchState


def act_between(
    state: SearchState,
    kernel: Kernel,
    effect: Any,
    now: Array,
    node: Float[Array, "2"],
    strength: Array,
) -> Float[Array, "R C"]:
    """The map after a move whose place is `node` (v, u), on nodes or between them.

    The bed as seen from the exact place, by bilinear shift, and the change put back the same way;
    on a node that is `SearchState.act`.
    """
    rows, columns = shape = kernel.shape
    room = jnp.array(now.shape, jnp.int32) - jnp.array(shape, jnp.int32)
    middle = jnp.array([rows // 2, columns // 2], jnp.float32)
    first = jnp.clip(node - middle, 0.0, room.astype(jnp.float32))
    # At the map's end from the last node but one, with a share of 1.
    base = jnp.floor(lax.stop_gradient(first)).astype(jnp.int32)
    base = jnp.clip(base, 0, jnp.maximum(room - 1, 0))
    down, right = first - base.astype(first.dtype)
    whole = now
    if rows == now.shape[0] or columns == now.shape[1]:  # a window as large as the map
        whole = jnp.pad(now, ((0, 1), (0, 1)), mode="edge")
    larger = lax.dynamic_slice(whole, base, (rows + 1, columns + 1))
    seen = _between(_between(larger, down, 0), right, 1)
    change = state.seen(effect(seen, base[::-1], strength)) - seen
    for share, axis in ((down, 0), (right, 1)):
        before, behind = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], behind[axis] = (0, 1), (1, 0)
        change = (1 - share) * jnp.pad(change, before) + share * jnp.pad(change, behind)
    after = lax.dynamic_update_slice(whole, larger + change, base)
    return after[: now.shape[0], : now.shape[1]]


def _between(window: Array, share: Array, axis: int) -> Array:
    """Between the nodes of one axis: one node less."""
    low = lax.slice_in_dim(window, 0, window.shape[axis] - 1, axis=axis)
    high = lax.slice_in_dim(window, 1, window.shape[axis], axis=axis)
    return (1 - share) * low + share * high


def carry_out(state: SearchState, result: SearchResult) -> tuple[Array, Array]:
    """The map after a sequence (R, C), and d before and after each of its K entries (K+1,)."""

    def one(now, entry):
        move, node, strength = entry

        def act(now):
            def between(kernel, effect, _, now, node, strength):
                return act_between(state, kernel, effect, now, node, strength)

            return state.with_kernel(move, between, now, node, strength, apply=True)

        now = lax.cond(move >= 0, act, lambda now: now, now)
        return now, state.distance_of(now)

    now, distances = lax.scan(one, state.now, (result.move, result.node, result.strength))
    return now, jnp.concatenate([state.distance[None], distances])


@compiled
def measured(state: SearchState, result: SearchResult) -> tuple[SearchResult, Array, Array]:
    """A sequence with its distance, the map after it, and d before and after each entry."""
    now, distances = carry_out(state, result)
    return replace(result, distance=distances[-1]), now, distances


def warm_start(problem: SearchProblem) -> SearchResult | None:
    """The sequence to begin with, measured; None if there is none, or no budget for it (host).

    Its places and strengths are moved into the candidates' bounds.  Left out is what is farther
    from them than a place may be from its node, out of reach, used too often, or one too many.
    """
    if problem.start is None or problem.budget.over:
        return None
    state, candidates, start = problem.state, problem.candidates, jax.device_get(problem.start)
    low, high = jax.device_get(least_and_most(state, candidates))
    open_moves = set(np.asarray(candidates.move)[np.asarray(candidates.valid)].tolist())
    known, most = np.asarray(candidates.strengths), np.asarray(problem.limits.max_uses)
    moves, nodes, strengths, used = [], [], [], Counter()
    for move, node, strength in zip(start.move, start.node, start.strength, strict=True):
        if int(move) not in open_moves or len(moves) == problem.max_steps:
            continue
        inside = np.clip(node, low[move], high[move])
        row, column = np.rint(inside).astype(int)
        free = bool(candidates.reachable[row, column])
        action = state.moves[move].action
        allowed = used[action] < (most[action] if most.ndim else most)
        if np.abs(inside - node).max() < 0.51 and free and allowed:
            used[action] += 1
            moves.append(move)
            nodes.append(inside)
            strengths.append(np.clip(strength, known.min(), known.max()))
    result, steps = empty_result(state, problem.max_steps), len(moves)
    if steps:
        result = replace(
            result,
            steps=jnp.int32(steps),
            move=result.move.at[:steps].set(np.array(moves, np.int32)),
            node=result.node.at[:steps].set(np.array(nodes, np.float32)),
            strength=result.strength.at[:steps].set(np.array(strengths, np.float32)),
        )
    problem.budget.spend(steps)
    return problem.budget.call(measured, state, result)[0]


def without(result: SearchResult, k: int | Array) -> SearchResult:
    """A sequence without its k-th action."""
    order = jnp.arange(result.move.shape[0])
    source = jnp.where(order < k, order, order + 1)

    def closed(entries, filler):
        padded = jnp.concatenate([entries, jnp.full_like(entries[:1], filler)])
        return padded[jnp.minimum(source, entries.shape[0])]

    return replace(
        result,
        steps=result.steps - 1,
        move=closed(result.move, -1),
        node=closed(result.node, 0),
        strength=closed(result.strength, 0),
    )


def least_and_most(state: SearchState, candidates: Candidates) -> tuple[Array, Array]:
    """Least and greatest place (v, u) of each move's candidates, (moves, 2) each."""
    middle = jnp.asarray(state.shapes // 2)
    low, high = candidates.low, candidates.high
    return (low + middle).astype(jnp.float32), (high + middle).astype(jnp.float32)
