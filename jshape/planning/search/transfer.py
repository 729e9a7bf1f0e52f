"""Carries: material taken out at one place and brought to another, as one candidate.

Neither action need bring the goal nearer by itself: a scoop from level material does not until it
is poured.  Windows that do not overlap change d independently, so that the tables of single actions
propose both places; the pairs proposed are then predicted one after the other, and the material
that is brought is what was taken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.planning.evaluate import CandidateCache, Candidates
from jshape.planning.search.base import SearchLimits
from jshape.planning.search.local import AROUND
from jshape.planning.state import SearchState

APART = 2
"""Places to bring the material to, of each strength: the best by the tables, and the best whose
window does not overlap the one taken from."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Half:
    """One of a carry's two actions."""

    move: Int[Array, "*B"]
    first: Int[Array, "*B 2"]
    """First node of its window."""
    strength: Float[Array, "*B"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transfer:
    """A carry, and by how much d falls when both are done; 0 if it is not worth it."""

    take: Half
    bring: Half
    gain: Float[Array, "*B"]


def best_transfer(
    state: SearchState,
    now: Float[Array, "R C"],
    candidates: Candidates,
    cache: CandidateCache,
    limits: SearchLimits,
    rounds: int | Array,
) -> Transfer:
    """The carry that gains most, of those that the tables of single actions propose.

    One for each strength with which material is taken; the best of them is then moved, first
    where it is brought and then where it is taken, by ever smaller steps as in a local search.
    """
    best = [_of_pair(state, now, candidates, cache, limits, pair, rounds) for pair in state.carries]
    return _best(jax.tree.map(lambda *one: jnp.stack(one), *best))


def _of_pair(state, now, candidates, cache, limits, pair, rounds) -> Transfer:
    action = jnp.asarray(state.actions)[candidates.move]
    takes, brings = (candidates.valid & (action == one) for one in pair)
    known = ~cache.stale
    gains = -cache.changes
    shapes = jnp.asarray(state.shapes)[candidates.move]

    def row_of(number: Array) -> tuple[Array, Array]:
        return candidates.move[number], candidates.first[number]

    def with_strength(s: Array) -> Transfer:
        row = jnp.argmax(jnp.where(takes & known, gains[:, s], -jnp.inf))
        take = Half(*row_of(row), candidates.strengths[s])
        after = state.act(take.move, now, take.first, take.strength)
        # A first guess of the strength, from what the trained action brings.
        middle = jnp.argmax(brings)
        guess = _strength_of(state, now, after, Half(*row_of(middle), jnp.float32(1.0)))
        worth = jnp.where(brings & known, _interpolated(candidates, gains, guess), -jnp.inf)
        apart = (candidates.first >= (take.first + shapes[row])[None]) | (
            take.first[None] >= candidates.first + shapes
        )
        rows = [worth, jnp.where(apart.any(-1), worth, -jnp.inf)]

        def to(rank: Array) -> Transfer:
            place = Half(*row_of(jnp.argmax(jnp.stack(rows)[rank])), guess)
            return _predicted(state, now, after, take, place, candidates, limits)

        return _best(lax.map(to, jnp.arange(APART, dtype=jnp.int32)))

    count = candidates.num_strengths

    def tried(s: Array, best: Transfer) -> Transfer:
        one = with_strength(s)
        return jax.tree.map(lambda a, b: jnp.where(one.gain > best.gain, a, b), one, best)

    possible = (takes & known).any() & (brings & known).any()
    nothing = Half(jnp.int32(0), jnp.zeros(2, jnp.int32), jnp.float32(1.0))
    none = Transfer(nothing, nothing, jnp.float32(0.0))
    found = lax.fori_loop(0, jnp.where(possible, count, 0), tried, none)
    return lax.cond(
        (found.gain > 0) & (jnp.asarray(rounds) > 0),
        lambda one: _moved(state, now, candidates, limits, one, rounds),
        lambda one: one,
        found,
    )


def _moved(state, now, candidates, limits, found: Transfer, rounds) -> Transfer:
    """A carry whose places were moved, as far as that gains."""

    def one_round(r: Array, best: Transfer) -> Transfer:
        step = jnp.left_shift(jnp.int32(1), jnp.maximum(jnp.asarray(rounds, jnp.int32) - 1 - r, 0))
        around = jnp.asarray(AROUND, jnp.int32) * step

        def at(half: Half, by: Array) -> Half:
            low, high = candidates.low[half.move], candidates.high[half.move]
            first = jnp.clip(half.first + by, low, high)
            node = first + (jnp.asarray(state.shapes) // 2)[half.move]
            free = candidates.reachable[node[0], node[1]]
            return replace(half, first=jnp.where(free, first, half.first))

        after = state.act(best.take.move, now, best.take.first, best.take.strength)

        def brought(by: Array) -> Transfer:
            place = at(best.bring, by)
            return _predicted(state, now, after, best.take, place, candidates, limits)

        best = _best(lax.map(brought, around))

        def taken(by: Array) -> Transfer:
            take = at(best.take, by)
            after = state.act(take.move, now, take.first, take.strength)
            return _predicted(state, now, after, take, best.bring, candidates, limits)

        return _best(lax.map(taken, around))

    return lax.fori_loop(0, jnp.asarray(rounds, jnp.int32), one_round, found)


def _predicted(state, now, after, take: Half, bring: Half, candidates, limits) -> Transfer:
    """The carry with just as much brought as was taken, and what it gains."""
    bring = replace(bring, strength=_strength_of(state, now, after, bring))
    both = state.act(bring.move, after, bring.first, bring.strength)
    gain = state.distance_of(now) - state.distance_of(both)
    strengths = jnp.stack([take.strength, bring.strength])[:, None]
    actions = jnp.asarray(state.actions)[jnp.stack([take.move, bring.move])]
    needed = limits.needed(actions, strengths).sum()
    tried = candidates.strengths
    inside = (bring.strength >= tried.min()) & (bring.strength <= tried.max())
    return Transfer(take, bring, jnp.where(inside & (gain > needed), gain, 0.0))


def _strength_of(state, now, after, bring: Half) -> Float[Array, ""]:
    """How strong an action brings what was taken: what it brings is in proportion to that."""
    taken = (after - now).sum()
    brought = (state.act(bring.move, after, bring.first, bring.strength) - after).sum()
    return bring.strength * jnp.clip(-taken / jnp.where(brought == 0, 1.0, brought), 0.0, 100.0)


def _interpolated(candidates: Candidates, gains: Float[Array, "N S"], strength: Array) -> Array:
    """Gains at a strength between those tried."""
    tried = candidates.strengths
    last = candidates.num_strengths - 1
    upper = jnp.clip(jnp.searchsorted(tried, strength).astype(jnp.int32), 1, jnp.maximum(last, 1))
    lower = jnp.minimum(upper - 1, last)
    upper = jnp.minimum(upper, last)
    apart = tried[upper] - tried[lower]
    share = jnp.clip((strength - tried[lower]) / jnp.where(apart == 0, 1.0, apart), 0.0, 1.0)
    return gains[:, lower] * (1.0 - share) + gains[:, upper] * share


def _best(found: Transfer) -> Transfer:
    """The first of the best."""
    chosen = jnp.argmax(found.gain)
    return jax.tree.map(lambda one: one[chosen], found)
