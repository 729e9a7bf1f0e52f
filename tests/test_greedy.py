"""The sweep and Algorithm 1 against a loop-by-loop NumPy transcription."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import Camera, Status, distance
from jshape.actions import grid
from jshape.planners import PLANNERS
from jshape.planners.base import Limits
from jshape.predict.bank import Bank
from jshape.predict.difference import Difference
from jshape.predict.sweep import candidates_at, predict_at, refresh, sweep
from tests.reference import greedy as twin

CAMERA = Camera(24, 18, 30.0, 30.0, 12.0, 9.0, 0.42, 0.47)
ROIS = ((7, 6), (4, 9), (3, 3))  # (w, h)


def bank_of(deltas):
    return Bank(
        CAMERA,
        tuple(Difference(jnp.asarray(d, jnp.float32)) for d in deltas),
        tuple(f"a{i}" for i in range(len(deltas))),
    )


def problem(seed, exact=True):
    """A random bank, image, goal and overlapping positions.

    With `exact`, all values are multiples of 1/256: sums of them are exact in float32 and float64
    alike, so that equal candidates tie to the last bit.
    """
    rng = np.random.default_rng(seed)

    def values(low, high, shape):
        if exact:
            return rng.integers(int(low * 256), int(high * 256) + 1, shape) / 256
        return rng.uniform(low, high, shape)

    deltas = [values(-0.3, 0.3, (h, w)) for w, h in ROIS]
    image = values(0, 1, CAMERA.shape)
    positions = []
    for w, h in ROIS:
        u = rng.integers(w // 2, CAMERA.width - (w - w // 2) + 1, 5)
        v = rng.integers(h // 2, CAMERA.height - (h - h // 2) + 1, 5)
        positions.append(np.stack([u, v], -1))
    positions[1][3] = positions[1][0]  # the same place twice: a tie
    goal = image
    for _ in range(rng.integers(0, 5)):
        action = rng.integers(len(ROIS))
        goal = twin.inject(goal, deltas[action], positions[action][rng.integers(5)])
    if rng.random() < 0.3:
        goal = values(0, 1, CAMERA.shape)
    return bank_of(deltas), deltas, image, goal, positions


def run(bank, image, goal, positions, max_steps=6, **limits):
    candidates = candidates_at(bank, dict(zip(bank.actions, positions, strict=True)))
    return candidates, PLANNERS["greedy"](
        bank,
        jnp.asarray(image, jnp.float32),
        jnp.asarray(goal, jnp.float32),
        candidates,
        Limits(**limits),
        max_steps=max_steps,
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), max_steps=st.sampled_from([0, 3, 6]))
def test_greedy_equals_the_transcription(seed, max_steps):
    bank, deltas, image, goal, positions = problem(seed)
    steps, distances, status = twin.greedy(image, goal, deltas, positions, max_steps)
    candidates, found = run(bank, image, goal, positions, max_steps)
    assert int(found.steps) == len(steps)
    assert [candidates.locate(int(c)) for c in found.chosen[: len(steps)]] == steps
    assert Status(int(found.status)).name == status
    # The patches rebuild the transcription's last image.
    end = np.array(image)
    for k, (action, place) in enumerate(steps):
        (w, h), (u, v) = ROIS[action], positions[action][place]
        end[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w] = found.patches[k, :h, :w]
    np.testing.assert_allclose(twin.distance(end, goal), distances[-1], atol=1e-7)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), min_gain=st.floats(0, 0.02))
def test_greedy_equals_the_transcription_on_real_numbers(seed, min_gain):
    bank, deltas, image, goal, positions = problem(seed, exact=False)
    steps, distances, _ = twin.greedy(image, goal, deltas, positions, 6, min_gain=min_gain)
    gains = -np.diff(distances)
    candidates, found = run(bank, image, goal, positions, min_gain=min_gain)
    chosen = [candidates.locate(int(c)) for c in found.chosen[: int(found.steps)]]
    # A gain within rounding of the least gain may fall on either side of it.
    close = np.flatnonzero(np.abs(gains - min_gain) < 1e-6)
    sure = int(close[0]) if close.size else len(steps)
    assert [_place(positions, c) for c in chosen[:sure]] == [
        _place(positions, c) for c in steps[:sure]
    ]


def _place(positions, step):
    """The same action at the same place counts as the same step, whatever its number."""
    return step[0], tuple(positions[step[0]][step[1]])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_change_on_the_roi_equals_that_on_the_full_image(seed):
    bank, deltas, image, goal, positions = problem(seed, exact=False)
    candidates = candidates_at(bank, dict(zip(bank.actions, positions, strict=True)))
    before = twin.distance(image, goal)
    full = [
        twin.distance(twin.inject(image, delta, centre), goal) - before
        for delta, centres in zip(deltas, positions, strict=True)
        for centre in centres
    ]
    changes = sweep(
        bank, jnp.asarray(image, jnp.float32), jnp.asarray(goal, jnp.float32), candidates
    )
    np.testing.assert_allclose(changes, full, atol=1e-6)


def test_prediction_is_clipped_when_it_is_put_back():
    bank = problem(1)[0]
    roi = predict_at(bank, 0, jnp.ones(CAMERA.shape), jnp.array([2, 3]))
    np.testing.assert_array_equal(roi, 1 + bank.predictors[0].delta)
    clipped = np.asarray(bank.predict("a0", np.ones((2, 6, 7), np.float32)))
    assert clipped.shape == (2, 6, 7) and clipped.max() <= 1


def test_untouched_candidates_are_not_evaluated_again():
    deltas = [np.full((h, w), 0.25) for w, h in ROIS]
    bank = bank_of(deltas)
    positions = [np.array([[4, 4], [19, 4], [4, 13], [19, 13]])] * 3
    image = np.zeros(CAMERA.shape)
    goal = twin.inject(twin.inject(image, deltas[0], [4, 4]), deltas[0], [19, 13])
    _, found = run(bank, image, goal, positions)
    assert Status(int(found.status)) == Status.CONVERGED
    # 12 at the start, then after each of two actions only the 3 candidates of that place.
    assert int(found.evaluations) == 12 + 3 + 3


def test_refresh_leaves_fresh_values_alone():
    bank, _, image, goal, positions = problem(3)
    candidates = candidates_at(bank, dict(zip(bank.actions, positions, strict=True)))
    image, goal = jnp.asarray(image, jnp.float32), jnp.asarray(goal, jnp.float32)
    all_new = np.asarray(sweep(bank, image, goal, candidates)) * image.size
    stale = np.arange(len(candidates)) % 3 == 0
    mixed = refresh(bank, image, goal, candidates, jnp.full(15, 7.0), jnp.asarray(stale))
    np.testing.assert_allclose(mixed, np.where(stale, all_new, 7.0), rtol=1e-5, atol=1e-5)


def test_limits_stop_the_search():
    bank, deltas, image, _, positions = problem(5)
    goal = twin.inject(image, deltas[0], positions[0][0])
    start = float(distance(np.float32(image), np.float32(goal)))
    _, found = run(bank, image, goal, positions, tolerance=start)
    assert (int(found.steps), Status(int(found.status))) == (0, Status.CONVERGED)
    _, found = run(bank, image, goal, positions, min_gain=start * 1.01)
    assert (int(found.steps), Status(int(found.status))) == (0, Status.NO_IMPROVEMENT)


def test_no_candidates_is_an_empty_plan():
    bank, _, image, goal, _ = problem(5)
    _, found = run(bank, image, 1 - image, [np.zeros((0, 2), np.int32)] * 3)
    assert (int(found.steps), Status(int(found.status))) == (0, Status.NO_IMPROVEMENT)


def test_vmap_over_goals_equals_a_loop():
    bank, _, image, _, positions = problem(11)
    candidates = candidates_at(bank, dict(zip(bank.actions, positions, strict=True)))
    goals = jnp.asarray(np.stack([problem(s)[3] for s in range(11, 16)]), jnp.float32)
    image = jnp.asarray(image, jnp.float32)
    limits = Limits()

    def one(goal):
        return PLANNERS["greedy"](bank, image, goal, candidates, limits, max_steps=6)

    many = jax.vmap(one)(goals)
    for k, goal in enumerate(goals):
        alone = one(goal)
        np.testing.assert_array_equal(many.chosen[k], alone.chosen)
        assert int(many.status[k]) == int(alone.status)


TRACED = []


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Spy(Difference):
    """f_D that notes when it is traced."""

    def __call__(self, roi, place, strength=1.0):
        TRACED.append(roi.shape)
        return super().__call__(roi, place, strength)


def test_one_trace_per_shape():
    def spied(bank):
        return replace(bank, predictors=tuple(Spy(p.delta) for p in bank.predictors))

    bank, _, image, goal, positions = problem(2)
    run(spied(bank), image, goal, positions)
    assert len(TRACED) > 0
    TRACED.clear()
    other = problem(9)
    moved = [p[::-1] for p in positions]
    run(spied(other[0]), other[2], other[3], moved, min_gain=0.01, tolerance=0.02)
    camera = replace(CAMERA, fx=31.0, z_max=0.48)
    run(replace(spied(bank), camera=camera), image, goal, positions)
    assert not TRACED  # another image, goal, place, limit, effect or camera: nothing compiled
    run(spied(bank), image, goal, [p[:2] for p in positions])
    assert TRACED  # another number of places: compiled once more


@pytest.mark.parametrize(("columns", "rows", "count"), [(5, 3, 15), (7, 3, 21), (1, 1, 1)])
def test_the_grid_keeps_the_largest_roi_inside(columns, rows, count):
    from jshape import PAPER_BOX
    from jshape.actions import fits

    positions = grid(PAPER_BOX, columns, rows)
    assert positions.shape == (count, 2) and len(np.unique(positions, axis=0)) == count
    assert fits(PAPER_BOX, positions, (183, 183)).all()
