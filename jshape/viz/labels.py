"""Labels on an image that do not hide each other."""

import numpy as np
from matplotlib.axes import Axes

Box = tuple[float, float, float, float]
"""Left, top, right and bottom, pixels of the image."""


class Room:
    """Where labels are on an image, so that the next one lies beside them."""

    def __init__(self, ax: Axes, size: float):
        """For text of `size` points."""
        (x0, _), (x1, _) = ax.transData.transform([(0, 0), (1, 0)])
        self._point = ax.figure.dpi / 72 / (x1 - x0)  # in pixels of the image
        self._size = size
        (left, right), (bottom, top) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
        self._inside = left, bottom, right, top
        self._taken: list[Box] = []

    def take(self, u: float, v: float) -> None:
        """Keep the mark at (u, v) free."""
        reach = 0.3 * self._size * self._point
        self._taken.append((u - reach, v - reach, u + reach, v + reach))

    def beside(self, u: float, v: float, text: str) -> tuple[float, float]:
        """The middle of the free place for a text that is nearest to (u, v)."""
        w = (0.72 * self._size * len(text) + 5) * self._point
        h = (1.1 * self._size + 5) * self._point
        best, least = (u, v), np.inf
        for far in range(1, 9):  # rings around the mark, ever wider
            for turn in np.arange(0, 2 * np.pi, np.pi / (4 * far)):
                x = u + far * (w / 2 + self._size * self._point / 2) * np.cos(turn - np.pi / 2)
                y = v + far * h * np.sin(turn - np.pi / 2)
                box = x - w / 2, y - h / 2, x + w / 2, y + h / 2
                hidden = sum(_overlap(box, other) for other in self._taken)
                hidden += w * h - _overlap(box, self._inside)
                if hidden < least - 1e-6:
                    best, least = (x, y), hidden
            if least <= 1e-6:
                break
        x, y = best
        self._taken.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2))
        return x, y


def _overlap(one: Box, other: Box) -> float:
    """Area that two boxes (left, top, right, bottom) share."""
    across = min(one[2], other[2]) - max(one[0], other[0])
    down = min(one[3], other[3]) - max(one[1], other[1])
    return max(across, 0.0) * max(down, 0.0)
