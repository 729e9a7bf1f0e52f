"""Coarse to fine: the best candidates moved and weakened or deepened by ever smaller steps."""

import jax.numpy as jnp
from jax import lax

from jshape._typing import Array
from jshape.planners.base import Limits
from jshape.predict.sweep import Candidates
from jshape.predict.terrain import Terrain

WIDTH = 3
"""How many moves' best candidates greedy polishes."""


def polished(
    terrain: Terrain,
    now: Array,
    candidates: Candidates,
    gains: Array,
    firsts: Array,
    strengths: Array,
    limits: Limits,
    rounds: int,
    width: int = WIDTH,
) -> tuple[Array, Array, Array, Array, Array]:
    """The best `width` of the moves' best candidates, polished; static in the number of rounds.

    Every round tries the 3 x 3 places around with 3 strengths, at steps of half the size of the
    round before: places from 2^(rounds-1) nodes down to one, strengths from half of the distance
    between the candidates' own, inside their range.  The candidates' own boundaries are kept.

    Returns:
      (width,) move numbers, first nodes, strengths and gains of d (0 where not worth it), best
      candidate first as they were before; and the evaluations.
    """
    known = candidates.strengths
    spacing = (known.max() - known.min()) / max(len(known) - 1, 1)

    def of_move(number: int):
        move, own = terrain.moves[number], candidates.first[number]

        def polish(start):
            first, strength, gain = start
            if not own.shape[0]:
                return start
            low, high = own.min(0), own.max(0)
            for k in range(rounds):
                reach = 2 ** (rounds - 1 - k)
                grid = jnp.array([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)]) * reach
                around = jnp.clip(first + grid, low, high)
                trial = strength + jnp.array([0.0, -0.5, 0.5]) * spacing / 2**k
                trial = jnp.clip(trial, known.min(), known.max())
                change = lax.map(lambda f, t=trial: terrain.change(move, now, f, t), around)
                worth = jnp.where(-change > limits.needed(move.action, trial), -change, 0.0)
                if candidates.reach is not None:
                    row, column = (around + move.middle).T
                    worth = jnp.where(candidates.reach[row, column][:, None], worth, 0.0)
                best = jnp.argmax(worth)
                row, column = jnp.divmod(best, 3)
                better = worth[row, column] > gain
                first = jnp.where(better, around[row], first)
                strength = jnp.where(better, trial[column], strength)
                gain = jnp.maximum(gain, worth[row, column])
            return first, strength, gain

        return polish

    branches = [of_move(number) for number in range(len(terrain.moves))]
    top, chosen = lax.top_k(gains, min(width, len(terrain.moves)))
    if not rounds:
        return chosen, firsts[chosen], strengths[chosen], top, jnp.int32(0)

    def one(pair):
        gain, number = pair
        start = (firsts[number], strengths[number], gain)
        return lax.cond(gain > 0, lambda s: lax.switch(number, branches, s), lambda s: s, start)

    first, strength, gain = lax.map(one, (top, chosen))
    spent = (top > 0).sum() * (27 * rounds)
    return chosen, first, strength, gain, spent.astype(jnp.int32)
