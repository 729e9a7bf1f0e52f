"""The convex relaxation of a plan: fractions of actions, all places at once (host).

On a level bed an action does the same at every place.  If it did so on every bed, K actions could
change the bed by Σ x·c at most, where c is the change by one action with one direction, length and
strength at one place, x >= 0 is how much of it is done, and Σ x <= K: fractions of actions are more
than any plan has.  With r the change wanted, its least distance

    min over x of  Σ weight·|r - Σ x·c|

is below that of every plan.  It is not computed to the end: by duality any map y with |y| <= weight
gives a number that is below it too,

    <r, y> - K·max(0, max over c of <c, y>),

and all <c, y> of one kind of action are one correlation.  So `solved` looks for a good y on a
coarse map by accelerated projected gradient steps, and `certified` computes what that y proves,
with all nodes as places, in double precision.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter

from jshape._typing import Bool, Float
from jshape.planning.evaluate import Candidates
from jshape.planning.state import SearchState

fft: Any = scipy.fft
"""Type checkers are told that its functions return tuples."""
SIDE = 80
"""Squares along the longer side of the coarse map: 8 mm in the paper's box."""
STEPS, WORK = 500, 30_000
"""Of the search for y, and steps times kinds of changes, at most: 4 s on two cores.  A ridge: 13 %
after 120 steps, 15 % after 300, 16 % after 700."""
SOFT = 1.0, 4.0
"""Over which |r - Σ x·c| is rounded in the end and at first, times the mean |r|."""
SHIFTS = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.55, 0.75, 1.0)
"""Shares of weight that is taken off y: actions pack material away, so that all of them gain less
by it.  A ridge: without, -4 % are proven instead of 15."""
PRICES = 24
"""Prices of carried material that are tried."""


class LevelChange(NamedTuple):
    """What one action with one direction, length and strength does to a level bed."""

    action: int
    """Its number in the bank."""
    strength: float
    change: Float[np.ndarray, "n m"]
    """Of the map in its window."""
    places: Bool[np.ndarray, "P Q"]
    """First nodes, from `low` on, at which its window may begin."""
    low: tuple[int, int]


class Allowance(NamedTuple):
    """How many actions a plan may have."""

    steps: int
    """Actions altogether."""
    most: Float[np.ndarray, "A"]
    """Of each action, at most."""
    carried: frozenset[int]
    """Actions that take material out and bring it; they bring no more than they took."""
    stock: float
    """And a stock beside the bed, in units of Σ map."""
    lower: float
    """1 where the map is greater where the bed is lower, else -1."""


