"""The convex relaxation of a plan: fractions of actions, all places at once (host).

On a level bed an action does the same at every place, c.  If it did so on every bed, K actions
would change the bed by Σ c.  With r the change wanted, let u = Σ min(c, r) where r > 0: what of
each is useful by itself.  However many there are, and in whatever order, what stays at a node is

    |r - Σ c|  >=  max(|r - Σ c|, r - 2·u + Σ c)

(with the signs of r and c changed where r < 0): if those that lower by P, and raise by N, have P <=
r, then u = P and the second is r - P - N; else u >= r and it is P - N - r at most.  It keeps one
deep action from counting as many shallow ones.  The right side is convex, so that fractions x >= 0
with Σ x <= K leave no more than the best K actions do.  It is not computed to the end: by duality,
maps t and q with |t| + q <= 1 prove that at least

    Σ weight·(t·r + q·|r|) - K·max(0, max over c of Σ weight·(t·c + q·(2·min(c, r) - c)))

is left, and what one kind of action has in the last sum at all places is a few correlations.
`solved` looks for good t and q on a coarse map; `certificate` computes what they prove.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Float
from jshape.planning.coarse import Allowance, CoarseMap, LevelChange
from jshape.planning.evaluate import Candidates
from jshape.planning.state import SearchState

SIDE = 80
"""Squares along the longer side of the coarse map: 8 mm in the paper's box."""
STEPS, WORK = 250, 15_000
"""Of the search, and steps times kinds of changes, at most: 4 s on two cores."""
SOFT = 1.0, 4.0
"""Over which |r - Σ x·c| is rounded in the end and at first, times the mean |r|."""


class Solution(NamedTuple):
    """The best fractions that were found, and what they prove something by."""

    plain: Float[np.ndarray, "R C"]
    """The multipliers t of what is left, in [-1, 1]."""
    beyond: Float[np.ndarray, "R C"]
    """And q of what is useful by itself, from 0 to 1 - |t|."""
    rest: Float[np.ndarray, "R C"]
    """What the fractions leave, r - Σ x·c, of the map's unit."""
    left: Float[np.ndarray, "R C"]
    """What the relaxation counts of that: as much or more, of the map's unit."""
    prices: Float[np.ndarray, "G"]
    """What one action of each kind costs beside the price of any: where they may be used some times
    only, or bring material."""
    short: bool
    """Whether more actions would have been used: they have a price in the end."""


@jax.jit
def _after(state: SearchState, bed, number, first, strength):
    return state.act(number, bed, first, strength)


def level_changes(
    state: SearchState, candidates: Candidates, strengths: Sequence[float]
) -> list[LevelChange]:
    """What the moves of a search do to level beds, and where it may try them.

    The bed lies at the median of the bed now, of a camera whose range has no ends: a knock that the
    far end cuts off would keep its rims, and so bring material.
    """
    shape, counts = np.array(state.now.shape), candidates.counts
    low, high = np.asarray(candidates.low), np.asarray(candidates.high)
    reachable = np.asarray(candidates.reachable)
    seen = slice(None) if state.weight is None else np.asarray(state.weight) > 0
    level = np.float32(np.median(np.asarray(state.now)[seen]))
    bed = np.full(state.now.shape, level, np.float32)
    state = replace(state, limits=jnp.array([-jnp.inf, jnp.inf], jnp.float32))
    found: list[LevelChange] = []
    for number, move in enumerate(state.moves):
        if not counts[number]:
            continue
        first = (shape - move.shape) // 2
        window = tuple(slice(f, f + n) for f, n in zip(first, move.shape, strict=True))
        (v0, u0), (v1, u1) = low[number], high[number]
        v, u = move.middle
        places = reachable[v0 + v : v1 + v + 1, u0 + u : u1 + u + 1]
        for strength in strengths:
            how = np.int32(number), first.astype(np.int32), np.float32(strength)
            change = np.asarray(_after(state, bed, *how), np.float64)[window] - float(level)
            found.append(LevelChange(move.action, strength, change, places, (int(v0), int(u0))))
    return found


