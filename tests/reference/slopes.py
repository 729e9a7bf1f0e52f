"""Surfaces that stand, by Dijkstra's search over the nodes of a grid; for a small one."""

import heapq
import math

NEIGHBOURS = [
    (i, j) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0) and math.gcd(i, j) == 1
]
"""The 16 nodes whose direction no nearer node has."""


def limit(bed, a, b, steepest, cell):
    """The greatest difference in height that two neighbours may have."""
    drop = abs(float(bed[a]) - float(bed[b]))
    return max(steepest * cell * math.hypot(a[0] - b[0], a[1] - b[1]), drop)


def neighbours(bed, node):
    """Those that are on the grid."""
    for i, j in NEIGHBOURS:
        other = node[0] + i, node[1] + j
        if 0 <= other[0] < bed.shape[0] and 0 <= other[1] < bed.shape[1]:
            yield other


def lowered(surface, bed, steepest, cell):
    """Every height cut down to the lowest cone that stands on another: nodes in rising order."""
    height = {
        (i, j): float(surface[i, j]) for i in range(len(surface)) for j in range(len(surface[0]))
    }
    queue = [(h, node) for node, h in height.items()]
    heapq.heapify(queue)
    while queue:
        h, node = heapq.heappop(queue)
        if h > height[node]:
            continue
        for other in neighbours(bed, node):
            reach = h + limit(bed, node, other, steepest, cell)
            if reach < height[other]:
                height[other] = reach
                heapq.heappush(queue, (reach, other))
    result = surface.copy()
    for node, h in height.items():
        result[node] = h
    return result


def held(bed, wanted, steepest, cell):
    """Holes filled up to what stands, then hills cut down to it."""
    dug = bed.copy()
    for node, _ in _nodes(bed):
        dug[node] = min(wanted[node], bed[node])
    dug = -lowered(-dug, bed, steepest, cell)
    both = dug.copy()
    for node, _ in _nodes(bed):
        if wanted[node] > bed[node]:
            both[node] = wanted[node]
    return lowered(both, bed, steepest, cell)


def _nodes(field):
    for i in range(field.shape[0]):
        for j in range(field.shape[1]):
            yield (i, j), field[i, j]
