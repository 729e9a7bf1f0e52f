"""What actions do to a level bed, on a coarse map: all places of a kind by one product (host)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter

from jshape._typing import Bool, Float

fft: Any = scipy.fft
"""Type checkers are told that its functions return tuples."""
LEVELS = 0.1, 0.25, 0.45, 0.7, 0.95
"""Sizes of r at which min(c, r) is computed, shares of the largest; below the first q is 0."""
SIGNS = 1, -1
"""Of r."""
RARE = 0.05
"""Where r has a sign with less than this share of the distance, q is 0."""


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


@dataclass(frozen=True, eq=False)
class CoarseMap:
    """A change wanted in squares of nodes, and what each kind of action does to it.

    Its maps are padded so that windows do not come round; x, places of actions, is a map per kind.
    """

    weight: Float[np.ndarray, "R C"]
    wanted: Float[np.ndarray, "R C"]
    hats: Float[np.ndarray, "L R C"]
    """Weights with which min(c, r) at sizes of r gives that at each square's own r."""
    truncated: Bool[np.ndarray, "R C"]
    """Where min(c, r) is known."""
    spectra: np.ndarray
    """(1 + L, G, R, F) of each kind's change, and of min(c, r) at each size, by `norms`."""
    norms: Float[np.ndarray, "G"]
    """A unit of x is one of an action by this."""
    free: Bool[np.ndarray, "G R C"]
    """Places of each kind."""
    side: int
    """Nodes along a square."""
    shape: tuple[int, int]
    """Of the map in nodes."""

    @classmethod
    def of(
        cls,
        wanted: Float[np.ndarray, "R C"],
        weight: Float[np.ndarray, "R C"],
        changes: Sequence[LevelChange],
        uses: Allowance,
        squares: int,
    ) -> "CoarseMap":
        """A map of so many squares along its longer side."""
        shape = wanted.shape
        side = max(1, round(max(shape) / squares))
        w = _blocks(weight, side, shape)
        r = np.divide(_blocks(weight * wanted, side, shape), w, out=np.zeros_like(w), where=w > 0)
        total = float((w * np.abs(r)).sum())
        kinds = [_coarse(one, side, w.shape) for one in changes]
        size = [fft.next_fast_len(n, real=True) for n in w.shape]
        w, r = (np.pad(a, [(0, s - n) for s, n in zip(size, a.shape, strict=True)]) for a in (w, r))
        few = levels_of(wanted, weight)[::2]
        cases = [  # the sign of r, a level, and how much of it each square has
            (s, level, hat.astype("f4"))
            for s in SIGNS
            if (w * np.maximum(s * r, 0)).sum() > RARE * total
            for level, hat in zip(few, _hats(s * r, few), strict=True)
        ]
        hats = np.array([hat for _, _, hat in cases], "f4").reshape(-1, *size)
        norms = np.array([np.sqrt((c**2).sum() * w.max()) for c, _, _ in kinds]) + 1e-30
        parts = [
            [one.change, *(np.clip(s * one.change, 0, level) for s, level, _ in cases)]
            for one in changes
        ]
        spectra = np.stack(
            [
                [fft.rfft2(_blocks(part, side, part.shape).astype("f4"), size) for part in each]
                for each in zip(*parts, strict=True)
            ]
        )
        spectra /= (side**2 * norms[:, None, None]).astype("f4")
        free = np.zeros((len(kinds), *size), bool)
        for mask, one, (_, places, (v, u)) in zip(free, changes, kinds, strict=True):
            mask[v : v + places.shape[0], u : u + places.shape[1]] = places & (
                uses.most[one.action] > 0
            )
        w, r, truncated = w.astype("f4"), r.astype("f4"), hats.sum(0) > 0
        return cls(w, r, hats, truncated, spectra, norms, free, side, (shape[0], shape[1]))

    def changed(
        self, x: Float[np.ndarray, "K R C"], kinds: Any = slice(None)
    ) -> tuple[Float[np.ndarray, "R C"], Float[np.ndarray, "R C"]]:
        """Σ x·c and Σ x·min(c, r), of some kinds."""
        size = self.wanted.shape
        fields = np.einsum("krc,hkrc->hrc", fft.rfft2(x, size), self.spectra[:, kinds])
        parts = fft.irfft2(fields, size)
        return parts[0], (self.hats * parts[1:]).sum(0)

    def felt(
        self,
        y: Float[np.ndarray, "R C"],
        a: Float[np.ndarray, "R C"],
        kinds: Any = slice(None),
    ) -> Float[np.ndarray, "K R C"]:
        """<y, c> + <a, min(c, r)> of every place, of some kinds."""
        size = self.wanted.shape
        fields = fft.rfft2(np.concatenate([y[None], self.hats * a]), size)
        return fft.irfft2(np.einsum("hrc,hkrc->krc", fields, self.spectra[:, kinds].conj()), size)

    def of_nodes(
        self, field: Float[np.ndarray, "N M"], weight: Float[np.ndarray, "N M"]
    ) -> Float[np.ndarray, "R C"]:
        """The weighed mean of nodes in each square."""
        total = _blocks(weight, self.side, self.shape)
        mean = np.zeros(self.wanted.shape, "f4")
        rows, columns = total.shape
        of = _blocks(weight * field, self.side, self.shape)
        np.divide(of, total, out=mean[:rows, :columns], where=total > 0, casting="unsafe")
        return mean

    def on_nodes(self, coarse: Float[np.ndarray, "R C"]) -> Float[np.ndarray, "N M"]:
        """Values of squares on the nodes, smoothed over one square."""
        fine = coarse.repeat(self.side, 0).repeat(self.side, 1).astype(np.float64)
        rows, columns = self.shape
        return uniform_filter(fine, self.side, mode="nearest")[:rows, :columns]


def levels_of(wanted: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Sizes of the change wanted at which what is useful of an action is computed."""
    return np.array(LEVELS) * max(float(np.percentile(np.abs(wanted[weight > 0]), 99)), 1e-30)


def _hats(r: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """(L, R, C) weights with which values at the levels give those at r; 0 below the first."""
    found = np.stack([np.interp(r, levels, one, left=0.0) for one in np.eye(len(levels))])
    return found * (r >= levels[0])


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
