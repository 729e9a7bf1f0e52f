"""Coarse to fine: the best candidates moved and weakened or deepened by ever smaller steps."""

import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array
from jshape.planning.evaluate import Candidates
from jshape.planning.search.base import EVER, Limits
from jshape.planning.state import Terrain

WIDTH = 3
"""How many moves' best candidates greedy polishes."""

AROUND = np.array([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)], np.int32)
"""The place and its eight neighbours."""


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
    left: int | Array = EVER,
) -> tuple[Array, Array, Array, Array, Array]:
    """The best `width` of the moves' best candidates, polished; static in the number of rounds.

    Every round tries the 3 x 3 places around with 3 strengths, at steps of half the size of the
    round before: places from 2^(rounds-1) nodes down to one, strengths from half of the distance
    between the candidates' own, inside their range.  The candidates' own boundaries are kept;
    where there is one strength it stays.
    No more than `left` evaluations are made: what they do not suffice for stays as it was.

    Returns:
      (width,) move numbers, first nodes, strengths and gains of d (0 where not worth it), best
      candidate first as they were before; and the evaluations.
    """
    known = candidates.strengths
    spacing = (known.max() - known.min()) / max(len(known) - 1, 1)
    deeper = jnp.array([0.0, -0.5, 0.5] if len(known) > 1 else [0.0], known.dtype) * spacing

    def of_move(number: int):
        move, own = terrain.moves[number], candidates.first[number]

        def polish(start):
            if not own.shape[0]:
                return start
            low, high = own.min(0), own.max(0)

            def one_round(k, state):
                first, strength, gain = state
                k = k.astype(jnp.int32)
                reach = 2 ** (rounds - 1 - k)
                around = jnp.clip(first + AROUND * reach, low, high)
                trial = strength + deeper / 2**k
                trial = jnp.clip(trial, known.min(), known.max())
                change = lax.map(lambda f: terrain.change(move, now, f, trial), around)
                worth = jnp.where(-change > limits.needed(move.action, trial), -change, 0.0)
                if candidates.reach is not None:
                    row, column = (around + move.middle).T
                    worth = jnp.where(candidates.reach[row, column][:, None], worth, 0.0)
                best = jnp.argmax(worth)
                row, column = jnp.divmod(best, len(deeper))
                better = worth[row, column] > gain
                return (
                    jnp.where(better, around[row], first),
                    jnp.where(better, trial[column], strength),
                    jnp.maximum(gain, worth[row, column]),
                )

            return lax.fori_loop(0, rounds, one_round, start)

        return polish

    branches = [of_move(number) for number in range(len(terrain.moves))]
    top, chosen = lax.top_k(gains, min(width, len(terrain.moves)))
    if not rounds:
        return chosen, firsts[chosen], strengths[chosen], top, jnp.int32(0)

    each = len(AROUND) * len(deeper) * rounds
    worth = (top > 0) & (each * (1 + jnp.arange(len(top))) <= left)

    def one(entry):
        gain, number, worth = entry
        start = (firsts[number], strengths[number], gain)
        return lax.cond(worth, lambda s: lax.switch(number, branches, s), lambda s: s, start)

    first, strength, gain = lax.map(one, (top, chosen, worth))
    return chosen, first, strength, gain, (worth.sum() * each).astype(jnp.int32)
