"""Carries: material taken out at one place and brought to another, as one candidate.

Neither action need bring the goal nearer by itself: a scoop from level material does not until it
is poured.  Windows that do not overlap change d independently, so that the tables of single actions
propose both places; the pairs proposed are then predicted one after the other, and the material
that is brought is what was taken.  With a stock beside the bed each half is a candidate of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Bool, Float, Int
from jshape.planning.evaluate import CandidateCache, Candidates
from jshape.planning.search.base import SearchLimits
from jshape.planning.search.local import AROUND
from jshape.planning.state import SearchState


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
    """A carry, or one half of it with a stock beside the bed, and by how much d falls by it."""

    take: Half
    bring: Half
    takes: Bool[Array, "*B"]
    """Whether the first half is part of it."""
    brings: Bool[Array, "*B"]
    """Whether the second is."""
    stock: Float[Array, "*B"]
    """What the stock holds more then, in units of Σ now."""
    gain: Float[Array, "*B"]
    """0 if it is not worth it."""

    @property
    def cost(self) -> Float[Array, "*B"]:
        """Number of actions."""
        return jnp.maximum(self.takes.astype(jnp.float32) + self.brings.astype(jnp.float32), 1.0)


def best_transfer(
    state: SearchState,
    now: Float[Array, "R C"],
    candidates: Candidates,
    cache: CandidateCache,
    used: Int[Array, "A"],
    stock: Float[Array, ""],
    limits: SearchLimits,
    rounds: int | Array,
) -> Transfer:
    """The carry that gains most per action, of those that the tables of single actions propose.

    One for each strength with which material is taken, and if there is a stock, for each with which
    it is brought; the best of them is then moved, first where material is brought and then where it
    is taken, by ever smaller steps as in a local search.
    """
    task = _Task(state, now, candidates, cache, used, stock, limits)
    best = [_moved(task, task.proposed(*pair), rounds) for pair in state.carries]
    return _best_of(best)


@dataclass(frozen=True)
class _Task:
    """Where carries are looked for."""

    state: SearchState
    now: Array
    candidates: Candidates
    cache: CandidateCache
    used: Array
    stock: Array
    limits: SearchLimits

    def proposed(self, take: int, bring: int) -> Transfer:
        """The best that the tables propose, of one pair of actions."""
        candidates, gains = self.candidates, -self.cache.changes
        action = jnp.asarray(self.state.actions)[candidates.move]
        takes, brings = (
            candidates.valid
            & ~self.cache.stale
            & (action == one)
            & self.limits.carry_allowed(one, self.used)
            for one in (take, bring)
        )
        shapes = jnp.asarray(self.state.shapes)[candidates.move]

        def half(mine: Array, gain: Array, strength: Array) -> tuple[Array, Half]:
            row = jnp.argmax(jnp.where(mine, gain, -jnp.inf))
            return row, Half(candidates.move[row], candidates.first[row], strength)

        def with_strength(s: Array) -> Transfer:
            strength = candidates.strengths[s]
            row, first = half(takes, gains[:, s], strength)
            after = self.act(self.now, first)
            # A first guess of the strength, from what the trained action brings anywhere.
            _, any_place = half(brings, jnp.zeros_like(gains[:, s]), jnp.float32(1.0))
            guess = self.strength_of(after, any_place)
            worth = _interpolated(candidates, gains, guess)
            apart = (candidates.first >= (first.first + shapes[row])[None]) | (
                first.first[None] >= candidates.first + shapes
            )
            both = takes.any() & brings.any()
            found = [
                self.carry(after, first, half(mine, worth, guess)[1], both)
                for mine in (brings, brings & apart.any(-1))
            ]
            _, second = half(brings, gains[:, s], strength)
            found += [self.alone(first, takes.any(), True), self.alone(second, brings.any(), False)]
            return _best_of(found)

        every = lax.map(with_strength, jnp.arange(len(candidates.strengths), dtype=jnp.int32))
        return _best(every)

    def act(self, now: Array, half: Half) -> Array:
        return self.state.act(half.move, now, half.first, half.strength)

    def carry(self, after: Array, take: Half, bring: Half, possible: Array) -> Transfer:
        """As much brought as was taken, which left the map `after`."""
        bring = replace(bring, strength=self.strength_of(after, bring))
        both = self.act(after, bring)
        tried = self.candidates.strengths
        inside = (bring.strength >= tried.min()) & (bring.strength <= tried.max())
        gain = self.gain(both, take, bring)
        yes = jnp.array(True)
        kept = jnp.where(possible & inside, gain, 0.0)
        return Transfer(take, bring, yes, yes, jnp.float32(0.0), kept)

    def alone(self, half: Half, possible: Array, takes: bool) -> Transfer:
        """One half, with the stock as the other."""
        after = self.act(self.now, half)
        more = (after - self.now).sum()
        left = self.stock + more  # NaN without a stock
        gain = jnp.where(possible & (left >= 0), self.gain(after, half), 0.0)
        yes, no = jnp.array(takes), jnp.array(not takes)
        return Transfer(half, half, yes, no, more, gain)

    def gain(self, after: Array, *halves: Half) -> Array:
        """By how much the objective falls, if that is more than each of the actions must gain."""
        gain = self.state.objective(self.now) - self.state.objective(after)
        strengths = jnp.stack([half.strength for half in halves])[:, None]
        actions = jnp.asarray(self.state.actions)[jnp.stack([half.move for half in halves])]
        return jnp.where(gain > self.limits.needed(actions, strengths).sum(), gain, 0.0)

    def strength_of(self, after: Array, bring: Half) -> Array:
        """How strong an action brings what was taken: what it brings is in proportion to that."""
        taken = (after - self.now).sum()
        brought = (self.act(after, bring) - after).sum()
        share = -taken / jnp.where(brought == 0, 1.0, brought)
        return bring.strength * jnp.clip(share, 0.0, 100.0)


def _moved(task: _Task, found: Transfer, rounds: int | Array) -> Transfer:
    """A carry whose places were moved, as far as that gains."""
    rounds = jnp.asarray(rounds, jnp.int32)

    def at(half: Half, by: Array) -> Half:
        candidates = task.candidates
        first = half.first + by
        first = jnp.clip(first, candidates.low[half.move], candidates.high[half.move])
        row, column = first + (jnp.asarray(task.state.shapes) // 2)[half.move]
        free = candidates.reachable[row, column]
        return replace(half, first=jnp.where(free, first, half.first))

    def one_round(r: Array, best: Transfer) -> Transfer:
        around = jnp.left_shift(jnp.int32(1), rounds - 1 - r) * jnp.asarray(AROUND, jnp.int32)

        def tried(take: Half, bring: Half) -> Transfer:
            def both() -> Transfer:
                return task.carry(task.act(task.now, take), take, bring, jnp.array(True))

            def one() -> Transfer:
                taken, brought = (
                    task.alone(half, jnp.array(True), first)
                    for half, first in ((take, True), (bring, False))
                )
                return jax.tree.map(lambda a, b: jnp.where(best.takes, a, b), taken, brought)

            return lax.cond(best.takes & best.brings, both, one)

        best = _best(lax.map(lambda by: tried(best.take, at(best.bring, by)), around))
        return _best(lax.map(lambda by: tried(at(best.take, by), best.bring), around))

    return lax.cond(
        found.gain > 0, lambda one: lax.fori_loop(0, rounds, one_round, one), lambda one: one, found
    )


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


def _best_of(found: Sequence[Transfer]) -> Transfer:
    return _best(jax.tree.map(lambda *one: jnp.stack(one), *found))


def _best(found: Transfer) -> Transfer:
    """The first of those that gain most per action."""
    chosen = jnp.argmax(found.gain / found.cost)
    return jax.tree.map(lambda one: one[chosen], found)
