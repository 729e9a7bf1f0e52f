"""Every move at every place with every strength, in compiled calls that read windows only.

A candidate is one move at one place with one strength.  Candidates are numbered move by move,
place by place, strength by strength, as Algorithm 1 visits them.  What is computed is by how much
each changes d, from its window alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from jshape import actions
from jshape._typing import Array, Bool, Float, Int
from jshape.models.bank import Bank
from jshape.planning.state import Terrain


@dataclass(frozen=True)
class How:
    """How candidates are evaluated (static).  Changes no result, only memory and time."""

    chunk: int = 1
    """Places evaluated together.  1 is best on a CPU, some hundreds on a GPU."""
    mesh: Mesh | None = None
    """Devices that share the places; None is one."""


ONE_BY_ONE = How()
"""One device, one place after the other."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Candidates:
    """M = S · sum of N_m candidates: first nodes (v, u) of their windows per move, strengths."""

    first: tuple[Int[Array, "_ 2"], ...]
    """Per move of the terrain: first node of the window at each of its places."""
    strengths: Float[Array, "S"]
    """How many times as deep as the trained action."""
    pixels: tuple[Int[Array, "_ 2"], ...]
    """Per move: the places as (u, v) pixels."""
    reach: Bool[Array, "R C"] | None = None
    """Nodes at which a hand may be placed; None: all."""

    @property
    def counts(self) -> tuple[int, ...]:
        """N_m per move."""
        return tuple(len(first) for first in self.first)

    def __len__(self) -> int:
        return sum(self.counts) * len(self.strengths)

    def locate(self, index: int) -> tuple[int, int, int]:
        """(move number, place number, strength number) of a candidate (host)."""
        place, strength = divmod(index, len(self.strengths))
        for number, count in enumerate(self.counts):
            if place < count:
                return number, place, strength
            place -= count
        raise IndexError(index)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Board:
    """What is known of the candidates."""

    changes: tuple[Float[Array, "_ S"], ...]
    """Per move: change of d by each place and strength; 0 where not yet evaluated."""
    stale: tuple[Bool[Array, "_"], ...]
    """Per move: places whose values are not those of the map as it is."""


def candidates_at(
    terrain: Terrain,
    bank: Bank,
    positions: Mapping[str, np.ndarray],
    strengths: Sequence[float] = (1.0,),
    reach: np.ndarray | None = None,
) -> Candidates:
    """Candidates at positions (N_a, 2) of (u, v) per action, already inside the image (host).

    On the ground a place is the nearest node: at most half its pitch away, 1 mm.

    Args:
      terrain: where.
      bank: whose actions.
      positions: per action; a turned hand, whose ROI is larger, leaves out those near the edge.
      strengths: to try.
      reach: (H, W) pixels at which a hand may be placed; None: all.
    """
    firsts, pixels = [], []
    for move in terrain.moves:
        name = bank.actions[move.action]
        centres = positions.get(name, np.zeros((0, 2), np.int32))
        inside = actions.fits(bank.camera, centres, move.roi)  # a turned hand needs more room
        node = terrain.node(centres[inside][:, ::-1])
        rows, columns = terrain.now.shape
        room = np.array([rows, columns]) - move.shape
        firsts.append(np.clip(node - move.middle, 0, room).astype(np.int32))
        pixels.append(centres[inside].astype(np.int32))
    if reach is not None:
        at = np.moveaxis(np.indices(terrain.now.shape), 0, -1).reshape(-1, 2)
        v, u = np.clip(np.rint(terrain.pixel(at)).astype(int), 0, np.array(reach.shape) - 1).T
        reach = reach[v, u].reshape(terrain.now.shape)
    # All in one transfer: one by one they take as long as a small search.
    arrays = tuple(firsts), np.asarray(strengths, np.float32), tuple(pixels), reach
    return Candidates(*jax.device_put(arrays))


def fresh_board(candidates: Candidates) -> Board:
    """A board on which nothing is known."""
    count = len(candidates.strengths)
    return Board(
        tuple(jnp.zeros((n, count), jnp.float32) for n in candidates.counts),
        tuple(jnp.ones(n, dtype=bool) for n in candidates.counts),
    )


def touch(
    board: Board, candidates: Candidates, terrain: Terrain, first: Array, shape: Array
) -> Board:
    """The board after the window at `first` of `shape` has changed: what overlaps it is stale."""
    stale = []
    for move, firsts, old in zip(terrain.moves, candidates.first, board.stale, strict=True):
        apart = (firsts >= first + shape) | (first >= firsts + jnp.array(move.shape, jnp.int32))
        stale.append(old | ~apart.any(-1))
    return replace(board, stale=tuple(stale))


