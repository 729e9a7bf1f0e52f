"""How much noise there is in an image, measured in it alone (host)."""

import numpy as np

from jshape._typing import Bool, Float

SIDE = 8
"""Pixels along the squares whose means are compared: more than a depth camera's noise reaches.
Pixel by pixel, simulated correlated noise of 0.45 mm looks like 0.002, by these squares like 0.25."""
NORMAL = 0.6745
"""Median |x| of a normal distribution of standard deviation 1."""


def noise_of_sums(
    image: Float[np.ndarray, "H W"], seen: Bool[np.ndarray, "H W"] | None = None
) -> float:
    """Standard deviation that noise gives to the sum over a window, per root of its pixels.

    By second differences along v and u, of means over squares, which no plane and no bowl has;
    their median takes no notice of edges.  For white noise it is that of one pixel, for correlated
    noise more.  What a rough bed does within some squares is taken for noise: rather too much.

    Args:
      image: of any unit, which the answer has too.
      seen: pixels that count; None: all.  Fewer than three whole squares in a row: 0.
    """
    counted = image if seen is None else np.where(seen, image, np.nan)
    rows, columns = (n // SIDE for n in image.shape)
    squares = counted[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
    change = np.diff(np.diff(squares.mean((1, 3), dtype=np.float64), 2, 0), 2, 1)
    change = np.abs(change[np.isfinite(change)])
    # (1, -2, 1) along both axes makes 6 of a standard deviation of 1; a mean is a sum by SIDE².
    return SIDE * float(np.median(change)) / (6 * NORMAL) if change.size else 0.0
