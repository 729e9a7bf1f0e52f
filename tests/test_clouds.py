"""Chamfer, the earth mover's distance and ICP against loops over a handful of points."""

import numpy as np
import pytest

from benchmarks import clouds
from jshape.errors import BadImage, UnknownName
from tests.reference import clouds as slow

TREES = clouds.installed(clouds.TREES)
MOVERS = clouds.installed(clouds.MOVERS)


@pytest.fixture
def pair(rng):
    """Two small clouds of different points."""
    return rng.normal(size=(7, 3)), rng.normal(size=(7, 3))


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_chamfer_is_the_mean_of_both_ways_to_the_nearest_point(pair, rng, tree, kind):
    p, q = (cloud.astype(kind) for cloud in (pair[0], rng.normal(size=(11, 3))))
    assert clouds.chamfer(p, q, tree) == pytest.approx(slow.chamfer(p, q), rel=1e-5)


@pytest.mark.parametrize("mover", MOVERS)
def test_the_earth_mover_finds_the_cheapest_of_all_assignments(pair, mover):
    p, q = pair
    assert clouds.emd(p, q, mover) == pytest.approx(slow.emd(p, q), rel=1e-6)


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("most", [1, 2, 5])
def test_icp_goes_the_way_of_the_loops(rng, tree, most):
    p = rng.normal(size=(15, 3))
    q = p + rng.normal(scale=0.2, size=p.shape)
    found = clouds.icp(p, q, tree, most=most, tolerance=-np.inf)
    assert found.rounds == most
    assert found.distance == pytest.approx(slow.icp(p, q, most), rel=1e-5)


def test_icp_finds_a_small_motion(rng):
    p = rng.uniform(-1, 1, (200, 3))
    angle = 0.05
    turn = np.array([
        [np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]
    ])  # fmt: skip
    q = p @ turn.T + (0.01, -0.02, 0.03)
    found = clouds.icp(p, q, most=50)
    assert 1 < found.rounds < 50 and found.distance < 1e-6
    np.testing.assert_allclose(found.rotation, turn, atol=1e-6)
    np.testing.assert_allclose(found.translation, (0.01, -0.02, 0.03), atol=1e-6)


def test_icp_never_mirrors(rng):
    p = rng.normal(size=(30, 3))
    rotation, _ = clouds.rigid(p, p * (1, 1, -1))
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize("count", [1, 10, 500, 12 * 17])
def test_spread_pixels_are_about_as_many_as_asked_for(count):
    found = clouds.spread((120, 170), count)
    assert len(np.unique(found)) == len(found) and found.max() < 120 * 170
    assert 0.7 * count <= len(found) <= 1.4 * count


def test_what_is_no_cloud_is_refused(pair):
    p, q = pair
    for bad in (p[:0], np.full((3, 3), np.nan)):
        with pytest.raises(BadImage):
            clouds.chamfer(bad, q)
    with pytest.raises(BadImage, match="7 points to 5"):
        clouds.emd(p, q[:5])
    with pytest.raises(UnknownName, match="scipy"):
        clouds.chamfer(p, q, "flann")
