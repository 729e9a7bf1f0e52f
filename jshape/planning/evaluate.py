"""Every move at every place with every strength, in compiled calls that read windows only.

A candidate is one move at one place with one strength.  Candidates are numbered move by move,
place by place, strength by strength, as Algorithm 1 visits them.  What is computed is by how much
each changes d, from its window alone.

Places and strengths lie in storage of a few sizes, with masks: another grid, another reachable
mask or other strengths compile nothing anew.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import PartitionSpec

from jshape import actions
from jshape._typing import Array, Bool, Float, Int
from jshape.models.bank import Bank
from jshape.planning.devices import Execution
from jshape.planning.state import SearchState

PLACES = 256, 16
"""Least storage for places, and how many times as large the next is."""
STRENGTHS = 8, 8
"""Likewise for strengths."""
MANY = 2048
"""Places from which on it pays to keep up what stale ones gain at most."""
SPARE = 108
"""Places left free at the end: a local search puts its own there."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Candidates:
    """The candidates of all moves, in padded storage: N places, S strengths."""

    first: Int[Array, "N 2"]
    """First node (v, u) of each place's window, move by move; fillers at the end."""
    move: Int[Array, "N"]
    """Number of each place's move."""
    start: Int[Array, "_"]
    """Where each move's places begin; last, where all end."""
    valid: Bool[Array, "N"]
    """Places at which a hand may be placed; False for fillers."""
    pixels: Int[Array, "N 2"]
    """The places as (u, v) pixels."""
    strengths: Float[Array, "S"]
    """How many times as deep as the trained action, weakest first; the last is repeated."""
    num_strengths: Int[Array, ""]
    """How many strengths there are."""
    reachable: Bool[Array, "R C"]
    """Nodes at which a hand may be placed."""
    low: Int[Array, "A 2"]
    """Least first node (v, u) of each move's places; 0 where it has none."""
    high: Int[Array, "A 2"]
    """Likewise the greatest."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Places of each move (host)."""
        mine = np.asarray(self.move)[np.asarray(self.valid)]
        return tuple(np.bincount(mine, minlength=len(self.start) - 1).tolist())

    def __len__(self) -> int:
        return int(np.count_nonzero(self.valid)) * int(self.num_strengths)

    def of_move(self, number: int, values: Array | None = None) -> np.ndarray:
        """One move's places: their rows of `first`, or of other values of all places (host)."""
        mine = np.asarray(self.valid) & (np.asarray(self.move) == number)
        return np.asarray(self.first if values is None else values)[mine]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CandidateCache:
    """What is known of the candidates."""

    changes: Float[Array, "N S"]
    """Change of d by each place and strength; 0 where not yet evaluated."""
    stale: Bool[Array, "N"]
    """Places whose values are not those of the map as it is."""
    most: Float[Array, "N"]
    """What a stale place gains at most."""


def candidates_at(
    state: SearchState,
    bank: Bank,
    positions: Mapping[str, np.ndarray],
    strengths: Sequence[float] = (1.0,),
    reachable: np.ndarray | None = None,
) -> Candidates:
    """Candidates at positions (N_a, 2) of (u, v) per action, already inside the image (host).

    On the height map a place is the nearest node: at most half its pitch away, 1 mm.

    Args:
      state: where.
      bank: whose actions.
      positions: per action; a turned hand, whose ROI is larger, leaves out those near the edge.
      strengths: to try.
      reachable: (H, W) pixels at which a hand may be placed; None: all.
    """
    shape = state.now.shape
    firsts, pixels, counts = [], [], [0]
    for move in state.moves:
        name = bank.actions[move.action]
        centres = positions.get(name, np.zeros((0, 2), np.int32))
        inside = actions.fits(bank.camera, centres, move.roi)  # a turned hand needs more room
        node = state.node(centres[inside][:, ::-1])
        firsts.append(np.clip(node - move.middle, 0, np.array(shape) - move.shape))
        pixels.append(centres[inside])
        counts.append(len(node))
    start = np.cumsum(counts, dtype=np.int32)
    room = _storage(int(start[-1]) + SPARE, *PLACES)

    def padded(rows: list[np.ndarray]) -> np.ndarray:
        whole = np.zeros((room, 2), np.int32)
        whole[: start[-1]] = np.concatenate([np.zeros((0, 2), np.int32), *rows])
        return whole

    move = np.zeros(room, np.int32)
    move[: start[-1]] = np.repeat(np.arange(len(state.moves)), counts[1:])
    usable = np.arange(room) < start[-1]
    nodes = np.ones(shape, bool)
    where = padded(pixels)
    if reachable is not None:
        usable &= reachable[where[:, 1], where[:, 0]]
        at = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 2)
        v, u = np.clip(np.rint(state.pixel(at)).astype(int), 0, np.array(reachable.shape) - 1).T
        nodes = reachable[v, u].reshape(shape)
    deep = np.pad(
        np.asarray(strengths, np.float32),
        (0, _storage(len(strengths), *STRENGTHS) - len(strengths)),
        mode="edge",
    )
    tried = np.int32(len(strengths))
    first = padded(firsts)
    bounds = np.zeros((2, len(state.moves), 2), np.int32)
    for number in range(len(state.moves)):
        mine = first[usable & (move == number)]
        if len(mine):
            bounds[:, number] = mine.min(0), mine.max(0)
    # All in one transfer: one by one they take as long as a small search.
    return Candidates(
        *jax.device_put((first, move, start, usable, where, deep, tried, nodes, *bounds))
    )


