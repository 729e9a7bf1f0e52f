"""f_C, f_CR, f_DC, f_DCR: three parts and how they are put together, against plain NumPy."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jshape
from jshape import PAPER_BOX, Bank, Pairs, load_bank, save_bank
from jshape.data.pairs import Examples
from jshape.errors import BadBank, BadDataset, JShapeError
from jshape.learn.fit import fit
from jshape.learn.networks import changed_most, refine
from jshape.learn.scores import roi_errors_mm
from jshape.learn.settings import Training
from jshape.models import unet
from jshape.models.difference import Difference
from jshape.models.network import Network
from jshape.models.refined import Refined
from jshape.models.sequential import Sequential
from jshape.planning.evaluate import candidates_at, sweep
from jshape.planning.state import search_state

W, H = 20, 18
PLACE = jnp.zeros(2, jnp.int32)
QUICK = {"width": 2, "epochs": 3, "batch": 4, "learning_rate": 3e-3}


def network(seed=0):
    return Network(unet.init(jax.random.key(seed), 2), (W, H))


@pytest.fixture
def delta(rng):
    """A pit with a small rim, and noise."""
    v, u = np.mgrid[:H, :W]
    pit = -0.3 * np.exp(-(((u - 9) / 4) ** 2) - ((v - 8) / 4) ** 2)
    return (pit + 0.01 * rng.normal(size=(H, W))).astype(np.float32)


@pytest.fixture
def parts(delta):
    first = Difference(jnp.asarray(delta))
    mask = jnp.asarray(changed_most(delta, "erode"), jnp.float32)
    offset = jnp.asarray(0.04, jnp.float32)
    inside = Sequential(first, network(1))
    return {
        "C": network(),
        "CR": Refined(network(), first, mask, offset),
        "DC": inside,
        "DCR": Refined(inside, first, mask, offset),
    }


@pytest.fixture
def examples(rng, delta):
    prior = (0.5 + 0.1 * rng.random((7, H, W))).astype(np.float32)
    depth = rng.uniform(0.7, 1.3, (7, 1, 1)).astype(np.float32)
    return Examples(prior, prior + depth * delta, np.zeros((7, 2), np.int32))


def drawn(params, images):
    return np.asarray(jax.jit(unet.apply)(params, jnp.asarray(images)))


@pytest.mark.full
def test_the_kinds_are_the_papers_equations(parts, delta, examples):
    roi = examples.prior
    call = jax.jit(lambda predictor, roi: predictor(roi, PLACE))
    of_c, of_dc = drawn(network().params, roi), drawn(network(1).params, roi + delta)
    b = np.asarray(parts["CR"].mask)
    assert 0 < b.sum() < b.size
    expected = {
        "C": of_c,
        "CR": b * (of_c + np.float32(0.04)) + (1 - b) * (roi + delta),
        "DC": of_dc,
        "DCR": b * (of_dc + np.float32(0.04)) + (1 - b) * (roi + delta),
    }
    for kind, predictor in parts.items():
        assert predictor.roi == (W, H)
        np.testing.assert_allclose(call(predictor, roi), expected[kind], atol=2e-6)
    # One ROI, of the kind that is made of all parts: every shape is compiled for itself.
    np.testing.assert_allclose(call(parts["DCR"], roi[2]), expected["DCR"][2], atol=2e-6)


@pytest.mark.full
@pytest.mark.parametrize("kind", ["DCR", pytest.param("C", marks=pytest.mark.slow)])
def test_strength_scales_the_change(parts, examples, kind):
    call = jax.jit(lambda roi, s: parts[kind](roi, PLACE, s))
    roi = jnp.asarray(examples.prior[:3])
    whole = call(roi, 1.0) - roi
    strengths = jnp.array([0.0, 0.5, 2.0])
    change = call(roi, strengths) - roi
    np.testing.assert_allclose(change, strengths[:, None, None] * whole, atol=2e-6)


@pytest.mark.full
@pytest.mark.parametrize("kind", ["CR", pytest.param("DC", marks=pytest.mark.slow)])
def test_a_missing_pixel_stays_one_and_spoils_no_other(parts, examples, kind):
    call = jax.jit(lambda roi: parts[kind](roi, PLACE))
    roi = examples.prior[0].copy()
    roi[3, 4] = np.nan
    found = np.asarray(call(roi))
    assert np.isnan(found[3, 4]) and np.isnan(found).sum() == 1
    roi[3, 4] = np.nanmean(roi)  # what the network sees there
    again = np.asarray(call(roi))
    same = np.isfinite(found)
    if kind in ("C", "CR"):
        np.testing.assert_allclose(found[same], again[same], atol=1e-6)
    assert np.isfinite(call(np.full((H, W), 0.5, np.float32))).all()
    assert np.isnan(call(np.full((H, W), np.nan, np.float32))).all()


@pytest.mark.full
def test_the_planner_sweeps_a_network(parts):
    bank = Bank(PAPER_BOX, (parts["CR"], Difference(jnp.zeros((9, 11)))), ("press", "tap"), "CR")
    image = np.full(PAPER_BOX.shape, 0.5, np.float32)
    goal = image + 0.01
    places = {name: np.array([[100, 90], [240, 197]]) for name in bank.actions}
    state = search_state(bank, jnp.asarray(image), jnp.asarray(goal))
    found = np.concatenate(sweep(state, candidates_at(state, bank, places)))[:, 0] * image.size
    one = np.asarray(bank.predict("press", image[:H, :W]))
    change = np.abs(one - goal[:H, :W]).sum() - 0.01 * H * W
    np.testing.assert_allclose(found, [change, change, 0, 0], rtol=1e-3, atol=2e-3)


def otsu_by_definition(size):
    """The threshold of the largest variance between the two classes, over all of them."""
    best, at = -1.0, 0.0
    for level in np.unique(size)[:-1]:
        low = size <= level
        between = low.mean() * (1 - low.mean()) * (size[low].mean() - size[~low].mean()) ** 2
        if between > best:
            best, at = between, level
    return size > at


@pytest.mark.full
def test_b_is_otsus_threshold_eroded(delta):
    over = otsu_by_definition(np.abs(delta)).astype(np.uint8)
    square = np.ones((3, 3), np.uint8)
    np.testing.assert_array_equal(changed_most(delta, "erode"), cv2.erode(over, square) > 0)
    np.testing.assert_array_equal(changed_most(-delta, "erode"), changed_most(delta, "erode"))
    big = cv2.resize(delta, (183, 183), interpolation=cv2.INTER_CUBIC)
    grown, shrunk = changed_most(big, "dilate"), changed_most(big, "erode")
    assert shrunk.sum() < otsu_by_definition(np.abs(big)).sum() < grown.sum()
    assert not changed_most(np.zeros((H, W), np.float32), "erode").any()


@pytest.mark.full
def test_mu_makes_the_means_alike(delta, examples):
    outside = Difference(jnp.asarray(delta))
    for inside in (network(), Sequential(outside, network())):
        found = refine(inside, outside, examples, Training(batch=3))
        b = np.asarray(found.mask) > 0
        refined = np.asarray(found(jnp.asarray(examples.prior), PLACE))
        rough = examples.prior + delta
        assert abs(float(found.offset)) > 0.01
        np.testing.assert_allclose(refined[:, b].mean(), rough[:, b].mean(), atol=1e-6)
        np.testing.assert_array_equal(refined[:, ~b], rough[:, ~b])
    holed = examples._replace(prior=examples.prior.copy())
    holed.prior[2, 5:9, 4:9] = np.nan
    assert np.isfinite(refine(network(), outside, holed, Training(batch=3)).offset)


@pytest.mark.full
def test_an_empty_b_leaves_the_mean_difference(examples):
    outside = Difference(jnp.full((H, W), 0.1))  # changed alike everywhere: nothing stands out
    spot = np.zeros((H, W), np.float32)
    spot[4, 4] = 0.5  # one pixel, which erosion removes
    for difference in (Difference(jnp.asarray(spot)), Difference(jnp.zeros((H, W)))):
        found = refine(network(), difference, examples, Training())
        assert float(found.offset) == 0.0 and not np.asarray(found.mask).any()
        expected = examples.prior + np.asarray(difference.delta)
        np.testing.assert_array_equal(found(jnp.asarray(examples.prior), PLACE), expected)
    assert np.isfinite(refine(network(), outside, examples, Training()).offset)


@pytest.fixture
def pairs(rng):
    """Eight pits of one action in the paper's box, on beds of different heights."""
    count, (h, w), unit = 8, PAPER_BOX.shape, 1e-5
    level = rng.integers(43800, 44500, count)
    prior = np.broadcast_to(level[:, None, None], (count, h, w)).astype(np.uint16)
    posterior = prior.copy()
    centre = np.stack([rng.integers(60, 420, count), rng.integers(60, 330, count)], -1)
    for k, (u, v) in enumerate(centre):
        posterior[k, v - 5 : v + 5, u - 6 : u + 6] += np.uint16(rng.integers(300, 900))
    return Pairs(
        camera=PAPER_BOX, depth_unit=unit, prior=prior, posterior=posterior,
        action=np.array(["poke"] * count), agent=np.array(["robot"] * count),
        material=np.array(["flour"] * count), centre=centre, size=np.array([[W, H]] * count),
        id=np.array([f"p{k}" for k in range(count)]),
    )  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize(
    "kind", ["C", "DCR", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("CR", "DC"))]
)
def test_every_kind_is_fitted_saved_and_loaded(pairs, kind, tmp_path):
    told = []
    bank = fit(pairs, kind, report=told.append, **QUICK)
    assert bank.kind == kind and bank.rois == {"poke": (W, H)} and len(told) == 3
    scores = [row.score for row in told[-1].curve]
    assert scores[-1] < scores[0]
    errors, _ = roi_errors_mm(bank, pairs, "poke")
    assert np.isfinite(errors).all()
    found = load_bank(save_bank(bank, tmp_path / "bank"))
    assert jax.tree.structure(found) == jax.tree.structure(bank)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(bank), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.full
