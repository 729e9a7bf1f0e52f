"""Planes in depth images: the one that most readings lie in, and how far the others are from it.

Of a frame that shows more than the bed, one surface without a step is the bed (`bed_in`).

A plane in space is a plane in inverse depth: a x + b y + c = 1/z along the ray (x, y, 1).
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jshape.camera import Camera
from jshape.errors import BadImage, JShapeError

NEAR = 0.010
"""Readings this near to a plane belong to it, metres."""
LEAST_NEAR = 0.001
"""Metres within which readings always belong to it: more than the steps of counts."""
STEP = 3.0
"""Slope against the image between neighbours beyond which there is a step: 72 degrees, where a bed
tilted by 45 degrees still connects around its heaps."""
FILLS = 0.8
"""Least share of the middle fifth of the view, each way, that a bed among surroundings fills."""
LEAST_SURFACE = 0.1
"""Least share of the readings that are the bed's: a smaller surface is a thing on it, or noise."""
ROUNDS = 8
"""Of fitting a plane to what is near it: the last moves it by less than 0.01 degrees."""
_TRIES = 200
_SAMPLE = 2000


def bed_in(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) readings of the bed: the largest surface without a step, as a bin's floor.

    But the one that fills the middle of the view if it stands above that: a box on a table, a table
    on the floor.  What fills the middle and lies lower is a pit in the bed.
    """
    label = _surfaces(depth, camera)
    rows, columns = (slice(2 * n // 5, n - 2 * n // 5) for n in depth.shape)
    largest, middle = (label == _usual(part) for part in (label, label[rows, columns]))
    share = middle.sum() / max((label >= 0).sum(), 1)
    if (largest & middle).any() or middle[rows, columns].mean() < FILLS or share < LEAST_SURFACE:
        return largest
    plane = fit_plane(np.where(largest, depth, np.nan), camera)
    above = np.median(off_plane(depth, camera, plane)[0][middle]) > 0
    return middle if above else largest


def _usual(label: np.ndarray) -> int:
    """The surface that most of some pixels belong to; -2: none has a reading."""
    return int(np.bincount(label[label >= 0]).argmax()) if (label >= 0).any() else -2


def _surfaces(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) numbers of the surfaces without a step, -1 where there is no reading.

    Neighbours belong together, all eight of them, unless their depths (metres, NaN: none) differ
    by more than `STEP` times what lies between them.
    """
    number = np.arange(depth.size).reshape(depth.shape)
    most = STEP * depth / float(camera.fx)
    left, right, up, down = np.s_[:-1], np.s_[1:], np.s_[:-1], np.s_[1:]
    whole, joined = np.s_[:], []
    for one, other in (
        ((whole, left), (whole, right)), ((up, whole), (down, whole)),
        ((up, left), (down, right)), ((up, right), (down, left)),
    ):  # fmt: skip
        near = np.abs(depth[one] - depth[other]) <= most[one]  # NaN is not
        joined.append(np.stack([number[one][near], number[other][near]]))
    one, other = np.concatenate(joined, 1)
    graph = coo_array((np.ones(one.size, bool), (one, other)), shape=(depth.size,) * 2)
    _, label = connected_components(graph, directed=False)
    return np.where(np.isfinite(depth), label.reshape(depth.shape), -1)


def fit_plane(depth: np.ndarray, camera: Camera, near: float = NEAR) -> np.ndarray:
    """(a, b, c) of the plane that most readings lie in; BadImage if fewer than 100 are there.

    Of many planes through three readings the one with most others within `near` metres is taken
    (walls and table do not pull), then fitted to those.  A reading counts the less the farther it
    is: a table 15 mm lower would else tilt the plane halfway between both by 2 degrees.  At last
    only those within three times what they vary by count (nor do the feet of a heap pull: without,
    20 mm of it tilt a bed by 0.3 degrees).
    """
    there = np.isfinite(depth)
    if there.sum() < 100:
        raise BadImage(f"{int(there.sum())} pixels have a reading; a plane needs 100")
    x, y = (ray[there] for ray in _rays(camera))
    z = depth[there].astype(np.float64)
    terms = np.stack([x, y, np.ones_like(x)], 1)
    rng = np.random.default_rng(0)
    some = rng.choice(len(z), min(len(z), _SAMPLE), replace=False)
    three = np.array([rng.choice(some, 3, replace=False) for _ in range(_TRIES)])
    three = three[np.abs(np.linalg.det(terms[three])) > 1e-15]  # not in a row
    if not len(three):
        raise JShapeError("no plane fits these readings")
    planes = np.linalg.solve(terms[three], 1.0 / z[three][..., None])[..., 0]
    most = [_nearness(_gap(terms[some], z[some], plane), near).sum() for plane in planes]
    best = planes[int(np.argmax(most))]
    for k in range(ROUNDS):
        gap = _gap(terms, z, best)
        if k >= ROUNDS // 2:
            near = min(near, max(3 * 1.48 * float(np.median(gap[gap < near])), LEAST_NEAR))
        # An error of 1/z counts z^2 times as much in z.
        weight = (_nearness(gap, near) * z**2) ** 2
        weighed = weight[:, None] * terms
        best = np.linalg.solve(weighed.T @ terms, weighed.T @ (1.0 / z))
    return best


def _nearness(gap: np.ndarray, near: float) -> np.ndarray:
    """1 of readings in a plane, 0 from `near` metres on: the root of Tukey's biweight."""
    return np.maximum(1.0 - (gap / near) ** 2, 0.0)


def _gap(terms: np.ndarray, z: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Distances of readings from a plane, metres."""
    return np.abs(z * (terms @ plane) - 1.0) / np.linalg.norm(plane)


def off_plane(
    depth: np.ndarray, camera: Camera, plane: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) signed distances in mm from a plane; and (H, W) the plane's own depth, metres."""
    x, y = _rays(camera)
    inverse = plane[0] * x + plane[1] * y + plane[2]
    off = 1e3 * (1.0 - depth * inverse) / np.linalg.norm(plane)
    return off.astype(np.float32), 1.0 / inverse


def _rays(camera: Camera) -> list[np.ndarray]:
    return [np.broadcast_to(ray.astype(float), camera.shape) for ray in camera.rays()]
