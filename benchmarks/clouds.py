"""What others measure between point clouds: Chamfer, the earth mover's distance, ICP.  Yardsticks.

Nothing in jshape plans or learns with these; they are here to be compared with `metric.distance`.
Clouds are (P, 3) in one unit, which the distances have too.
"""

import importlib
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from jshape._typing import Float, Int, Num
from jshape.errors import BadImage, UnknownName

PACKAGES = {"scipy": "scipy", "pykdtree": "pykdtree", "pot": "ot"}
"""What finds neighbours or transports, and the module that has to be installed for it."""
TREES = ("scipy", "pykdtree")
"""Packages that find nearest neighbours."""
MOVERS = ("scipy", "pot")
"""Packages that find the cheapest transport."""
PIVOTS = 10_000_000
"""Most steps of POT's network simplex: more than a few thousand points need."""


class Matching(NamedTuple):
    """Where ICP ended."""

    distance: float
    """Mean distance of the matched points."""
    rotation: np.ndarray
    """(3, 3), applied to the moving cloud."""
    translation: np.ndarray
    """(3,), added after the rotation."""
    rounds: int
    """Matchings that were made."""


def installed(names: tuple[str, ...]) -> tuple[str, ...]:
    """Those of some packages that are here."""
    return tuple(name for name in names if find_spec(PACKAGES[name]) is not None)


def neighbours(
    cloud: Num[np.ndarray, "P 3"], tree: str = "scipy"
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """A search for the nearest points of a cloud: (Q, 3) -> their distances (Q,), indices (Q,).

    Raises:
      UnknownName: `tree` is none of `TREES`, or not installed.
      BadImage: not a cloud of finite points.
    """
    _known("package for neighbours", tree, TREES)
    _check(cloud)
    if tree == "scipy":
        return KDTree(cloud).query  # pyright: ignore[reportReturnType]
    # Its queries must be of the same type as its points.
    kdtree = _module(tree, ".kdtree").KDTree(np.ascontiguousarray(cloud))
    return lambda points: kdtree.query(np.ascontiguousarray(points, cloud.dtype))


def chamfer(p: Num[np.ndarray, "P 3"], q: Num[np.ndarray, "Q 3"], tree: str = "scipy") -> float:
    """Chamfer distance: to the nearest point of the other cloud, mean of both directions.

    Raises:
      UnknownName, BadImage: as for `neighbours`.
    """
    to_q, to_p = neighbours(q, tree), neighbours(p, tree)
    there, back = to_q(p)[0], to_p(q)[0]
    return float(there.mean(dtype=np.float64) + back.mean(dtype=np.float64)) / 2


def emd(p: Num[np.ndarray, "P 3"], q: Num[np.ndarray, "Q 3"], mover: str = "scipy") -> float:
    """Earth mover's distance: the least mean way of moving one cloud onto the other, exactly.

    All points of a cloud weigh the same.  Memory grows with P x Q, time faster.

    Args:
      p: a cloud.
      q: another; with "scipy" of as many points.
      mover: "scipy" (an assignment) or "pot" (a network simplex).

    Raises:
      UnknownName: `mover` is none of `MOVERS`, or not installed.
      BadImage: not clouds of finite points, or of different numbers of them for an assignment.
    """
    _known("package for transport", mover, MOVERS)
    _check(p)
    _check(q)
    cost = cdist(p, q)
    if mover == "scipy":
        if len(p) != len(q):
            raise BadImage(f"an assignment of {len(p)} points to {len(q)}; expected as many")
        return float(cost[linear_sum_assignment(cost)].mean())
    weights = (np.full(len(cloud), 1 / len(cloud)) for cloud in (p, q))
    return float(_module(mover).emd2(*weights, cost, numItermax=PIVOTS))


def icp(
    p: Num[np.ndarray, "P 3"],
    q: Num[np.ndarray, "Q 3"],
    tree: str = "scipy",
    *,
    most: int = 20,
    tolerance: float = 1e-4,
) -> Matching:
    """Point-to-point ICP: match the nearest points, move the first cloud rigidly, again.

    Args:
      p: the cloud that moves.
      q: the cloud that stays.
      tree: finds the neighbours.
      most: rounds of matching, at least 1.
      tolerance: stop when the mean squared distance falls by less than this share.

    Raises:
      UnknownName, BadImage: as for `neighbours`.
    """
    _check(p)
    nearest, still = neighbours(q, tree), np.asarray(q, np.float64)
    start = np.asarray(p, np.float64)
    moving, rotation, translation = start, np.eye(3), np.zeros(3)
    before, rounds = float("inf"), 0
    while True:
        length, index = nearest(moving.astype(q.dtype))
        length, rounds = length.astype(np.float64), rounds + 1
        square = float((length**2).mean())  # what each round lowers
        if rounds >= most or square >= (1 - tolerance) * before:
            return Matching(float(length.mean()), rotation, translation, rounds)
        before = square
        rotation, translation = rigid(start, still[index])
        moving = start @ rotation.T + translation


def rigid(
    p: Float[np.ndarray, "P 3"], q: Float[np.ndarray, "P 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """The rotation and translation that bring points onto their partners, in least squares."""
    middle_p, middle_q = p.mean(0), q.mean(0)
    u, _, vt = np.linalg.svd((p - middle_p).T @ (q - middle_q))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ turn @ u.T
    return rotation, middle_q - rotation @ middle_p


def drawn(
    rng: np.random.Generator, cloud: Num[np.ndarray, "P 3"], count: int
) -> Num[np.ndarray, "N 3"]:
    """`count` different points of a cloud (all, if it has no more), at random."""
    return cloud[rng.permutation(len(cloud))[:count]]


def spread(shape: tuple[int, int], count: int) -> Int[np.ndarray, "N"]:
    """Flat indices of about `count` pixels of an (H, W) image, on an even grid."""
    height, width = shape
    step = (height * width / count) ** 0.5
    rows, columns = (
        np.unique(np.linspace(0, n - 1, max(1, round(n / step))).round().astype(int))
        for n in (height, width)
    )
    return (rows[:, None] * width + columns).reshape(-1)


def _check(cloud: np.ndarray) -> None:
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) == 0:
        raise BadImage(f"a point cloud has shape {cloud.shape}; expected (P, 3)")
    if not np.isfinite(cloud).all():
        raise BadImage("a point cloud with points that are not finite; leave them out")


def _known(what: str, name: str, names: tuple[str, ...]) -> None:
    if name not in (allowed := installed(names)):
        raise UnknownName(what, name, allowed)


def _module(name: str, inside: str = "") -> Any:
    return importlib.import_module(PACKAGES[name] + inside)
