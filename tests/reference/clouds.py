"""Distances between point clouds, transcribed with loops; for a handful of points."""

from itertools import permutations

import numpy as np


def nearest(point, cloud):
    """(distance, index) of the point of a cloud that is nearest to one."""
    lengths = [float(np.sqrt(((point - other) ** 2).sum())) for other in cloud]
    index = min(range(len(cloud)), key=lambda k: lengths[k])
    return lengths[index], index


def chamfer(p, q):
    """Mean of both directions."""
    there = sum(nearest(point, q)[0] for point in p) / len(p)
    back = sum(nearest(point, p)[0] for point in q) / len(q)
    return (there + back) / 2


def emd(p, q):
    """The best of all assignments."""
    return min(
        sum(float(np.linalg.norm(a - q[k])) for a, k in zip(p, order, strict=True)) / len(p)
        for order in permutations(range(len(q)))
    )


def icp(p, q, most):
    """Horn's quaternions instead of the SVD; the mean distance after `most` matchings."""
    moved = [point.copy() for point in p]
    for rounds in range(most):
        found = [nearest(point, q) for point in moved]
        mean = sum(length for length, _ in found) / len(p)
        if rounds == most - 1:
            break
        partners = np.array([q[k] for _, k in found])
        middle_p, middle_q = p.mean(0), partners.mean(0)
        s = np.zeros((3, 3))
        for a, b in zip(p, partners, strict=True):
            s += np.outer(a - middle_p, b - middle_q)
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = s
        n = np.array([
            [xx + yy + zz, yz - zy, zx - xz, xy - yx],
            [yz - zy, xx - yy - zz, xy + yx, zx + xz],
            [zx - xz, xy + yx, yy - xx - zz, yz + zy],
            [xy - yx, zx + xz, yz + zy, zz - xx - yy],
        ])  # fmt: skip
        w, x, y, z = np.linalg.eigh(n)[1][:, -1]
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        moved = [turn @ (point - middle_p) + middle_q for point in p]
    return mean
