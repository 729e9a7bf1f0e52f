"""The 80 % interval of predictions: its law, how it is fitted, and that a bank carries it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import load_bank, save_bank, to_mm
from jshape.camera import PAPER_BOX
from jshape.errors import BadBank, UnknownName
from jshape.learn.intervals import coverage, fit_spread, with_more_pairs
from jshape.learn.scores import SAMPLED, roi_errors
from jshape.models.spread import LEAST_MM, around, half_width_mm, radii_px, surprise
from tests.reference.spread import around_slowly
from tests.test_bank import bank_of
from tests.test_evaluate import pits


def drawn(rng, count, mm=0.3, share=0.2):
    """(count, 2) of |error| whose 80 % quantile is mm + share * change, and that change."""
    change = rng.exponential(4.0, count)
    return np.stack([rng.exponential((mm + share * change) / np.log(5.0)), change], -1)


def test_the_change_around_is_the_largest_within_reach(rng):
    change = rng.normal(size=(2, 9, 12)).astype(np.float32)
    change[0, 3, 4] = np.nan
    found = jax.jit(around, static_argnums=1)(change, (2, 1))
    np.testing.assert_array_equal(found, around_slowly(change, (2, 1)))
    np.testing.assert_array_equal(around(change, (2, 1)), found)  # on the host
    assert radii_px(PAPER_BOX) == (19, 19)  # 20 mm at 0.445 m
    assert (radii_px(replace(PAPER_BOX, fx=866.0)), radii_px(replace(PAPER_BOX, fx=1.0))) == (
        (39, 19), (1, 19),
    )  # fmt: skip


def test_the_law_of_the_interval():
    nearby = jnp.array([[0.0, 1.0, 10.0]])
    np.testing.assert_allclose(half_width_mm(jnp.array([0.2, 0.5]), nearby), [[0.2, 0.7, 5.2]])
    np.testing.assert_allclose(
        half_width_mm(jnp.array([0.0, 0.05]), nearby), [[LEAST_MM, LEAST_MM, 0.5]]
    )
    assert np.isnan(half_width_mm(jnp.full(2, jnp.nan), nearby)).all()
    many = half_width_mm(jnp.array([[0.2, 0.5], [1.0, 0.0]]), jnp.stack([nearby, nearby]))
    np.testing.assert_allclose(many[1], 1.0)


def test_the_surprise_of_a_look(rng):
    """0.62 where errors are as the interval says, ten times as much where they are ten times."""
    half = rng.uniform(0.2, 2.0, (100, 100))
    error = rng.normal(size=half.shape) * half / 1.2816
    error[:30] = np.nan
    assert float(surprise(error, half)) == pytest.approx(0.623, abs=0.02)  # √(2/π) / 1.2816
    both = jnp.stack([error, 10 * error])
    np.testing.assert_allclose(
        surprise(both, np.stack([half, half]))[1], 10 * surprise(error, half), rtol=1e-5
    )
    assert np.isnan(surprise(np.full((3, 3), np.nan), np.ones((3, 3))))


@pytest.mark.parametrize(("mm", "share"), [(0.3, 0.2), (1.0, 0.0), (0.0, 0.4)])
def test_what_is_fitted_covers_fresh_draws(rng, mm, share):
    found = fit_spread(drawn(rng, 4000, mm, share).reshape(10, 400, 2))
    np.testing.assert_allclose(found, (mm, share), atol=0.12)
    assert coverage(drawn(rng, 4000, mm, share), found) == pytest.approx(0.8, abs=0.03)
    few = fit_spread(drawn(rng, 200, mm, share))
    assert 0.75 <= coverage(drawn(rng, 4000, mm, share), few) <= 0.85


def test_a_bank_fitted_to_more_pairs_is_a_little_better(rng):
    """As means of so many draws are, with two numbers fitted."""
    assert with_more_pairs(9, 9) == 1.0
    assert with_more_pairs(4, 6) == pytest.approx(0.943, abs=1e-3)
    pixels = drawn(rng, 1000)
    mm, share = fit_spread(pixels, 0.5)
    half = fit_spread(pixels * [0.5, 1.0])
    assert (mm, share) == half and mm + share < 0.6 * sum(fit_spread(pixels))


def test_pixels_without_a_reading_say_nothing(rng):
    pixels = drawn(rng, 1000)
    holed = np.concatenate([pixels, [[np.nan, 1.0], [1.0, np.nan]]])
    assert fit_spread(holed) == fit_spread(pixels)
    assert coverage(holed, (0.3, 0.2)) == coverage(pixels, (0.3, 0.2))
    assert np.isnan(fit_spread(np.zeros((0, 5, 2)))).all()
    assert np.isnan(coverage(np.zeros((0, 2)), (0.3, 0.2)))
    assert fit_spread(np.zeros((50, 2))) == (0.0, 0.0)  # a prediction without an error


def test_a_bank_says_how_wide_a_prediction_is(rng):
    bank = bank_of(rng)
    before = rng.random((2, 9, 12)).astype(np.float32)
    after = bank.predict("grasp", before)
    assert np.isnan(bank.half_width_mm("grasp", before, after)).all()
    bank = replace(bank, intervals=jnp.array([[0.3, 0.2], [np.nan, np.nan]]))
    found = bank.half_width_mm("grasp", before, after)
    nearby = to_mm(around_slowly(np.asarray(after) - before, radii_px(bank.camera)), bank.camera)
    np.testing.assert_allclose(found, np.maximum(0.3 + 0.2 * nearby, LEAST_MM), rtol=1e-5)
    assert np.isnan(bank.half_width_mm("poke", before, after)).all()
    std = bank.spread("grasp", before) * to_mm(1.0, bank.camera)
    np.testing.assert_allclose(1.2815516 * std, found, rtol=1e-5)  # 80 % of a normal law
    with pytest.raises(UnknownName):
        bank.half_width_mm("knead", before, after)


def test_manifests_keep_the_spread(rng, tmp_path):
    bank = bank_of(rng, [0.5, 0.7])
    told = replace(bank, intervals=jnp.array([[0.3, 0.2], [np.nan, np.nan]]))
    folder = save_bank(told, tmp_path / "bank")
    found = load_bank(folder)
    np.testing.assert_array_equal(found.intervals, told.intervals)
    assert load_bank(save_bank(bank, tmp_path / "old")).intervals is None
    for bad in (-0.2, np.nan, np.inf):
        with pytest.raises(BadBank, match="error 1: spread"):
            save_bank(
                replace(bank, intervals=jnp.full((2, 2), 0.3).at[0, 1].set(bad)), tmp_path / "a"
            )
    object.__setattr__(told, "intervals", jnp.ones((2, 1)))
    with pytest.raises(BadBank, match=r"spread has shape \(2, 1\), not \(mm, share\) of each"):
        save_bank(told, tmp_path / "bad")
    for bad in ([0.3], "wide", [0.3, "x"], 0.3):
        rows = [{"action": "grasp", "mm": 0.5, "spread": bad}]
        with pytest.raises(BadBank, match="error 1: spread"):
            save_bank(bank, tmp_path / "bad", info={"errors": rows})


def test_held_out_pixels_are_spread_over_the_roi(rng):
    """What is kept of each ROI has the errors of all of it."""
    bank, pairs = load_bank("pressed-flour-robot"), pits(rng, ["robot"], 4)
    found = roi_errors(bank, pairs, "poke")
    assert found.pixels_mm.shape == (len(pairs.of("poke")), SAMPLED, 2)
    np.testing.assert_allclose(found.pixels_mm[..., 0].mean(1), found.error_mm, rtol=0.1)
    assert (found.pixels_mm[..., 1].max(1) > found.change_mm).all()
