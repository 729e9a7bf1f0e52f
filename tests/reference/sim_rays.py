"""Plain-NumPy twin of `jshape.sim.render`: walk every ray down in small steps, then bisect."""

import math

import numpy as np


def height_at(height, cell, x, y):
    """Bilinear height at one place (metres from the middle), clamped at the walls; float64."""
    rows, columns = height.shape
    column = min(max(x / cell + (columns - 1) / 2, 0.0), columns - 1.0)
    row = min(max(y / cell + (rows - 1) / 2, 0.0), rows - 1.0)
    j, i = min(int(column), columns - 2), min(int(row), rows - 2)
    a, b = column - j, row - i
    return (
        height[i, j] * (1 - a) * (1 - b)
        + height[i, j + 1] * a * (1 - b)
        + height[i + 1, j] * (1 - a) * b
        + height[i + 1, j + 1] * a * b
    )


def render(height, cell, camera, z_floor, step=0.0005):
    """Depth of the first surface that each pixel's ray meets, metres; no lens.

    The bed goes on as at its wall, so that it hides, but is not seen there.
    """
    height = np.asarray(height, float)
    pose = np.eye(4) if camera.pose is None else np.array(camera.pose)
    depth = np.zeros((camera.height, camera.width))
    top = z_floor - height.max() - step
    for v in range(camera.height):
        for u in range(camera.width):
            x, y = (u - camera.u0) / camera.fx, (v - camera.v0) / camera.fy
            begin, along = (0.0, 0.0, 0.0, 1.0), (x, y, 1.0, 0.0)
            if camera.orthographic:
                begin, along = (x, y, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0)
            begin, along = pose @ begin, pose @ along

            def inside(t, begin=begin, along=along):
                x, y, z, _ = begin + t * along
                return z >= z_floor - height_at(height, cell, x, y)

            first, last = ((z - begin[2]) / along[2] for z in (top, z_floor))
            count = math.ceil((last - first) / step) + 1
            t = next(first + k * step for k in range(count + 1) if inside(first + k * step))
            low, high = t - step, t
            for _ in range(30):
                middle = (low + high) / 2
                low, high = (low, middle) if inside(middle) else (middle, high)
            x, y, _, _ = begin + high * along
            rows, columns = height.shape
            if abs(x) <= columns * cell / 2 and abs(y) <= rows * cell / 2:
                depth[v, u] = high
    return depth