def solved(
    wanted: Float[np.ndarray, "R C"],
    weight: Float[np.ndarray, "R C"],
    changes: Sequence[LevelChange],
    uses: Allowance,
    check: Callable[[], object] = lambda: None,
) -> Solution:
    """Fractions of actions that come near the change wanted, and multipliers of what they leave.

    FISTA on the coarse map; the prices of actions and of carried material follow by dual ascent.
    """
    coarse = CoarseMap.of(wanted, weight, changes, uses, SIDE)
    w, r, norms, free = coarse.weight, coarse.wanted, coarse.norms, coarse.free
    sign, truncated = np.sign(r), coarse.truncated
    total = float((w * np.abs(r)).sum())
    x = free.astype("f4")
    for _ in range(8):  # the greatest eigenvalue
        v, u = coarse.changed(x)
        over = w * truncated * (sign * v - 2 * u)
        x = coarse.felt(w * v + sign * over, -2 * over) * free
        steep = float(np.linalg.norm(x))
        x /= max(steep, 1e-30)
    if steep == 0:  # the coarse map has no place
        none = np.zeros(wanted.shape)
        return Solution(none, none, wanted, np.abs(wanted), np.zeros(len(changes)), short=True)
    x[:] = 0
    ahead, momentum = x, 1.0
    unit = (1.0 / norms).astype("f4")
    actions = np.array([one.action for one in changes])
    brought = brought_by(changes, uses)
    handful = max(float(np.abs(brought).max(initial=0)), 1e-30)
    step, each, price = 0.0, np.zeros(len(uses.most)), 0.0
    # No action is worth more than the best one at first, nor all together more than the distance.
    best = float(((coarse.felt(w * sign, 0 * w) * free).max((1, 2)) * norms).max())
    most = np.minimum(uses.most, uses.steps)
    last, first = (soft * total / max(float(w.sum()), 1e-30) for soft in SOFT)
    plain = beyond = np.zeros_like(r)
    for n in range(min(STEPS, max(WORK // len(changes), 60))):
        check()
        soft = max(first * 0.985**n, last, 1e-30)
        v, u = coarse.changed(ahead)
        t, q = multipliers((r - v) / soft, truncated * (np.abs(r) - 2 * u + sign * v) / soft)
        plain, beyond = 0.95 * plain + 0.05 * t, 0.95 * beyond + 0.05 * q
        rate = np.float32(1.05 * steep / soft)
        cost = ((step + each[actions] + price * brought) * unit).astype("f4")
        worth = coarse.felt(w * (t - q * sign), 2 * w * q)
        new = np.maximum(ahead + (worth - cost[:, None, None]) / rate, 0) * free
        done = (new.sum((1, 2)) * unit).astype(float)
        step = _ascent(step, done.sum() / uses.steps - 1, min(total / uses.steps, best))
        of = np.bincount(actions, done, len(each))
        for k, count in enumerate(most):
            each[k] = _ascent(each[k], of[k] / count - 1, min(total / count, best)) if count else 0
        over = ((brought * done).sum() - uses.stock) / (handful * uses.steps)
        price = _ascent(price, 10 * over, total / (handful * uses.steps))
        if float(((ahead - new) * (new - x)).sum()) > 0:
            momentum = 1.0
        next_momentum = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = new + np.float32((momentum - 1) / next_momentum) * (new - x)
        x, momentum = new, next_momentum
    used = (x.sum((1, 2)) * unit).astype(float)
    of = np.bincount(actions, used, len(each))
    fit = np.minimum(1.0, np.divide(most, of, out=np.ones_like(of), where=of > 0))[actions]
    fit *= min(1.0, uses.steps / max(float((used * fit).sum()), 1e-30))
    v, u = coarse.changed(x * fit[:, None, None].astype("f4"))
    left = np.maximum(np.abs(r - v), truncated * (np.abs(r) - 2 * u + sign * v))
    maps = (coarse.on_nodes(a) for a in (plain, beyond, r - v, left))
    return Solution(*maps, prices=each[actions] + price * brought, short=bool(step > 0))


def multipliers(far: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of |r - v| (signed) and of |r| - 2u + v: (|far|, beyond), projected to a sum of 1 at most."""
    p, q = np.abs(far), np.maximum(beyond, 0)
    more = np.maximum(p + q - 1, 0) / 2
    p, q = p - more, q - more
    q, p = np.clip(q + np.minimum(p, 0), 0, 1), np.clip(p + np.minimum(q, 0), 0, 1)
    return np.sign(far) * p, q


def _ascent(price: float, over: float, scale: float) -> float:
    """A price after a step: up where more is used than allowed (`over` > 0), slowly down else."""
    return max(price + (0.02 if over > 0 else 0.005) * min(over, 1.0) * scale, 0.0)


def brought_by(changes: Sequence[LevelChange], uses: Allowance) -> Float[np.ndarray, "G"]:
    """What carried actions bring, in units of Σ map; below 0: what they take.  0 of others."""
    brought = np.array([-uses.lower * one.change.sum() for one in changes])
    return np.where([one.action in uses.carried for one in changes], brought, 0.0)
