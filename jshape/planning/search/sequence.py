"""A whole sequence carried out on the terrain, at places between nodes too: differentiable."""

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Float
from jshape.planning.evaluate import Candidates
from jshape.planning.search.base import Found, Task, compiled, nothing
from jshape.planning.search.local import bounds
from jshape.planning.state import Kernel, Terrain


def act_between(
    terrain: Terrain,
    kernel: Kernel,
    effect: Any,
    now: Array,
    node: Float[Array, "2"],
    strength: Array,
) -> Float[Array, "R C"]:
    """The map after a move whose place is `node` (v, u), on nodes or between them.

    The bed as seen from the exact place, by bilinear shift, and the change put back the same way;
    on a node that is `Terrain.act`.
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
    change = terrain.seen(effect(seen, base, strength)) - seen
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


def carry_out(terrain: Terrain, found: Found) -> tuple[Array, Array]:
    """The map after a sequence (R, C), and d before and after each of its K entries (K+1,)."""

    def one(now, entry):
        move, node, strength = entry

        def act(now):
            between = partial(act_between, terrain)
            return terrain.with_kernel(move, between, now, node, strength)

        now = lax.cond(move >= 0, act, lambda now: now, now)
        return now, terrain.distance_of(now)

    now, distances = lax.scan(one, terrain.now, (found.move, found.node, found.strength))
    return now, jnp.concatenate([terrain.distance[None], distances])


@compiled
def measured(terrain: Terrain, found: Found) -> tuple[Found, Array, Array]:
    """A sequence with its distance, the map after it, and d before and after each entry."""
    now, distances = carry_out(terrain, found)
    return replace(found, distance=distances[-1]), now, distances


def begun(task: Task) -> Found | None:
    """The sequence to begin with, measured; None if there is none, or no budget for it (host).

    Its places and strengths are moved into the candidates' bounds.  Left out is what is farther
    from them than a place may be from its node, out of reach, used too often, or one too many.
    """
    if task.start is None or task.budget.over:
        return None
    terrain, candidates, start = task.terrain, task.candidates, jax.device_get(task.start)
    low, high = jax.device_get(least_and_most(terrain, candidates))
    open_moves = set(np.asarray(candidates.move)[np.asarray(candidates.open)].tolist())
    known, most = np.asarray(candidates.strengths), np.asarray(task.limits.most)
    moves, nodes, strengths, used = [], [], [], Counter()
    for move, node, strength in zip(start.move, start.node, start.strength, strict=True):
        if int(move) not in open_moves or len(moves) == task.max_steps:
            continue
        inside = np.clip(node, low[move], high[move])
        row, column = np.rint(inside).astype(int)
        free = bool(candidates.reach[row, column])
        action = terrain.moves[move].action
        allowed = used[action] < (most[action] if most.ndim else most)
        if np.abs(inside - node).max() < 0.51 and free and allowed:
            used[action] += 1
            moves.append(move)
            nodes.append(inside)
            strengths.append(np.clip(strength, known.min(), known.max()))
    found, steps = nothing(terrain, task.max_steps), len(moves)
    if steps:
        found = replace(
            found,
            steps=jnp.int32(steps),
            move=found.move.at[:steps].set(np.array(moves, np.int32)),
            node=found.node.at[:steps].set(np.array(nodes, np.float32)),
            strength=found.strength.at[:steps].set(np.array(strengths, np.float32)),
        )
    task.budget.spend(steps)
    return task.budget.call(measured, terrain, found)[0]


def without(found: Found, k: int | Array) -> Found:
    """A sequence without its k-th action."""
    order = jnp.arange(found.move.shape[0])
    source = jnp.where(order < k, order, order + 1)

    def closed(entries, filler):
        padded = jnp.concatenate([entries, jnp.full_like(entries[:1], filler)])
        return padded[jnp.minimum(source, entries.shape[0])]

    return replace(
        found,
        steps=found.steps - 1,
        move=closed(found.move, -1),
        node=closed(found.node, 0),
        strength=closed(found.strength, 0),
    )


def least_and_most(terrain: Terrain, candidates: Candidates) -> tuple[Array, Array]:
    """Least and greatest place (v, u) of each move's candidates, (moves, 2) each."""
    middle = jnp.asarray(terrain.shapes // 2)
    low, high = bounds(terrain, candidates)
    return (low + middle).astype(jnp.float32), (high + middle).astype(jnp.float32)