def refresh(
    terrain: Terrain,
    now: Float[Array, "R C"],
    candidates: Candidates,
    board: Board,
    room: int | Array | None = None,
    how: How = ONE_BY_ONE,
) -> tuple[Board, Int[Array, ""]]:
    """The board with stale candidates computed anew; the others are neither read nor computed.

    Args:
      terrain: the moves and the map wanted.
      now: the map as it is.
      candidates: where.
      board: what is known.
      room: at most about this many candidates are evaluated, of each move in proportion; None is
        all.
      how: memory and devices.

    Returns:
      The board, in which places for which there was no room are still stale, and the evaluations.
    """
    per_place = len(candidates.strengths)
    waiting = sum(_count(stale) for stale in board.stale)
    places = waiting if room is None else jnp.minimum(room / per_place, waiting)
    portion = places / jnp.maximum(waiting, 1)
    changes, stale, spent, before = [], [], jnp.int32(0), jnp.int32(0)
    for number, first in enumerate(candidates.first):
        old, old_stale = board.changes[number], board.stale[number]
        count = first.shape[0]
        if count:
            # Rounded up for the moves so far together: in all, by less than one place.
            earlier, before = before, before + _count(old_stale)
            most = jnp.ceil(before * portion) - jnp.ceil(earlier * portion)
            most = jnp.clip(most, 0, count).astype(jnp.int32)
            work = partial(_refresh_move, number, how.chunk)
            if how.mesh is not None:
                work = _shared(work, how.mesh)
                most = -(-most // how.mesh.size)
            old, left = work(terrain, now, first, candidates.strengths, old, old_stale, most)
            spent += _count(old_stale & ~left) * per_place
            old_stale = left
        changes.append(old)
        stale.append(old_stale)
    return Board(tuple(changes), tuple(stale)), spent


def _count(stale: Bool[Array, "N"]) -> Int[Array, ""]:
    return stale.sum(dtype=jnp.int32)


def _refresh_move(number, chunk, terrain, now, first, strengths, changes, stale, most):
    """One move: a loop over its stale places.

    With a static window and `chunk` 1 each step is a slice, on a CPU 2.5 times as fast as one
    gather over all places, and the loop's length is the number of stale places.
    """
    move, count = terrain.moves[number], first.shape[0]
    rank = jnp.cumsum(stale, dtype=jnp.int32) - 1
    most = jnp.minimum(_count(stale), most)
    order = jnp.zeros(count + chunk, jnp.int32)  # stale places first, in their own order
    numbers = jnp.arange(count, dtype=jnp.int32)
    order = order.at[jnp.where(stale, rank, count + chunk)].set(numbers, mode="drop")

    def one(first):
        return terrain.change(move, now, first, strengths)

    def evaluate(i, values):
        if chunk == 1:
            return values.at[order[i]].set(one(first[order[i]]))
        mine = lax.dynamic_slice_in_dim(order, i * chunk, chunk)
        valid = i * chunk + jnp.arange(chunk, dtype=jnp.int32) < most
        return values.at[jnp.where(valid, mine, count)].set(jax.vmap(one)(first[mine]), mode="drop")

    changes = lax.fori_loop(0, -(-most // chunk), evaluate, changes)
    return changes, stale & (rank >= most)


def _shared(work, mesh: Mesh):
    """`work` with the places split over the devices of a mesh (of one axis)."""
    whole, split = PartitionSpec(), PartitionSpec(mesh.axis_names[0])

    def padded(terrain, now, first, strengths, changes, stale, most):
        count = first.shape[0]
        extra = -count % mesh.size
        first, changes, stale = (
            jnp.pad(a, [(0, extra)] + [(0, 0)] * (a.ndim - 1)) for a in (first, changes, stale)
        )
        changes, stale = jax.shard_map(
            work,
            mesh=mesh,
            in_specs=(whole, whole, split, whole, split, split, whole),
            out_specs=(split, split),
            check_vma=False,
        )(terrain, now, first, strengths, changes, stale, most)
        return changes[:count], stale[:count]

    return padded


@jax.jit(static_argnames=["how"])
def sweep(terrain: Terrain, candidates: Candidates, how: How = ONE_BY_ONE) -> tuple[Array, ...]:
    """Change of d by every candidate: per move (N, S), negative where the goal comes nearer."""
    board, _ = refresh(terrain, terrain.now, candidates, fresh_board(candidates), how=how)
    return board.changes
