"""The core under JAX's strict settings: 64 bits, no implicit promotion of dtypes or ranks."""

from contextlib import ExitStack
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import Camera, distance, load_bank, metric, options, plan, sim
from jshape.errors import BadBank
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.difference import Difference
from jshape.planning.search import PLANNERS

SMALL = Camera(60, 49, 54.0, 54.0, 30.0, 24.5, 0.42, 0.47)
"""The paper's box with an eighth of its resolution."""
FIELDS = ("actions", "positions", "offsets", "strengths", "yaws", "distances", "evaluations")
QUICK = options(
    stride=6, strengths=(0.5, 1.0), yaws=1, max_steps=2, min_gain_mm=0.0, error_margin=0.0
)


def strict():
    """All three settings at once."""
    stack = ExitStack()
    stack.enter_context(jax.enable_x64(True))
    stack.enter_context(jax.numpy_dtype_promotion("strict"))
    stack.enter_context(jax.numpy_rank_promotion("raise"))
    return stack


def difference_bank():
    """A hole and a ridge that f_D makes."""
    y, x = np.mgrid[-1:1:9j, -1:1:11j]
    hole = -0.2 * np.exp(-3 * (x**2 + y**2))
    predictors = (Difference(jnp.asarray(hole, "f4")), Difference(jnp.asarray(-hole[::2], "f4")))
    return Bank(SMALL, predictors, ("knock", "push"))


def imprint_bank():
    """Two of the bundled hands."""
    bank = load_bank("pressed-flour-robot").seen_by(SMALL, 0.45)
    chosen = [bank.actions.index(name) for name in ("knock", "poke")]
    return replace(
        bank,
        actions=("knock", "poke"),
        predictors=tuple(bank.predictors[k] for k in chosen),
        errors_mm=None,
    )


BANKS = {"D": difference_bank, "P": imprint_bank}


def bed(seed):
    """I of a simulated bed with hills."""
    heights = sim.irregular_bed(jax.random.key(seed), 0.006)
    luminance = SMALL.luminance(sim.render(heights, SMALL), quantize=False)
    return np.asarray(metric.weigh(luminance, SMALL))


@pytest.fixture(scope="module")
def images():
    return bed(0), bed(1)


@pytest.fixture(params=PLANNERS)
def planner(request):
    return request.param


@pytest.mark.full
@pytest.mark.parametrize("kind", BANKS)
def test_strict_settings_change_no_plan(planner, kind, images):
    expected = plan(*images, bank=BANKS[kind](), planner=planner, **QUICK)
    assert len(expected) == 2
    with strict():
        found = plan(*images, bank=BANKS[kind](), planner=planner, **QUICK)
    for field in FIELDS:
        one, other = getattr(found, field), getattr(expected, field)
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None)
        if planner == "refine" and field not in ("actions", "positions"):
            # optax's Adam computes 1 - b**n in JAX's default float: its first steps are 1e-5 apart.
            np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4)
        else:
            np.testing.assert_array_equal(one, other)


@pytest.mark.full
def test_strict_settings_change_no_simulation():
    def seen():
        before = sim.irregular_bed(jax.random.key(3), 0.004)
        place, key = (0.01, -0.02), jax.random.key(4)
        after = sim.apply_action(key, before, sim.FLOUR, "knock", place, strength=1.2)
        return [np.asarray(sim.render(one, SMALL)) for one in (before, after)]

    expected = seen()
    assert np.abs(expected[1] - expected[0]).max() > 1e-3
    with strict():
        found = seen()
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.full
def test_strict_settings_change_no_distance(images):
    with strict():
        strictly = distance(jnp.asarray(np.stack(images)), jnp.asarray(images[1]))
    np.testing.assert_array_equal(strictly, distance(np.stack(images), images[1]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Sinking(Predictor):
    """All that a predictor needs: it lowers its ROI evenly."""

    amount: jax.Array

    @property
    def roi(self):
        return 9, 7

    def __call__(self, roi, corner, strength=1.0):
        return roi - jnp.asarray(strength)[..., None, None] * self.amount


@pytest.mark.full
def test_a_predictor_needs_a_size_and_a_call(planner):
    bank = Bank(SMALL, (Sinking(jnp.float32(0.1)),), ("sink",))
    assert not bank.turns
    now = np.full(SMALL.shape, 0.5, np.float32)
    np.testing.assert_allclose(bank.predict("sink", now[:7, :9], strength=2.0), 0.3, atol=1e-6)
    goal = now.copy()
    goal[20:27, 30:39] -= 0.1
    found = plan(now, goal, bank=bank, planner=planner, **QUICK)
    assert found.distances[-1] < 0.5 * found.distances[0]
    with pytest.raises(BadBank, match="bound to its camera"):
        bank.seen_by(SMALL, 0.45)
