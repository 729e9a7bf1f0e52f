"""The change around a pixel, pixel by pixel."""

import numpy as np


def around_slowly(change: np.ndarray, radii: tuple[int, int]) -> np.ndarray:
    """The largest |change| so many pixels (u, v) to each side of every pixel; NaN is none."""
    size, found = np.nan_to_num(np.abs(change)), np.zeros_like(change)
    for v, u in np.ndindex(change.shape[-2:]):
        rows = slice(max(0, v - radii[1]), v + radii[1] + 1)
        columns = slice(max(0, u - radii[0]), u + radii[0] + 1)
        found[..., v, u] = size[..., rows, columns].max((-2, -1))
    return found
