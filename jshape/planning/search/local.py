"""Coarse to fine: the best candidates moved and weakened or deepened by ever smaller steps."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Bool, Float, Int
from jshape.planning.evaluate import SPARE, CandidateCache, Candidates, Work
from jshape.planning.search.base import UNLIMITED, SearchLimits
from jshape.planning.state import SearchState

WIDTH = 3
"""How many moves' best candidates greedy improves."""

AROUND = np.array([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)], np.int32)
"""The place and its eight neighbours."""

DEEPER = np.array([0.0, -0.5, 0.5], np.float32)
"""The strength and its two neighbours, in units of their distance."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Local:
    """A local search in progress: `E` entries, one of each move."""

    round: Int[Array, ""]
    """Rounds done; -1: there is none in progress."""
    move: Int[Array, "E"]
    first: Int[Array, "E 2"]
    """First nodes of their windows."""
    strength: Float[Array, "E"]
    gain: Float[Array, "E"]
    """By how much d falls, best first as they began; 0 where not worth it."""
    worth: Bool[Array, "E"]
    """Entries that are improved."""


def no_local(state: SearchState, width: int = WIDTH) -> Local:
    """None in progress."""
    count = min(width, len(state.moves))
    return Local(
        round=jnp.int32(-1),
        move=jnp.zeros(count, jnp.int32),
        first=jnp.zeros((count, 2), jnp.int32),
        strength=jnp.zeros(count, jnp.float32),
        gain=jnp.zeros(count, jnp.float32),
        worth=jnp.zeros(count, bool),
    )


def begin_local(
    state: SearchState,
    candidates: Candidates,
    cache: CandidateCache,
    used: Int[Array, "A"],
    limits: SearchLimits,
    rounds: int | Array,
    width: int = WIDTH,
    left: int | Array = UNLIMITED,
) -> tuple[Local, Int[Array, ""]]:
    """The best known candidate of each of the best `width` moves; of equals the first.

    No more than `left` evaluations are made: what they do not suffice for stays as it is.

    Returns:
      The entries, and how many evaluations all rounds of them take.
    """
    gains, _ = _worth(state, candidates, cache, used, limits)
    deepest, gain = jnp.argmax(gains, 1), gains.max(1)

    def next_best(gain, _):
        row = jnp.argmax(gain)
        move = candidates.move[row]
        entry = move, candidates.first[row], candidates.strengths[deepest[row]], gain[row]
        return jnp.where(candidates.move == move, -1.0, gain), entry

    count = min(width, len(state.moves))
    _, (move, first, strength, gain) = lax.scan(next_best, gain, length=count)
    gain = jnp.maximum(gain, 0.0)
    rounds = jnp.asarray(rounds, jnp.int32)
    each = len(AROUND) * _strengths(candidates) * rounds
    worth = (gain > 0) & (each * jnp.arange(1, count + 1, dtype=jnp.int32) <= left) & (rounds > 0)
    began = jnp.where(worth.any(), 0, rounds)
    return Local(began, move, first, strength, gain, worth), worth.sum(dtype=jnp.int32) * each


def _worth(
    state: SearchState,
    candidates: Candidates,
    cache: CandidateCache,
    used: Int[Array, "A"],
    limits: SearchLimits,
) -> tuple[Float[Array, "N S"], Float[Array, "N"]]:
    """Known gains, 0 where not worth it; and what each place must gain at least."""
    actions = jnp.asarray(state.actions)[candidates.move]
    needed = limits.needed(actions, candidates.strengths)
    allowed = candidates.valid & limits.allowed(actions, used)
    worth = (-cache.changes > needed) & allowed[:, None]
    return jnp.where(worth, -cache.changes, 0.0), jnp.where(allowed, needed.min(1), jnp.inf)


def pending(
    state: SearchState,
    candidates: Candidates,
    cache: CandidateCache,
    used: Int[Array, "A"],
    limits: SearchLimits,
    width: int = WIDTH,
) -> Bool[Array, "N"]:
    """Stale places that may hold the best candidate of one of the best `width` moves.

    Those come first that may gain the most: once they are known, few others remain.
    """
    gains, needed = _worth(state, candidates, cache, used, limits)
    gain = jnp.where(cache.stale, 0.0, gains.max(1))

    def next_best(gain, _):
        row = jnp.argmax(gain)
        return jnp.where(candidates.move == candidates.move[row], 0.0, gain), gain[row]

    _, best = lax.scan(next_best, gain, length=min(width, len(state.moves)))
    due = cache.stale & (cache.most > needed) & (cache.most >= best[-1])
    due &= cache.most >= jnp.where(due, cache.most, 0.0).max() / 2
    # One half of a carry need not gain anything.
    return due | (cache.stale & _in_carries(state, candidates)) if state.carries else due


def _in_carries(state: SearchState, candidates: Candidates) -> Bool[Array, "N"]:
    """Places of actions that are tried in pairs."""
    actions = sorted({action for pair in state.carries for action in pair})
    mine = np.isin(state.actions, np.array(actions, np.int32))
    return candidates.valid & jnp.asarray(mine)[candidates.move]


def local_work(
    state: SearchState, candidates: Candidates, local: Local, rounds: int | Array
) -> Work:
    """What the next round evaluates, in the candidates' spare rows.

    Every round tries the 3 x 3 places around with 3 strengths, at steps of half the size of the
    round before: places from 2^(rounds-1) nodes down to one, strengths from half of the distance
    between the candidates' own, inside their range.  The candidates' own boundaries are kept;
    where there is one strength it stays.
    """
    around, trial = _trials(candidates, local, rounds)
    places, tried = len(candidates.first), len(AROUND) * len(local.move)
    assert tried <= SPARE
    moves = jnp.arange(len(state.moves) + 1, dtype=jnp.int32)
    mine = jnp.where(local.worth, local.move, len(state.moves))
    start = (mine[None] < moves[:, None]).sum(1, dtype=jnp.int32) * len(AROUND)
    rows = jnp.arange(tried, dtype=jnp.int32).reshape(-1, len(AROUND)) + (places - tried)
    order = jnp.zeros(places, jnp.int32).at[:tried].set(rows[jnp.argsort(mine)].reshape(-1))
    strengths = jnp.zeros((len(state.moves), len(candidates.strengths)), jnp.float32)
    return Work(
        first=candidates.first.at[-tried:].set(around.reshape(-1, 2)),
        order=order,
        start=start,
        strengths=strengths.at[local.move, : len(DEEPER)].set(trial),
        count=_strengths(candidates),
    )


def next_local(
    state: SearchState,
    candidates: Candidates,
    local: Local,
    changes: Float[Array, "N S"],
    limits: SearchLimits,
    rounds: int | Array,
) -> Local:
    """The entries after a round whose work was evaluated."""
    around, trial = _trials(candidates, local, rounds)
    count, tried = len(local.move), len(AROUND) * len(local.move)
    change = changes[-tried:, : len(DEEPER)].reshape(count, len(AROUND), len(DEEPER))
    needed = limits.needed(jnp.asarray(state.actions)[local.move], trial)
    gains = jnp.where(-change > needed[:, None], -change, 0.0)
    row, column = jnp.moveaxis(around + (jnp.asarray(state.shapes) // 2)[local.move][:, None], 2, 0)
    made = jnp.arange(len(DEEPER), dtype=jnp.int32) < _strengths(candidates)
    gains = jnp.where(candidates.reachable[row, column][..., None] & made[None, None], gains, 0.0)
    best = jnp.argmax(gains.reshape(count, -1), 1).astype(jnp.int32)
    place, deeper = jnp.divmod(best, jnp.int32(len(DEEPER)))
    entry = jnp.arange(count, dtype=jnp.int32)
    gain = gains[entry, place, deeper]
    better = local.worth & (gain > local.gain)
    return replace(
        local,
        round=local.round + 1,
        first=jnp.where(better[:, None], around[entry, place], local.first),
        strength=jnp.where(better, trial[entry, deeper], local.strength),
        gain=jnp.where(better, gain, local.gain),
    )


def _strengths(candidates: Candidates) -> Int[Array, ""]:
    """How many strengths a round tries."""
    return jnp.where(candidates.num_strengths > 1, len(DEEPER), 1).astype(jnp.int32)


def _trials(
    candidates: Candidates, local: Local, rounds: int | Array
) -> tuple[Int[Array, "E P 2"], Float[Array, "E D"]]:
    """First nodes of the places, and the strengths, that a round tries."""
    coarser = jnp.maximum(jnp.asarray(rounds, jnp.int32) - 1 - local.round, 0)
    step = jnp.left_shift(jnp.int32(1), coarser)
    around = local.first[:, None] + jnp.asarray(AROUND[None], jnp.int32) * step
    low, high = (bound[local.move][:, None] for bound in (candidates.low, candidates.high))
    around = jnp.clip(around, low, high)
    known = candidates.strengths
    spacing = (known.max() - known.min()) / jnp.maximum(candidates.num_strengths - 1, 1).astype(
        known.dtype
    )
    trial = local.strength[:, None] + jnp.asarray(DEEPER[None], jnp.float32) * spacing / (
        jnp.float32(2.0) ** local.round.astype(jnp.float32)
    )
    return around, jnp.clip(trial, known.min(), known.max())
