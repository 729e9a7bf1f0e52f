"""How much noise there is in what a camera sees, measured in its looks alone (host)."""

import math

import numpy as np

from jshape._typing import Bool, Float

SIDE = 8
"""Pixels along the squares whose means are compared: more than a depth camera's noise reaches.
By single pixels simulated, correlated noise of 0.45 mm looks like 0.002, by these like 0.5."""
WIDE = 32
"""Likewise where two looks are compared, and no shape can be taken for noise."""
NORMAL = 0.6745
"""Median |x| of a normal distribution of standard deviation 1."""


def noise_of_sums(
    image: Float[np.ndarray, "H W"], seen: Bool[np.ndarray, "H W"] | None = None
) -> float:
    """Standard deviation that noise gives to the sum over a window, per root of its pixels.

    By second differences along v and u, of means over squares, which no plane and no bowl has;
    their median takes no notice of edges.  For white noise it is that of one pixel, for correlated
    noise more: simulated frames have three times as much as is found, since squares side by side
    err alike.  What a rough bed does within some squares is taken for noise.

    Args:
      image: of any unit, which the answer has too.
      seen: pixels that count; None: all.  Fewer than three whole squares in a row: 0.
    """
    change = np.diff(np.diff(_means(image, seen, SIDE), 2, 0), 2, 1)
    # (1, -2, 1) along both axes makes 6 of a standard deviation of 1; a mean is a sum by SIDE².
    return SIDE * _usual(change) / 6


def noise_of_change(
    before: Float[np.ndarray, "H W"],
    after: Float[np.ndarray, "H W"],
    same: Bool[np.ndarray, "H W"],
    counted: int,
) -> float:
    """Standard deviation that the noise of two looks gives to the change of a mean over pixels.

    Where both saw the same nothing differs but noise: no shape is taken for it.

    Args:
      before: image of one look.
      after: of another.
      same: pixels where nothing happened in between; less than one whole square: 0.
      counted: how many pixels the mean is over.
    """
    return WIDE * _usual(_means(after - before, same, WIDE)) / math.sqrt(max(counted, 1))


def _means(image: np.ndarray, counted: np.ndarray | None, side: int) -> np.ndarray:
    """Of squares; NaN for those with pixels that do not count."""
    image = image if counted is None else np.where(counted, image, np.nan)
    rows, columns = (n // side for n in image.shape)
    squares = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return squares.mean((1, 3), dtype=np.float64)


def _usual(changes: np.ndarray) -> float:
    """Standard deviation of what is normal around 0 but for some; 0 of nothing."""
    known = np.abs(changes[np.isfinite(changes)])
    return float(np.median(known)) / NORMAL if known.size else 0.0
