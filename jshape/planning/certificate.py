"""What multipliers of the convex relaxation prove (see `relaxation`), with all nodes as places."""

from collections.abc import Callable, Sequence

import numpy as np

from jshape._typing import Float
from jshape.planning.coarse import SIGNS, Allowance, LevelChange, fft, levels_of
from jshape.planning.relaxation import brought_by

SHIFTS = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.55, 0.75, 1.0)
"""Shares by which t and q are moved towards t = -1: actions pack material away, so that all of them
gain less by that."""
PRICES = 24
"""Prices of carried material that are tried."""


def certified(
    wanted: Float[np.ndarray, "R C"],
    weight: Float[np.ndarray, "R C"],
    changes: Sequence[LevelChange],
    uses: Allowance,
    plain: Float[np.ndarray, "R C"],
    beyond: Float[np.ndarray, "R C"],
    check: Callable[[], object] = lambda: None,
) -> float:
    """The distance that t and q prove to be left, at least; below 0: nothing.

    In double precision.  min(c, r) is taken at the next lower of some levels of r, and what it can
    grow from there is counted wherever c is larger: never too little.
    """
    sign, size_of_r, levels = np.sign(wanted), np.abs(wanted), levels_of(wanted, weight)
    q = np.where(size_of_r >= levels[0], np.clip(beyond, 0, 1), 0.0)
    t = np.clip(plain, q - 1, 1 - q)
    y, a = weight * (t - q * sign), 2 * weight * q
    size = [fft.next_fast_len(n, real=True) for n in y.shape]
    own, packing = (fft.rfft2(field, size) for field in (y, uses.lower * weight))
    useful = []
    for s in SIGNS:
        for low, high in zip(levels, [*levels[1:], np.inf], strict=True):
            here = np.where((low <= s * wanted) & (s * wanted < high), a, 0.0)
            if here.any():
                more = here * (size_of_r - low)
                useful.append((s, low, fft.rfft2(here, size), fft.rfft2(more, size)))
    shifts = np.array(SHIFTS)
    gains = np.full((len(changes), len(shifts)), -np.inf)
    for row, one in zip(gains, changes, strict=True):
        check()
        kernel = fft.rfft2(one.change, size).conj()
        felt = own * kernel
        for s, low, here, more in useful:
            c = s * one.change
            if (c > 0).any():
                felt += here * fft.rfft2(np.clip(c, 0, low), size).conj()
            if (c > low).any():
                felt += more * fft.rfft2((c > low).astype(float), size).conj()
        (v, u), (p, n) = one.low, one.places.shape
        near, packed = (
            fft.irfft2(spectrum, size)[v : v + p, u : u + n][one.places]
            for spectrum in (felt, packing * kernel)
        )
        row[:] = [((1 - k) * near - k * packed).max(initial=-np.inf) for k in shifts]
    worth = (wanted * y + size_of_r * a).sum()
    worth = (1 - shifts) * worth - shifts * uses.lower * (wanted * weight).sum()
    return max(
        float(value) - most_gain(changes, uses, mine)
        for value, mine in zip(worth, gains.T, strict=True)
    )


def most_gain(
    changes: Sequence[LevelChange], uses: Allowance, gains: Float[np.ndarray, "G"]
) -> float:
    """What actions gain at most if one of each kind gains at most so much.

    The actions that gain most are used as often as is allowed.  Carried material costs a price, so
    that what is brought must be taken; each price proves something, and the best is returned.
    """
    actions = np.array([one.action for one in changes])
    brought = brought_by(changes, uses)

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
