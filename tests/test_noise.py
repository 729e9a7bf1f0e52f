"""How much noise a look has, and what follows from it."""

import jax
import numpy as np
import pytest

import jshape
from jshape import PAPER_BOX
from jshape.data.noise import WIDE, noise_of_change, noise_of_sums
from jshape.data.simulate import look
from jshape.data.view import image_of_depth
from jshape.planning import problem as tasks
from jshape.planning.options import FEIGNED, StopCriteria
from jshape.robot.loop import PATIENCE, Stop, mold
from tests.conftest import mm, paper
from tests.test_loop import PLACES, Obedient

SHAPE = (120, 160)
BOWL = np.add.outer(np.linspace(-3, 3, 120) ** 2, np.linspace(-4, 4, 160) ** 2)


def test_white_noise_is_found_whatever_the_shape_below(rng):
    noise = 0.3 * rng.standard_normal(SHAPE)
    cut = BOWL + 9.0 * (np.arange(160) > 70)  # an edge is where few squares are
    for shape in (np.zeros(SHAPE), BOWL, cut):
        assert noise_of_sums(shape) < 0.01
        assert noise_of_sums(shape + noise) == pytest.approx(0.3, rel=0.15)


def test_pixels_that_do_not_count_say_nothing(rng):
    noise, seen = 0.3 * rng.standard_normal(SHAPE), np.ones(SHAPE, bool)
    seen[:, 80:] = False
    wild = np.where(seen, noise, 50 * rng.standard_normal(SHAPE))
    assert noise_of_sums(wild, seen) == pytest.approx(0.3, rel=0.25)
    assert noise_of_sums(wild, np.zeros(SHAPE, bool)) == 0
    assert noise_of_sums(np.ones((9, 9))) == 0


def test_the_noise_of_a_change_is_that_of_a_mean(rng):
    """Against the spread of means of many pairs of looks; a dent in between does not matter."""
    pairs = 0.3 * rng.standard_normal((60, 2, *SHAPE))
    spread = (pairs[:, 1] - pairs[:, 0]).mean((1, 2)).std()
    dented = BOWL.copy()
    dented[:40, :60] -= 5
    found = noise_of_change(BOWL + pairs[0, 0], dented + pairs[0, 1], dented == BOWL, dented.size)
    assert found == pytest.approx(spread, rel=0.3)


def test_simulated_looks_have_the_noise_of_their_means():
    """Noise that is correlated over pixels; against the spread of the means of 24 looks."""
    bed = jshape.sim.flat_bed()
    shots = [
        image_of_depth(look(jax.random.key(k), bed, PAPER_BOX), PAPER_BOX, max_missing=0.5).image
        for k in range(24)
    ]
    spread = float(np.std([np.mean(image, dtype=float) for image in shots])) * np.sqrt(2)
    everywhere = np.ones(shots[0].shape, bool)
    found = noise_of_change(shots[0], shots[1], everywhere, everywhere.size)
    assert found == pytest.approx(spread, rel=0.4)
    # Of one look alone a third is found: squares side by side err alike.
    assert 0.2 < noise_of_sums(shots[0]) * np.sqrt(2 / shots[0].size) / spread < 1.0


def test_the_least_gain_follows_from_the_noise(bank, molded, rng):
    now, goal, _ = molded
    rough = now + (1e-3 * rng.standard_normal(now.shape)).astype("f4")
    clean, noisy = (tasks.feigned(bank, image, goal, None) for image in (now, rough))
    widest = max(np.sqrt(np.prod(bank.roi(name))) for name in bank.actions)
    assert noisy == pytest.approx(FEIGNED * 1e-3 * widest / now.size, rel=0.2)
    assert clean < 0.1 * noisy
    assert tasks.limits(bank, StopCriteria(), None, (), noisy).min_gain == noisy
    said = tasks.limits(bank, StopCriteria(min_gain_mm=mm(1e-3)), None, (), noisy)
    assert said.min_gain == pytest.approx(1e-3)
    made = jshape.plan(rough, goal, bank=bank, **jshape.options(error_margin=0.0, max_steps=2))
    assert len(made) == 2 and (-np.diff(made.distances) > noisy).all()


class Noisy(Obedient):
    """An obedient world whose looks err by as much all over squares, metres."""

    def __init__(self, bank, image, share, noise, seed=0):
        super().__init__(bank, image, share)
        self.rng, self.noise = np.random.default_rng(seed), noise

    def look(self):
        clean = super().look()
        squares = self.noise * self.rng.standard_normal([-(-n // WIDE) for n in clean.shape])
        height, width = clean.shape
        return clean + squares.repeat(WIDE, 0).repeat(WIDE, 1)[:height, :width]


@pytest.mark.parametrize("seed", range(3))
def test_a_look_fails_only_where_a_drop_would_be_seen(bank, molded, seed):
    """Of a hand that does nothing: known at once where looks are clean; from noisy ones never
    before it was to gain more than they hide, and still soon."""
    now, goal, _ = molded
    how = paper(positions=PLACES, max_steps=30)
    clean = mold(Noisy(bank, now, 0.0, 0.0), goal, bank, patience=1, **how)
    assert clean.stop is Stop.WORSE and len(clean.steps) == 1
    noise = 1.5e-3
    noisy = mold(Noisy(bank, now, 0.0, noise, seed), goal, bank, patience=1, **how)
    hidden = 1e3 * noise * np.sqrt(2 * WIDE**2 / now.size)  # mm
    drops = [step.before_mm - step.predicted_mm for step in noisy.steps]
    rise = noisy.distances_mm[-1] - noisy.distances_mm[:-1].min()
    assert noisy.stop is Stop.WORSE and len(drops) < 10
    assert max(sum(drops), rise) > 0.5 * hidden
    assert len(drops) > 1 or rise > 0.5 * hidden
    patient = mold(Noisy(bank, now, 0.0, noise, seed), goal, bank, **how)
    assert patient.stop is Stop.WORSE and PATIENCE <= len(patient.steps) < 20
