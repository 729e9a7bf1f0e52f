"""What the benchmarks of distances bring themselves, against SciPy and POT on small clouds."""

from dataclasses import replace

import numpy as np
import pytest

import jshape
from benchmarks import clouds, metric_memory, metric_peers, ranking
from benchmarks.experiments.ranking import distances
from benchmarks.metric_growth import growth
from jshape.actions import grid
from jshape.planning.options import DEFAULT_BANK

ot = pytest.importorskip("ot")


@pytest.fixture
def pair(rng):
    """Two clouds of different sizes, neither a whole number of blocks."""
    p = rng.normal(size=(metric_peers.BLOCK + 37, 3)).astype(np.float32)
    return p, rng.normal(size=(2 * metric_peers.BLOCK + 5, 3)).astype(np.float32) + np.float32(0.2)


def test_all_with_all_in_blocks_is_chamfer(pair):
    assert float(metric_peers.chamfer(*pair)) == pytest.approx(clouds.chamfer(*pair), rel=1e-5)


def test_far_from_the_origin_it_is_still_chamfer(pair):
    p, q = (0.01 * cloud + np.float32(450) for cloud in pair)
    assert float(metric_peers.chamfer(p, q)) == pytest.approx(clouds.chamfer(p, q), rel=1e-3)


@pytest.mark.parametrize("blur", [1.0, 0.3])
def test_sinkhorn_is_that_of_pot(pair, blur):
    p, q = pair
    way, astray = metric_peers.sinkhorn(p, q, blur, 100)
    cost = ot.dist(p.astype(float), q.astype(float), "euclidean")
    weights = (np.full(len(cloud), 1 / len(cloud)) for cloud in pair)
    plan = ot.bregman.sinkhorn_log(*weights, cost, blur, numItermax=2000, stopThr=1e-10)
    assert float(way) == pytest.approx(float((plan * cost).sum()), rel=1e-4)
    assert float(astray) < 1e-4


def test_sinkhorn_nears_the_earth_mover_as_the_blur_falls(pair):
    p, q = pair[0][:60], pair[1][:60]
    exact = clouds.emd(p, q)
    above = [float(metric_peers.sinkhorn(p, q, blur, 400)[0]) - exact for blur in (1.0, 0.3, 0.02)]
    assert above[0] > above[1] > above[2] > -1e-3 * exact
    assert above[0] > 0.2 * exact and above[2] < 0.02 * exact


def test_growth_is_that_of_the_largest():
    points = [100, 1000, 2000, 4000]
    found = growth(points, [1.0, *(3e-9 * n**2.5 for n in points[1:])])
    assert found.exponent == pytest.approx(2.5)
    assert found.at(190_000) == pytest.approx(3e-9 * 190_000**2.5)
    shuffled = growth([4000, 100, 1000], [4.0, 1.0, 1.0], last=2)
    assert shuffled.exponent == pytest.approx(1.0)


def test_no_growth_of_one_number_of_points():
    with pytest.raises(ValueError, match="no growth"):
        growth([100, 100], [1.0, 2.0])
    with pytest.raises(ValueError, match="no growth"):
        growth([100, 200], [0.0, 2.0])


@pytest.mark.skipif(not metric_memory.available(), reason="this system does not tell")
def test_peaks_are_a_buffer_and_a_matrix(rng):
    images = tuple(rng.uniform(size=(395, 480)).astype(np.float32) for _ in range(2))
    assert 2.4e5 <= metric_memory._peak("d", *images) < images[0].nbytes
    p = rng.normal(size=(1500, 3))
    assert metric_memory._peak("EMD (pot)", p, p + 0.01) > 8 * 1500**2


@pytest.mark.parametrize("name", ["d", "depth difference"])
def test_what_is_compared_is_what_is_ranked(rng, name):
    a, b = (rng.uniform(0.2, 0.8, ranking.CAMERA.shape).astype(np.float32) for _ in range(2))
    quick, slow = (known[name](rng, a, b) for known in (ranking.compared(), distances()))
    assert quick == pytest.approx(slow, rel=1e-4)


@pytest.fixture(scope="module")
def candidates():
    """The two smallest actions: each action compiles anew."""
    bank = jshape.load_bank(DEFAULT_BANK).seen_by(ranking.CAMERA, ranking.BED)
    names = ("pinch", "poke")
    bank = replace(bank, actions=names, predictors=tuple(bank.predictor(name) for name in names))
    return bank, grid(bank.camera, 2, 1, margin=bank.largest_roi)


def task(candidates, applied):
    """A goal that the bank itself predicts of a level bed."""
    image = np.full(ranking.CAMERA.shape, 0.45, np.float32)
    goal = image
    for step in applied:
        goal = ranking.after_each(candidates[0], goal, candidates[1])[step]
    return ranking.Problem(None, None, image, goal, applied, None)  # pyright: ignore


def test_greedy_on_d_finds_what_was_predicted(candidates):
    applied = (("pinch", 1), ("poke", 0))
    found = ranking.search(task(candidates, applied), distances()["d"], *candidates)
    assert found.chosen == applied  # the larger first, and nothing after the last
    assert ranking.retrieved(found.chosen, applied) == 2
    assert ranking.retrieved((("pinch", 0), ("poke", 0)), applied) == 1
    assert len(found.seconds) == len(found.predicting) == 3


def test_greedy_stops_where_nothing_is_nearer(candidates):
    found = ranking.search(task(candidates, ()), lambda *_: 1.0, *candidates)
    assert found.chosen == () and len(found.seconds) == 1
