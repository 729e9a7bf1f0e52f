"""Planes in depth images: the one that most readings lie in, and how far the others are from it.

A plane in space is a plane in inverse depth: a x + b y + c = 1/z along the ray (x, y, 1).
"""

import numpy as np

from jshape.camera import Camera
from jshape.errors import BadImage, JShapeError

NEAR = 0.010
"""Readings this near to a plane belong to it, metres."""
ROUNDS = 8
"""Of fitting a plane to what is near it: the last moves it by less than 0.01 degrees."""
_TRIES = 200
_SAMPLE = 2000


def fit_plane(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(a, b, c) of the plane that most readings lie in; BadImage if fewer than 100 are there.

    Of many planes through three readings the one with most others near it is taken (walls and
    table do not pull), then fitted to those.  A reading counts the less the farther it is: a table
    15 mm lower would else tilt the plane that lies halfway between both by 2 degrees.
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
    most = [_nearness(terms[some], z[some], plane).sum() for plane in planes]
    best = planes[int(np.argmax(most))]
    for _ in range(ROUNDS):
        # An error of 1/z counts z^2 times as much in z.
        weight = (_nearness(terms, z, best) * z**2) ** 2
        weighed = weight[:, None] * terms
        best = np.linalg.solve(weighed.T @ terms, weighed.T @ (1.0 / z))
    return best


def _nearness(terms: np.ndarray, z: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """1 of readings in a plane, 0 from `NEAR` on: the root of Tukey's biweight."""
    return np.maximum(1.0 - (_gap(terms, z, plane) / NEAR) ** 2, 0.0)


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


def tilt_deg_of(plane: np.ndarray) -> float:
    """The angle of a plane against the image plane, degrees."""
    return float(np.degrees(np.arccos(np.clip(plane[2] / np.linalg.norm(plane), -1.0, 1.0))))
