"""Where the material of a heap comes to lie, by bisection in float64."""

import numpy as np

from jshape.models.imprint_change import NO_HEAP, SOFT


def heaped(predictor, relief, volume):
    """Height of what is heaped on a relief (rows, columns), metres, of a volume in metres·nodes."""
    maps = (predictor.flow, predictor.height, predictor.rise)
    flow, height, rise = (np.asarray(one, np.float64) for one in maps)
    low, high = -0.05, 0.1
    for _ in range(60):
        level = (low + high) / 2
        reach = flow * np.asarray(relief, np.float64) + height - NO_HEAP + rise * level
        laid = SOFT * np.logaddexp(0.0, reach / SOFT)
        low, high = (level, high) if laid.sum() < volume else (low, level)
    return laid
