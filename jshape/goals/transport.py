"""How much material a goal moves from where to where: regions of too much and of too little.

A change of height is cut into the hills and hollows that have to go, and the material of those that
are too high is brought to those that are too low along the least way altogether, a transport
problem.  It is a floor for carries, not a plan: hands take and bring whole handfuls, and poured
material is looser than pressed.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.spatial import distance

from jshape._typing import Float
from jshape.errors import JShapeError
from jshape.goals.bedmap import BedMap

TOLD = 5e-4
"""Changes of less than this, metres, have no area: the noise of one frame is 0.45 mm."""
LEAST_CM3 = 0.05
"""Less than this is not told, cm³."""
SQUARE = 0.005
"""Regions are made of squares of this side, metres: the noise of two frames, 0.64 mm a pixel, is
0.13 mm in one."""
APART = 0.1
"""Hills of one connected region are regions of their own where each is the highest within a square
of this side, metres: about two hands.  They are found in the change blurred by a sixth of it."""
BLOCK = 0.03
"""Material is carried from block to block of this side, metres.  A whole landscape of 500 mm is
solved in 0.3 s; blocks of 20 mm take 2.6 s and change the mean way by a hundredth."""
SIGNS = (-1, 1)
"""Of changes where material is taken, and where it is brought."""


class Region(NamedTuple):
    """A hill of the bed that is too high, or a hollow that is too low."""

    volume_cm3: float
    """That has to be taken or brought."""
    area_cm2: float
    """Seen from above."""
    most_mm: float
    """Greatest change of height."""
    place: tuple[int, int]
    """Pixel (u, v) of the frame where that is."""
    point: tuple[float, float]
    """The same place (x, y) on the map, metres."""


class Flow(NamedTuple):
    """Material that goes from one region to another."""

    volume_cm3: float
    take: Region
    bring: Region
    way_mm: float
    """Mean distance that it is moved by."""


@dataclass(frozen=True)
class Transport:
    """What has to be taken, what has to be brought, and the shortest way to do it."""

    take: tuple[Region, ...]
    """Regions that are too high, largest volume first."""
    bring: tuple[Region, ...]
    """Regions that are too low, largest volume first."""
    carries: tuple[Flow, ...]
    """From region to region, largest volume first; what is left over has no partner."""

    @cached_property
    def take_cm3(self) -> float:
        """Volume that is too much."""
        return math.fsum(region.volume_cm3 for region in self.take)

    @cached_property
    def bring_cm3(self) -> float:
        """Volume that is missing."""
        return math.fsum(region.volume_cm3 for region in self.bring)

    @property
    def stock_cm3(self) -> float:
        """What a stock beside the bed would have to give; below 0 it would have to take."""
        return self.bring_cm3 - self.take_cm3

    @property
    def way_mm(self) -> float | None:
        """Mean distance that carried material is moved by; None: none is carried."""
        carried = sum(one.volume_cm3 for one in self.carries)
        ways = sum(one.volume_cm3 * one.way_mm for one in self.carries)
        return ways / carried if carried else None


def transport(bed: BedMap, change: Float[np.ndarray, "Y X"]) -> Transport:
    """Regions of a wanted change of height, and what is carried between them.

    Args:
      bed: that is changed.
      change: of height, metres, up.

    Returns:
      Where squares of side `SQUARE` change by less than `TOLD` on average is no region.
    """
    squares = _squares(bed, change)
    (take, sources), (bring, sinks) = (_regions(bed, squares, sign) for sign in SIGNS)
    carries = _carries(take, sources, bring, sinks) if take and bring else []
    return Transport(tuple(take), tuple(bring), tuple(carries))


class _Squares(NamedTuple):
    """A change of height, averaged."""

    change: np.ndarray
    """(R, C) metres, up."""
    area: np.ndarray
    """(R, C) square metres; those at the edge are smaller."""
    node: tuple[np.ndarray, np.ndarray]
    """Row (R, 1) and column (1, C) of the map's node in the middle."""
    x: np.ndarray
    """(1, C) metres."""
    y: np.ndarray
    """(R, 1) metres."""
    side: float
    """Of a square, metres."""


class _Parts(NamedTuple):
    """What lies in one region and one square of side `BLOCK`."""

    region: np.ndarray
    """(N,) index of the region."""
    volume: np.ndarray
    """(N,) cm³."""
    point: np.ndarray
    """(N, 2) its middle (x, y), metres."""


