"""What a bank knows of its own errors, and what that says of the whole image."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import Bank, Camera, distance, load_bank, to_mm
from jshape.actions import first_pixels
from jshape.models.difference import Difference

CAMERA = Camera(40, 30, 50.0, 55.0, 18.0, 16.0, 0.4, 0.5)
SIZES = {"grasp": (12, 9), "poke": (3, 4)}


def bank_of(rng, errors_mm=None, camera=CAMERA):
    effects = [rng.normal(0, 0.1, (h, w)).astype(np.float32) for w, h in SIZES.values()]
    predictors = tuple(Difference(jnp.asarray(effect)) for effect in effects)
    errors = None if errors_mm is None else jnp.asarray(errors_mm, jnp.float32)
    return Bank(camera, predictors, tuple(SIZES), errors_mm=errors)


@pytest.mark.full
@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), off=st.floats(0, 1), like=st.floats(0, 1))
def test_the_error_bounds_what_d_is_wrong_by(seed, off, like):
    """A prediction that is off by a known amount, any goal: d is off by `error_of_d` at most."""
    rng = np.random.default_rng(seed)
    bank = bank_of(rng)
    number = int(rng.integers(2))
    name = bank.actions[number]
    w, h = bank.roi(name)
    centre = np.array(
        [rng.integers(w // 2, 40 - w + w // 2), rng.integers(h // 2, 30 - h + h // 2)]
    )
    u, v = first_pixels(centre, (w, h))
    now = rng.random((30, 40), np.float32)
    predicted = now.copy()
    window = np.s_[v : v + h, u : u + w]
    predicted[window] = bank.predict(name, now[window], position=centre)
    true = predicted.copy()
    true[window] = np.clip(true[window] + off * rng.normal(0, 0.5, (h, w)), 0, 1)

    mm = np.full(2, np.nan)
    mm[number] = to_mm(np.abs(true - predicted)[window].mean(), CAMERA)
    bound = np.asarray(replace(bank, errors_mm=jnp.asarray(mm, jnp.float32)).error_of_d())
    assert bound[1 - number] == 0.0  # not known
    goal = like * predicted + (1 - like) * rng.random((30, 40), np.float32)
    wrong = abs(float(distance(true, goal)) - float(distance(predicted, goal)))
    assert wrong <= bound[number] * (1 + 1e-4) + 1e-6
    # It is not larger than it must be: a goal that is what was predicted reaches it.
    assert float(distance(true, predicted)) == pytest.approx(bound[number], rel=1e-4, abs=1e-7)


def test_what_is_not_known_is_no_error(rng):
    np.testing.assert_array_equal(bank_of(rng).error_of_d(), [0, 0])
    np.testing.assert_array_equal(bank_of(rng, [np.nan, np.nan]).error_of_d(), [0, 0])
    per_mm = 1 / float(to_mm(1.0, CAMERA)) / (40 * 30)
    found = bank_of(rng, [np.nan, 2.0]).error_of_d()
    np.testing.assert_allclose(found, [0, 2 * 12 * per_mm], rtol=1e-6)
    np.testing.assert_array_equal(Bank(CAMERA, (), ()).error_of_d(), np.zeros(0))


@pytest.mark.full
def test_other_errors_compile_nothing(rng):
    traced = []

    @jax.jit
    def ask(bank):
        traced.append(bank.actions)
        return bank.error_of_d()

    bank = bank_of(rng, [0.5, 1.0])
    first = ask(bank)
    twice = ask(replace(bank, errors_mm=jnp.array([1.0, np.nan])))
    assert len(traced) == 1
    np.testing.assert_allclose(first, bank.error_of_d(), rtol=1e-6)
    np.testing.assert_allclose(twice, [2 * first[0], 0], rtol=1e-6)
    many = jnp.arange(6.0).reshape(3, 2)
    each = jax.vmap(lambda errors: replace(bank, errors_mm=errors).error_of_d())(many)
    np.testing.assert_allclose(each[:, 1], many[:, 1] * first[1], rtol=1e-6)


def test_below_another_camera_the_error_is_as_many_mm():
    bank = load_bank("pressed-flour-robot")
    assert bank.errors_mm is not None
    farther = replace(bank.camera, width=960, height=790, u0=480.0, v0=394.0, z_min=0.5, z_max=0.6)
    other = bank.seen_by(farther, 0.55)
    np.testing.assert_array_equal(other.errors_mm, bank.errors_mm)
    (w, h), camera = other.roi("knock"), other.camera
    expected = float(bank.errors_mm[1]) / float(to_mm(1.0, camera)) * w * h / (960 * 790)
    assert bank.actions[1] == "knock"
    assert float(other.error_of_d()[1]) == pytest.approx(expected, rel=1e-6)