class Solution(NamedTuple):
    """The best fractions that were found."""

    ratios: Float[np.ndarray, "R C"]
    """Y / weight, in [-1, 1]."""
    rest: Float[np.ndarray, "R C"]
    """R - Σ x·c: of the map's unit."""


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
) -> Solution:
    """Fractions of actions that come near the change wanted, and the y of what they leave.

    FISTA on the coarse map; the prices of actions and of carried material follow by dual ascent.
    """
    shape = wanted.shape
    side = max(1, round(max(shape) / SIDE))
    w = _blocks(weight, side, shape)
    r = np.divide(_blocks(weight * wanted, side, shape), w, out=np.zeros_like(w), where=w > 0)
    total = float((w * np.abs(r)).sum())
    kinds = [_coarse(one, side, w.shape) for one in changes]
    size = [fft.next_fast_len(n, real=True) for n in w.shape]
    norms = np.array([np.sqrt((c**2).sum() * w.max()) for c, _, _ in kinds]) + 1e-30
    spectra = np.stack([fft.rfft2(c.astype("f4"), size) for c, _, _ in kinds])
    spectra /= norms[:, None, None].astype("f4")
    free = np.zeros((len(kinds), *size), bool)
    for mask, one, (_, places, (v, u)) in zip(free, changes, kinds, strict=True):
        mask[v : v + places.shape[0], u : u + places.shape[1]] = places & (
            uses.most[one.action] > 0
        )
    w, r = (np.pad(a, [(0, s - n) for s, n in zip(size, a.shape, strict=True)]) for a in (w, r))
    w, r = w.astype("f4"), r.astype("f4")

    def changed(x: np.ndarray) -> np.ndarray:
        return fft.irfft2((fft.rfft2(x, size) * spectra).sum(0), size)

    def felt(y: np.ndarray) -> np.ndarray:
        return fft.irfft2(fft.rfft2(y, size)[None] * spectra.conj(), size)

    x = free.astype("f4")
    for _ in range(8):  # the greatest eigenvalue
        x = felt(w * changed(x)) * free
        steep = float(np.linalg.norm(x))
        x /= max(steep, 1e-30)
    x[:] = 0
    ahead, momentum = x, 1.0
    unit = (1.0 / norms).astype("f4")
    actions = np.array([one.action for one in changes])
    brought = np.array([-uses.lower * one.change.sum() for one in changes])
    brought = np.where(np.isin(actions, list(uses.carried)), brought, 0.0)
    handful = max(float(np.abs(brought).max(initial=0)), 1e-30)
    step, each, price = 0.0, np.zeros(len(uses.most)), 0.0
    # No action is worth more than the best one at first, nor all together more than the distance.
    best = float(((felt(w * np.sign(r)) * free).max((1, 2)) * norms).max())
    most = np.minimum(uses.most, uses.steps)
    last, first = (soft * total / max(float(w.sum()), 1e-30) for soft in SOFT)
    ratios = mean = np.zeros_like(r)
    for n in range(min(STEPS, max(WORK // len(kinds), 60))):
        soft = max(first * 0.985**n, last, 1e-30)
        ratios = np.clip((r - changed(ahead)) / soft, -1, 1)
        mean = 0.95 * mean + 0.05 * ratios
        rate = np.float32(1.05 * steep / soft)
        cost = ((step + each[actions] + price * brought) * unit).astype("f4")
        new = np.maximum(ahead + (felt(w * ratios) - cost[:, None, None]) / rate, 0) * free
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
    rest = r - changed(x * fit[:, None, None].astype("f4"))
    return Solution(*(_fine(a, side, shape) for a in (mean, rest)))


def _ascent(price: float, over: float, scale: float) -> float:
    """A price after a step: up where more is used than allowed (`over` > 0), slowly down else."""
    return max(price + (0.02 if over > 0 else 0.005) * min(over, 1.0) * scale, 0.0)


def _blocks(field: np.ndarray, side: int, shape: tuple[int, int]) -> np.ndarray:
    """Sums over squares of `side` nodes."""
    rows, columns = (-(-n // side) for n in shape)
    padded = np.pad(field, ((0, rows * side - shape[0]), (0, columns * side - shape[1])))
    return padded.reshape(rows, side, columns, side).sum((1, 3))


def _coarse(
    one: LevelChange, side: int, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """A change on the coarse map; its places, and the first of them."""
    change = _blocks(one.change, side, one.change.shape) / side**2
    low = [-(-n // side) for n in one.low]
    ahead = [n * side - m for n, m in zip(low, one.low, strict=True)]
    places = one.places[ahead[0] :: side, ahead[1] :: side]
    # The last place of a window that was rounded up may be beyond the map.
    room = [max(n - c - l + 1, 0) for n, c, l in zip(shape, change.shape, low, strict=True)]
    return change, places[: room[0], : room[1]], (low[0], low[1])


def _fine(coarse: np.ndarray, side: int, shape: tuple[int, int]) -> np.ndarray:
    """Values of squares on the nodes, smoothed over one square."""
    fine = coarse.repeat(side, 0).repeat(side, 1).astype(np.float64)
    return uniform_filter(fine, side, mode="nearest")[: shape[0], : shape[1]]


def certified(
    wanted: Float[np.ndarray, "R C"],
    weight: Float[np.ndarray, "R C"],
    changes: Sequence[LevelChange],
    uses: Allowance,
    ratios: Float[np.ndarray, "R C"],
) -> float:
    """The distance that y = ratios·weight proves to be left, at least; below 0: nothing."""
    y = np.clip(ratios, -1, 1) * weight
    size = [fft.next_fast_len(n, real=True) for n in y.shape]
    spectra = [fft.rfft2(field, size) for field in (y, uses.lower * weight)]
    shifts = np.array(SHIFTS)
    gains = np.full((len(changes), len(shifts)), -np.inf)
    for row, one in zip(gains, changes, strict=True):
        kernel = fft.rfft2(one.change, size).conj()
        (v, u), (p, q) = one.low, one.places.shape
        near, packed = (
            fft.irfft2(spectrum * kernel, size)[v : v + p, u : u + q][one.places]
            for spectrum in spectra
        )
        row[:] = [((1 - s) * near - s * packed).max(initial=-np.inf) for s in shifts]
    worth = (1 - shifts) * (wanted * y).sum() - shifts * uses.lower * (wanted * weight).sum()
    return float(
        max(
            value - most_gain(changes, uses, mine)
            for value, mine in zip(worth, gains.T, strict=True)
        )
    )


def most_gain(
    changes: Sequence[LevelChange], uses: Allowance, gains: Float[np.ndarray, "G"]
) -> float:
    """What actions gain at most if one of each kind gains at most so much.

    The actions that gain most are used as often as is allowed.  Carried material costs a price, so
    that what is brought must be taken; each price proves something, and the best is returned.
    """
    actions = np.array([one.action for one in changes])
    brought = np.array([-uses.lower * one.change.sum() for one in changes])
    brought = np.where(np.isin(actions, list(uses.carried)), brought, 0.0)

    def at(price: float) -> float:
        best = np.zeros(len(uses.most))
        np.maximum.at(best, actions, gains - price * brought)
        left, found = float(uses.steps), price * uses.stock
        for action in np.argsort(-best):
            count = min(float(uses.most[action]), left)
            found, left = found + count * float(best[action]), left - count
        return found

    bringing = brought > 0
    if not bringing.any():
        return at(0.0)
    most = float((gains[bringing] / brought[bringing]).max())
    return min(at(float(price)) for price in np.linspace(0, max(most, 0.0), PRICES))