def _squares(bed: BedMap, change: np.ndarray) -> _Squares:
    step = max(round(SQUARE / bed.cell), 1)
    rows, columns = (np.arange(0, size, step) for size in change.shape)
    sums = np.add.reduceat(np.add.reduceat(change.astype(float), rows, 0), columns, 1)
    tall, wide = (
        np.diff(starts, append=size)
        for starts, size in zip((rows, columns), change.shape, strict=True)
    )
    counts = tall[:, None] * wide[None]
    node = (rows + tall // 2)[:, None], (columns + wide // 2)[None]
    x, y = bed.axes()
    areas = counts * bed.cell**2
    return _Squares(sums / counts, areas, node, x[node[1]], y[node[0]], step * bed.cell)


def _regions(bed: BedMap, squares: _Squares, sign: int) -> tuple[list[Region], _Parts]:
    """Where the change goes one way: its regions, largest volume first, and their parts."""
    height = np.maximum(sign * squares.change, 0.0)
    coarse = ndimage.gaussian_filter(height, APART / 6 / squares.side)
    coarse *= np.linspace(1.0, 1.0 + 1e-6, coarse.size).reshape(coarse.shape)  # no two are equal
    labels = _hills(height, coarse, round(APART / squares.side))
    index = np.arange(1, labels.max() + 1)
    volumes = 1e6 * np.asarray(ndimage.sum_labels(height * squares.area, labels, index))
    areas = 1e4 * np.asarray(ndimage.sum_labels(squares.area, labels, index))
    most = 1e3 * np.asarray(ndimage.maximum(height, labels, index))
    # In the middle of what is level.
    tops = np.asarray(ndimage.maximum_position(coarse, labels, index))
    u, v = bed.pixels()
    order = np.argsort(-volumes, kind="stable")
    order = order[: np.sum(volumes >= LEAST_CM3)]
    regions = []
    for k in order:
        row, column = tops[k]
        node = squares.node[0][row, 0], squares.node[1][0, column]
        regions.append(
            Region(
                volume_cm3=float(volumes[k]),
                area_cm2=float(areas[k]),
                most_mm=float(most[k]),
                place=(round(float(u[node])), round(float(v[node]))),
                point=(float(squares.x[0, column]), float(squares.y[row, 0])),
            )
        )
    rank = np.zeros(len(index) + 1, int)
    rank[order + 1] = np.arange(1, len(order) + 1)
    return regions, _parts(squares, height * squares.area * 1e6, rank[labels] - 1)


def _hills(height: np.ndarray, coarse: np.ndarray, apart: int) -> np.ndarray:
    """(R, C) label from 1 on of each square's hill; 0: less than `TOLD`."""
    connected = np.zeros(height.shape, int)
    ndimage.label(height > TOLD, output=connected)
    tops = coarse == ndimage.maximum_filter(coarse, apart)
    labels = np.zeros(height.shape, int)
    for k in range(1, connected.max() + 1):
        inside = np.argwhere(connected == k)
        mine = np.argwhere((connected == k) & tops)
        nearest = distance.cdist(inside, mine).argmin(1) if len(mine) else 0
        labels[tuple(inside.T)] = labels.max() + 1 + np.unique(nearest, return_inverse=True)[1]
    return labels


def _parts(squares: _Squares, volume: np.ndarray, region: np.ndarray) -> _Parts:
    """Of the volume (R, C) in each region; -1 is none."""
    inside = region >= 0
    where = [np.broadcast_to(axis, region.shape)[inside] for axis in (squares.x, squares.y)]
    keys = np.stack([region[inside], *(np.floor(axis / BLOCK).astype(int) for axis in where)])
    found, part = np.unique(keys, axis=1, return_inverse=True)
    held, *sums = (np.bincount(part.ravel(), volume[inside] * by) for by in (1.0, *where))
    return _Parts(found[0], held, np.stack(sums, 1) / held[:, None])


def _carries(take: list[Region], sources: _Parts, bring: list[Region], sinks: _Parts) -> list[Flow]:
    """The transport problem over blocks, its solution summed over pairs of regions."""
    from scipy.optimize import linprog  # 0.2 s, which goals without carries do not need

    ways = distance.cdist(sources.point, sinks.point)
    count, other = ways.shape
    leaving = sparse.kron(sparse.eye_array(count), np.ones((1, other)), format="csr")
    arriving = sparse.kron(np.ones((1, count)), sparse.eye_array(other), format="csr")
    # The lesser side goes whole, of the other as much as that takes.
    whole, part = (leaving, sources), (arriving, sinks)
    if sources.volume.sum() > sinks.volume.sum():
        whole, part = part, whole
    solved = linprog(
        ways.ravel(), A_eq=whole[0], b_eq=whole[1].volume, A_ub=part[0], b_ub=part[1].volume
    )
    if solved.x is None:
        raise JShapeError(f"the transport of material cannot be solved: {solved.message}")
    moved = solved.x.reshape(ways.shape)
    found = []
    for a, first in enumerate(take):
        for b, second in enumerate(bring):
            pair = np.ix_(sources.region == a, sinks.region == b)
            volume = float(moved[pair].sum())
            if volume > 0:
                way = 1e3 * float((moved[pair] * ways[pair]).sum()) / volume
                found.append(Flow(volume, first, second, way))
    return sorted(found, key=lambda one: -one.volume_cm3)