def test_a_network_learns_the_effect(pairs):
    """From an error of the whole depth range to a fraction of the change, in seconds."""
    told = []
    options = QUICK | {"width": 4, "epochs": 150, "learning_rate": 3e-3, "patience": 0}
    bank = fit(pairs, "C", report=told.append, **options)
    error, change = roi_errors_mm(bank, pairs, "poke")
    assert error.mean() < change.mean()
    best = told[-1].best.score
    assert best == min(row.score for row in told[-1].curve)
    assert bank.predictors[0].params.keys() == {"down", "bottom", "up", "output"}


@pytest.mark.full
def test_training_goes_on_from_another_bank(pairs):
    first = fit(pairs, "CR", **QUICK | {"epochs": 20})
    told = []
    few = pairs.select(np.arange(3))
    second = fit(few, "CR", start=first, report=told.append, **QUICK)
    fresh = []
    fit(few, "CR", report=fresh.append, **QUICK)
    assert told[0].curve[0].train < 0.9 * fresh[0].curve[0].train
    assert second.roi("poke") == first.roi("poke")
    smaller = replace(few, size=few.size - 4)
    assert fit(smaller, "CR", start=first, **QUICK).roi("poke") == (W, H)  # the start's
    with pytest.raises(BadBank, match="of kind 'CR'; expected 'C'"):
        fit(few, "C", start=first, **QUICK)
    with pytest.raises(JShapeError, match="another camera: its fx is 300"):
        fit(few, "CR", start=replace(first, camera=replace(PAPER_BOX, fx=300.0)), **QUICK)


