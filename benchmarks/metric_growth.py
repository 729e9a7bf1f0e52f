"""How time grows with the number of points, from a few measured ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Growth(NamedTuple):
    """seconds = seconds_of_one x points^exponent, by least squares of the logarithms."""

    exponent: float
    seconds_of_one: float

    def at(self, points: float) -> float:
        """Seconds for so many points; beyond what was measured an extrapolation."""
        return self.seconds_of_one * points**self.exponent


def growth(points: Sequence[float], seconds: Sequence[float], last: int = 3) -> Growth:
    """Of the `last` largest numbers of points: small ones show what a call costs anyway.

    Raises:
      ValueError: fewer than two different numbers of points, or a time that is not positive.
    """
    order = np.argsort(points)[-last:]
    at, took = np.asarray(points, float)[order], np.asarray(seconds, float)[order]
    if len(np.unique(at)) < 2 or not (took > 0).all():
        raise ValueError(f"no growth from {list(at)} points that took {list(took)} s")
    exponent, first = np.polyfit(np.log(at), np.log(took), 1)
    return Growth(float(exponent), float(np.exp(first)))
