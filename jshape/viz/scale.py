"""From which height to which the scale of a picture goes."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_erosion

LEAST_SPAN = 5.0
"""Least range of heights on a grey scale, mm."""
RIM = 10
"""Nearer than so many pixels to what nobody saw, heights set no scale: walls of the bin of a real
SR300 are 156 mm high there, the bed in it 34 mm."""


def span(heights: Sequence[np.ndarray]) -> tuple[float, float]:
    """Black and white of a grey scale of heights, mm (NaN: not seen).

    All are between them but single pixels, and what lies at the rim of what was seen (`RIM`); noise
    is no relief; and a level bed, which is the highest there is, is light grey, not the white of
    the paper.
    """
    low, high = extremes(heights)
    more = max(LEAST_SPAN - (high - low), 0.0) / 2
    return low - more, high + more + 0.2 * (high - low + 2 * more)


def extremes(fields: Sequence[np.ndarray]) -> tuple[float, float]:
    """Least and most of fields (H, W; NaN: not seen), without single pixels and rims."""
    values = []
    for field in fields:
        known = np.isfinite(field)
        inner = np.array(binary_erosion(known, iterations=RIM, border_value=1), bool)
        values.append(np.asarray(field)[inner if inner.any() else known])
    low, high = np.percentile(np.concatenate(values), (0.02, 99.98))
    return float(low), float(high)