def _storage(count: int, least: int, times: int) -> int:
    """The storage that holds so many."""
    while least < count:
        least *= times
    return least


def empty_cache(candidates: Candidates) -> CandidateCache:
    """A cache on which nothing is known."""
    sizes = len(candidates.first), len(candidates.strengths)
    return CandidateCache(
        jnp.zeros(sizes, jnp.float32),
        jnp.asarray(candidates.valid),
        jnp.full(sizes[0], jnp.inf, jnp.float32),
    )


def first_cache(state: SearchState, candidates: Candidates, now: Array) -> CandidateCache:
    """A cache that knows of many places how far their windows are from the goal: none gains more.

    Of 100,000 candidates over a letter half are then never evaluated, since others gain more.
    """
    cache = empty_cache(candidates)
    if len(cache.most) < MANY:
        return cache
    shapes = jnp.asarray(state.shapes)[candidates.move]
    return replace(cache, most=state.most_left(now, candidates.first, shapes))


def touch(
    cache: CandidateCache,
    candidates: Candidates,
    state: SearchState,
    first: Array,
    shape: Array,
    maps: tuple[Array, Array] | None = None,
) -> CandidateCache:
    """The cache after the window at `first` of `shape` has changed: what overlaps it is stale.

    With the `maps` before and after, what the stale places gain at most is kept up, if the
    predictors allow that and there are enough places for it to save time.
    """
    shapes = jnp.asarray(state.shapes)[candidates.move]
    apart = (candidates.first >= (first + shape)[None]) | (first[None] >= candidates.first + shapes)
    touched = candidates.valid & ~apart.any(-1)
    most = jnp.full_like(cache.most, jnp.inf)
    if maps is not None and len(most) >= MANY:
        most = state.most_left(maps[1], candidates.first, shapes)
        if state.carry_over is not None:
            tried = jnp.arange(cache.changes.shape[1], dtype=jnp.int32) < candidates.num_strengths
            known = jnp.where(tried[None], -cache.changes, -jnp.inf).max(1)
            known = jnp.where(cache.stale, cache.most, known)
            more = state.most_gain(*maps, candidates.first, shapes)
            most = jnp.minimum(most, known + more)
    return replace(
        cache,
        stale=cache.stale | touched,
        most=jnp.where(touched, most, cache.most),
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Work:
    """What is to be evaluated: places of each move, with the strengths of each."""

    first: Int[Array, "N 2"]
    """First nodes of windows."""
    order: Int[Array, "N"]
    """Rows of `first` to be evaluated, move by move."""
    start: Int[Array, "_"]
    """Where each move's begin in `order`; last, where all end."""
    strengths: Float[Array, "A S"]
    """Per move."""
    count: Int[Array, ""]
    """How many of the strengths."""


def evaluate(
    state: SearchState,
    now: Float[Array, "R C"],
    work: Work,
    changes: Float[Array, "N S"],
    execution: Execution = Execution(),
    share: tuple[int | Array, int] = (0, 1),
) -> Float[Array, "N S"]:
    """`changes` with the rows of `work` computed anew; the others are neither read nor computed.

    Of `share` (k, n), only the k-th of n parts of each move's places is.

    A loop over moves and in it one over places: each step is a slice, on a CPU 2.5 times as fast as
    one gather over all places, and the loop's length is what there is to do.  On an accelerator the
    inner loop's steps are whole chunks of places and strengths, by `vmap`.
    """
    if execution.mesh is None:
        return _evaluate(state, now, work, changes, execution.nodes, share)
    axis, devices = execution.mesh.axis_names[0], execution.mesh.size

    def mine(state, now, work, changes):
        share = lax.axis_index(axis).astype(jnp.int32), devices
        new = _evaluate(state, now, work, jnp.zeros_like(changes), execution.nodes, share)
        new = lax.psum(new, axis)
        row = jnp.arange(len(changes), dtype=jnp.int32)
        done = jnp.zeros(len(changes), bool)
        done = done.at[jnp.where(row < work.start[-1], work.order, len(changes))].set(
            True, mode="drop"
        )
        return jnp.where(done[:, None], new, changes)

    whole = PartitionSpec()
    specs: dict[str, Any] = {"in_specs": (whole,) * 4, "out_specs": whole, "check_vma": False}
    return jax.shard_map(mine, mesh=execution.mesh, **specs)(state, now, work, changes)


def _evaluate(state, now, work, changes, nodes, share):
    rank, parts = share
    begins, counts = work.start[:-1], jnp.diff(work.start)
    begins, ends = begins + counts * rank // parts, begins + counts * (rank + 1) // parts
    way = partial(partial(_vmapped, nodes) if nodes else _in_a_row, state, now, work)

    def of_move(number, changes):
        operands = changes, begins[number], ends[number], work.strengths[number]
        return state.with_kernel(number, way, *operands)

    return lax.fori_loop(0, len(state.moves), of_move, changes)


def _in_a_row(state, now, work, kernel, effect, before, changes, begin, end, strengths):
    """Of one move place after place, or few together, strength after strength."""
    count = state.together(kernel)

    def some(g, changes):
        row = lax.dynamic_slice(work.order, (begin + g * count,), (count,))
        first = work.first[row] - before[None]
        shared = first, state.windows(kernel, now, first) if count > 1 else None

        def with_strength(s, changes):
            # Behind a barrier nothing that strengths share is computed for all of them
            # beforehand: to keep it takes longer than to compute it again.
            (first, windows), strength = lax.optimization_barrier((shared, strengths[s]))
            windows = state.windows(kernel, now, first) if windows is None else windows
            new = state.change(effect, windows, first, strength)
            if count == 1:
                return changes.at[row[0], s].set(new[0])
            done = jnp.minimum(end - begin - g * count, count)
            return lax.fori_loop(0, done, lambda k, c: c.at[row[k], s].set(new[k]), changes)

        return lax.fori_loop(0, work.count, with_strength, changes)

    return lax.fori_loop(0, -(-(end - begin) // count), some, changes)


def _vmapped(nodes, state, now, work, kernel, effect, before, changes, begin, end, strengths):
    """Of one move all places with all strengths, in chunks of about so many nodes."""
    chunk = min(max(nodes // math.prod(kernel.shape), 1), changes.size)
    candidates = (end - begin) * work.count

    def one(first, strength):
        windows = state.windows(kernel, now, first[None])
        return state.change(effect, windows, first[None], strength)[0]

    def some(g, changes):
        number = g * chunk + jnp.arange(chunk, dtype=jnp.int32)
        place, s = jnp.divmod(number, work.count)
        row = work.order[begin + place]
        new = jax.vmap(one)(work.first[row] - before[None], strengths[s])
        row = jnp.where(number < candidates, row, len(changes))
        return changes.at[row, s].set(new, mode="drop")

    return lax.fori_loop(0, -(-candidates // chunk), some, changes)


def work_of(
    state: SearchState,
    candidates: Candidates,
    due: Bool[Array, "N"],
    room: int | Array | None = None,
) -> tuple[Work, Bool[Array, "N"]]:
    """Places as work; and which of them.

    Args:
      state: the moves.
      candidates: where.
      due: the places.
      room: at most about this many candidates are evaluated, of each move in proportion; None is
        all.
    """
    moves, places = len(state.moves), len(candidates.first)
    number = jnp.arange(places, dtype=jnp.int32)
    if room is not None:
        before = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(due, dtype=jnp.int32)])
        until = before[candidates.start]  # due before each move's first
        waiting = until[-1]
        room, waiting, tried = (
            jnp.asarray(n, jnp.float32) for n in (room, waiting, candidates.num_strengths)
        )
        portion = jnp.minimum(room / tried, waiting) / jnp.maximum(waiting, 1.0)
        # Rounded up for the moves so far together: in all, by less than one place.
        most = jnp.diff(jnp.ceil(until.astype(jnp.float32) * portion)).astype(jnp.int32)
        due &= before[:-1] - until[candidates.move] < most[candidates.move]
    ends = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(due, dtype=jnp.int32)])
    order = jnp.zeros(places, jnp.int32)
    order = order.at[jnp.where(due, ends[:-1], places)].set(number, mode="drop")
    strengths = jnp.broadcast_to(candidates.strengths, (moves, len(candidates.strengths)))
    return Work(
        candidates.first, order, ends[candidates.start], strengths, candidates.num_strengths
    ), due


def refresh(
    state: SearchState,
    now: Float[Array, "R C"],
    candidates: Candidates,
    cache: CandidateCache,
    room: int | Array | None = None,
    execution: Execution = Execution(),
) -> tuple[CandidateCache, Int[Array, ""]]:
    """The cache with stale candidates computed anew.  See `work_of`.

    Returns:
      The cache, in which places for which there was no room are still stale, and the evaluations.
    """
    work, due = work_of(state, candidates, cache.stale, room)
    changes = evaluate(state, now, work, cache.changes, execution)
    spent = work.start[-1] * candidates.num_strengths
    return replace(cache, changes=changes, stale=cache.stale & ~due), spent


@jax.jit(static_argnames=["execution"])
def _sweep(state: SearchState, candidates: Candidates, execution: Execution) -> Float[Array, "N S"]:
    fresh = empty_cache(candidates)
    return refresh(state, state.now, candidates, fresh, execution=execution)[0].changes


def sweep(
    state: SearchState, candidates: Candidates, execution: Execution = Execution()
) -> tuple[Array, ...]:
    """Change of d by every candidate: per move (N, S), negative where the goal comes nearer."""
    if not state.moves:
        return ()
    changes = _sweep(state, candidates, execution)[:, : int(candidates.num_strengths)]
    start = np.asarray(candidates.start)
    return tuple(changes[a:b] for a, b in zip(start[:-1], start[1:], strict=True))
