"""The calibrated spread of an action's prediction: two numbers, from pairs that were held out."""

import numpy as np

from jshape.models.spread import COVERED, LEAST_MM

SHARES = np.arange(0.0, 1.0, 0.01)
"""Shares of the change nearby that are tried."""
FITTED = 2
"""Numbers that a predictor fits to each pixel's pairs, as far as they count: where the tool is and
how far the bed gives way."""


def with_more_pairs(fitted: int, pairs: int) -> float:
    """What errors are multiplied by when a fit has so many `pairs` instead of `fitted`.

    A fit of p numbers to n independent pairs is off by sqrt(1 + p/n) of what repetitions differ by:
    0.94 from 4 pairs to 6, 0.99 from 56 to 75.
    """
    return float(np.sqrt((1 + FITTED / pairs) / (1 + FITTED / fitted)))


def fit_spread(pixels: np.ndarray, scale: float = 1.0) -> tuple[float, float]:
    """(mm, share) of `models.spread` with which the narrowest intervals cover 80 % of the pixels.

    For each share the mm that cover 80 % is a quantile; of those the one with the least interval
    score is kept, which is least for the true quantiles (quantile regression of |error|).

    Args:
      pixels: (..., 2) of |error| and the largest predicted change around, mm; rows with NaN are
        left out.
      scale: on |error|: `with_more_pairs`, where the bank was fitted to more than what was tested.

    Returns:
      NaN, NaN where there are no pixels.
    """
    rows = pixels.reshape(-1, 2)
    error, change = rows[np.isfinite(rows).all(1)].T
    if not error.size:
        return float("nan"), float("nan")
    error = scale * error
    best, found = np.inf, (0.0, 0.0)
    for share in SHARES:
        mm = float(np.quantile(error - share * change, COVERED))
        if mm < 0.0:  # an interval would be narrower than nothing where nothing moves
            break
        half = np.maximum(mm + share * change, LEAST_MM)
        score = float((half + np.maximum(error - half, 0.0) / (1.0 - COVERED)).mean())
        if score < best:
            best, found = score, (mm, float(share))
    return found


def coverage(pixels: np.ndarray, spread: tuple[float, float]) -> float:
    """Share of pixels, as `fit_spread` takes them, whose error lies in the interval; NaN: none."""
    rows = pixels.reshape(-1, 2)
    error, change = rows[np.isfinite(rows).all(1)].T
    mm, share = spread
    inside = error <= np.maximum(mm + share * change, LEAST_MM)
    return float(inside.mean()) if inside.size else float("nan")
