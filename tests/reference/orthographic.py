"""The ground below a ROI with loops over nodes, pixels and planes, in float64."""

import numpy as np

LEVELS = 12
LEAST_RANGE = 1e-3


def _bilinear(image, row, column):
    n, m = image.shape
    row, column = min(max(row, 0.0), n - 1.0), min(max(column, 0.0), m - 1.0)
    i, j = min(int(row), n - 2), min(int(column), m - 2)
    a, b = row - i, column - j
    top = (1 - b) * image[i, j] + b * image[i, j + 1]
    return (1 - a) * top + a * ((1 - b) * image[i + 1, j] + b * image[i + 1, j + 1])


def _meet(surface_at, nearest, farthest):
    """Depth where a line first meets a surface: walk down plane by plane."""
    planes = np.linspace(nearest - LEAST_RANGE / 2, farthest + LEAST_RANGE / 2, LEVELS)
    gap = surface_at(planes[0]) - planes[0]
    for upper, lower in zip(planes[:-1], planes[1:], strict=True):
        here = surface_at(lower) - lower
        if gap > 0 >= here:
            return upper + (lower - upper) * gap / (gap - here)
        gap = here
    return farthest


def nodes(ground, corner):
    """x of the columns and y of the rows, metres."""
    camera, (w, h), (rows, columns) = ground.camera, ground.roi, ground.shape
    x0 = (corner[0] + w // 2 - camera.u0) / camera.fx * float(ground.depth)
    y0 = (corner[1] + h // 2 - camera.v0) / camera.fy * float(ground.depth)
    pitch = float(ground.pitch)
    x = [x0 + (j - columns // 2) * pitch for j in range(columns)]
    y = [y0 + (i - rows // 2) * pitch for i in range(rows)]
    return x, y


def from_roi(ground, depth, corner):
    """Surface below each node."""
    camera, (x, y) = ground.camera, nodes(ground, corner)
    found = np.zeros(ground.shape)
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):

            def at(z, i=i, j=j):
                v = camera.fy * y[i] / z + camera.v0 - corner[1]
                u = camera.fx * x[j] / z + camera.u0 - corner[0]
                return _bilinear(depth, v, u)

            found[i, j] = _meet(at, depth.min(), depth.max())
    return found


def to_roi(ground, surface, corner):
    """Depth of each pixel."""
    camera, (x, y), (w, h) = ground.camera, nodes(ground, corner), ground.roi
    pitch = float(ground.pitch)
    found = np.zeros((h, w))
    for v in range(h):
        for u in range(w):

            def at(z, v=v, u=u):
                row = ((corner[1] + v - camera.v0) / camera.fy * z - y[0]) / pitch
                column = ((corner[0] + u - camera.u0) / camera.fx * z - x[0]) / pitch
                return _bilinear(surface, row, column)

            found[v, u] = _meet(at, surface.min(), surface.max())
    return found