def test_what_cannot_be_trained_is_refused(pairs):
    with pytest.raises(BadDataset, match="poke: 1 pair cannot be split"):
        fit(pairs.select(np.arange(1)), "CR", **QUICK)
    with pytest.raises(BadDataset, match="no pairs"):
        fit(pairs.select(np.arange(0)), "C", **QUICK)
    blind = replace(pairs, prior=np.zeros_like(pairs.prior))
    with pytest.raises(BadDataset, match="poke: 360 of 360 ROI pixels have no depth reading"):
        fit(blind, "DCR", **QUICK)
    with pytest.raises(BadDataset, match="poke: 8 of 8 pairs have no pixel with a reading"):
        fit(blind, "C", **QUICK)
    with pytest.raises(JShapeError, match="unknown option of training 'widht'; allowed: epochs"):
        fit(pairs, "C", widht=3)


@pytest.mark.full
def test_pairs_of_mixed_sizes_get_the_mean_roi(pairs):
    size = pairs.size + np.array([[-4, 2], [4, -2]] * 4)
    with pytest.warns(UserWarning, match="the mean difference is kept"):  # 3 epochs teach nothing
        bank = jshape.fit(replace(pairs, size=size), kind="C", **QUICK)
    assert bank.roi("poke") == (W, H)
