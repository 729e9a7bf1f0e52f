"""Surfaces whose slopes the material can hold: envelopes of cones on a grid.

A slope counts between a node and its 16 neighbours (steps of one row or column, of both, and of a
knight's move).  Along them a straight path costs at most 2.8 % more than its length, so that no
direction may be more than that too steep.  What the bed holds already it may go on holding: the
limit between two neighbours is the material's or the bed's own drop between them, if that is more.
"""

import numpy as np

from jshape._typing import Float

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1))
"""(rows, columns) to half of the neighbours; the others lie opposite."""


def held(
    bed: Float[np.ndarray, "Y X"], wanted: Float[np.ndarray, "Y X"], steepest: float, cell: float
) -> Float[np.ndarray, "Y X"]:
    """The wanted surface as far as it stands: everywhere between the bed and what is wanted.

    Walls lean inwards from the outline: a hole is first filled up where its walls are too steep
    (the highest of the cones that stand on it, upside down), then a hill is cut down likewise.

    Args:
      bed: heights now, metres.
      wanted: heights wanted, metres.
      steepest: rise over run that stands, above 0.
      cell: side of a cell, metres.

    Returns:
      Heights, metres: no two neighbours differ by more than they may.
    """
    differs = wanted != bed
    if not differs.any():
        return bed.copy()
    # The bed around is within the limit, so its nearest two rows and columns say all of it.
    box = tuple(slice(max(int(k.min()) - 2, 0), int(k.max()) + 3) for k in np.nonzero(differs))
    start, goal = bed[box], wanted[box]
    limits = drops(start, steepest, cell)
    dug = -lower_envelope(-np.minimum(goal, start), limits)
    result = bed.copy()
    stands = lower_envelope(np.where(goal > start, goal, dug), limits)
    # By rounding alone a sum of drops may end beyond what it started from.
    result[box] = np.clip(stands, np.minimum(goal, start), np.maximum(goal, start))
    return result


def drops(bed: Float[np.ndarray, "Y X"], steepest: float, cell: float) -> list[np.ndarray]:
    """Greatest difference in height that each pair of neighbours may have, for each of `STEPS`."""
    return [
        np.maximum(
            np.float32(steepest * cell * np.hypot(*step)), np.abs(np.subtract(*_pair(bed, step)))
        )
        for step in STEPS
    ]


def lower_envelope(
    surface: Float[np.ndarray, "Y X"], limits: list[np.ndarray]
) -> Float[np.ndarray, "Y X"]:
    """The highest surface that is nowhere above `surface` and within the limits everywhere.

    Min-plus passes in place, until nothing sinks any more: a handful on a bed of slopes that
    stand, and as many as a wall reaches cells far otherwise.
    """
    result = surface.copy()
    while True:
        before = result.copy()
        for step, limit in zip(STEPS, limits, strict=True):
            here, there = _pair(result, step)
            np.minimum(here, there + limit, out=here)
            np.minimum(there, here + limit, out=there)
        if np.array_equal(result, before):
            return result


def steepness(height: Float[np.ndarray, "Y X"], cell: float) -> Float[np.ndarray, "Y X"]:
    """Slope (rise over run) of a surface at every node: the steepest to a direct neighbour."""
    result = np.zeros(height.shape, np.float32)
    for step in STEPS[:2]:
        drop = np.abs(np.subtract(*_pair(height, step))) / cell
        for side in _pair(result, step):
            np.maximum(side, drop, out=side)
    return result


def _pair(field: np.ndarray, step: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Views of every node that has a neighbour one step on, and of those neighbours."""
    rows, columns = field.shape
    down, right = step
    left = max(-right, 0)
    here = field[: max(rows - down, 0), left : max(columns - max(right, 0), left)]
    there = field[down:, left + right : left + right + here.shape[1]]
    return here, there
