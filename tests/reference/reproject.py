"""What one camera would have seen of what another saw: dense marching and bisection, in float64."""

import numpy as np

STEP = 0.00025
"""Metres between two places of a ray that are looked at."""
FLATTEST = 7.1
"""Degrees between a line of sight and a patch of four readings: less is an edge, no surface."""


def matrix(camera):
    return np.eye(4) if camera.pose is None else np.array(camera.pose, float)


def shown(camera, points):
    """Columns, rows and depths of points (..., 3) of the camera's frame."""
    x, y, z = np.moveaxis(points, -1, 0)
    if not camera.orthographic:
        x, y = x / z, y / z
    if camera.lens is not None:
        k1, k2, p1, p2, k3, k4, k5, k6 = camera.lens
        r = np.sqrt(x**2 + y**2)
        grown = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
        x, y = (
            x * grown + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
            y * grown + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
        )
    return camera.fx * x + camera.u0, camera.fy * y + camera.v0, z


def sight(camera):
    """Where each pixel's line of sight begins and where it goes, (H, W, 3) of the camera's frame.

    What a lens does is undone by Newton's method with differences.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    x, y = (u - camera.u0) / camera.fx, (v - camera.v0) / camera.fy
    if camera.orthographic:
        return np.stack([x, y, 0 * x], -1), np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3))
    if camera.lens is not None:
        for _ in range(10):

            def off(x, y):
                back = shown(camera, np.stack([x, y, np.ones_like(x)], -1))
                return np.stack([back[0] - u, back[1] - v], -1)

            here, d = off(x, y), 1e-6
            slope = np.stack([off(x + d, y) - here, off(x, y + d) - here], -1) / d
            step = np.linalg.solve(slope, here[..., None])[..., 0]
            x, y = x - step[..., 0], y - step[..., 1]
    return np.zeros((*x.shape, 3)), np.stack([x, y, np.ones_like(x)], -1)


def patch(depth, u, v):
    """Row and column of the first of the four readings around a place, and where it lies in them.

    A pixel reaches half a pixel beyond its centre, at its own depth; -1 is beyond that.
    """
    rows, columns = depth.shape
    known = np.isfinite(u) & np.isfinite(v)
    known &= (u >= -0.5) & (u <= columns - 0.5) & (v >= -0.5) & (v <= rows - 0.5)
    u = np.clip(np.where(known, u, 0), 0, columns - 1)
    v = np.clip(np.where(known, v, 0), 0, rows - 1)
    column, row = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
    return np.where(known, row, -1), column, v - row, u - column


def gap(depth, camera, points):
    """How far points lie before the surface that a camera saw, along its axis; NaN: unknown."""
    u, v, z = shown(camera, points)
    i, j, a, b = patch(depth, u, v)
    surface = (
        depth[i, j] * (1 - a) * (1 - b)
        + depth[i, j + 1] * (1 - a) * b
        + depth[i + 1, j] * a * (1 - b)
        + depth[i + 1, j + 1] * a * b
    )
    return np.where((i >= 0) & (z > 0), surface - z, np.nan)


def faces(depth, camera, points):
    """Whether the patch of readings around each point is turned enough to the camera."""
    u, v, _ = shown(camera, points)
    i, j, *_ = patch(depth, u, v)
    begin, along = sight(camera)
    cloud = begin + depth[..., None] * along
    normal = np.cross(cloud[i + 1, j + 1] - cloud[i, j], cloud[i + 1, j] - cloud[i, j + 1])
    ray = along[i, j] + along[i + 1, j + 1]
    lengths = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
    return np.abs((normal * ray).sum(-1)) > np.sin(np.radians(FLATTEST)) * lengths


def reproject(depth, source, target, span):
    """The target's depth image; NaN where the first thing that a ray meets is not seen."""
    depth = np.asarray(depth, float)
    to_source = np.linalg.inv(matrix(source)) @ matrix(target)
    begin, along = sight(target)
    begin, along = begin @ to_source[:3, :3].T + to_source[:3, 3], along @ to_source[:3, :3].T

    def left(t):
        return gap(depth, source, begin + t[..., None] * along)

    low = np.full(target.shape, np.nan)
    before = np.full(target.shape, np.nan)
    for t in np.arange(span[0], span[1] + STEP, STEP):
        now = left(np.full(target.shape, t))
        through = np.isnan(low) & (before > 0) & (now <= 0)
        low[through] = t - STEP
        before = now
    high = low + STEP
    for _ in range(40):
        middle = (low + high) / 2
        front = left(middle) > 0
        low, high = np.where(front, middle, low), np.where(front, high, middle)
    met = np.isfinite(low)
    seen = met & faces(depth, source, begin + np.where(met, low, 1.0)[..., None] * along)
    return np.where(seen, low, np.nan)
