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
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.planning.apply import after_action
from jshape.planning.evaluate import candidates_at, empty_cache, refresh, sweep
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchLimits, SearchProblem
from jshape.planning.search.sequence import measured
from jshape.planning.state import search_state
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


def ready(bank, image, goal, positions, strengths=(1.0,)):
    """(state, candidates)."""
    state = search_state(bank, jnp.asarray(image, jnp.float32), jnp.asarray(goal, jnp.float32))
    where = dict(zip(bank.actions, positions, strict=True))
    return state, candidates_at(state, bank, where, strengths)


def run(bank, image, goal, positions, max_steps=6, strengths=(1.0,), **limits):
    state, candidates = ready(bank, image, goal, positions, strengths)
    return greedy.run(state, candidates, SearchLimits(**limits), max_steps=max_steps)


def steps_of(found):
    """What a search chose: (action, (u, v), strength) each."""
    return [
        (int(found.move[k]), tuple(int(n) for n in found.node[k][::-1]), float(found.strength[k]))
        for k in range(int(found.steps))
    ]


def placed(steps, positions, strengths=(1.0,)):
    """A twin's steps, likewise."""
    return [(i, tuple(positions[i][j].tolist()), strengths[k]) for i, j, k in steps]


@pytest.mark.full
@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), max_steps=st.sampled_from([0, 3, 6]))
def test_greedy_equals_the_transcription(seed, max_steps):
    bank, deltas, image, goal, positions = problem(seed)
    steps, distances, status = twin.greedy(image, goal, deltas, positions, max_steps)
    state, candidates = ready(bank, image, goal, positions)
    found = greedy.search(SearchProblem(state, candidates, max_steps=max_steps))
    assert steps_of(found) == placed(steps, positions)
    assert Status(int(found.status)).name == status
    assert (found.move[len(steps) :] == -1).all()
    np.testing.assert_allclose(found.distance, distances[-1], atol=1e-7)
    again = measured(state, found)[2]
    np.testing.assert_allclose(again[: len(steps) + 1], distances, atol=1e-7)


@pytest.mark.full
@settings(max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_strengths_are_tried_in_their_order(seed):
    strengths = (0.5, 1.0, 2.0)
    bank, deltas, image, goal, positions = problem(seed)
    goal = twin.inject(goal, deltas[2], positions[2][0], 0.5)
    steps, distances, status = twin.greedy(image, goal, deltas, positions, 6, strengths=strengths)
    found = run(bank, image, goal, positions, strengths=strengths)
    assert steps_of(found) == placed(steps, positions, strengths)
    assert Status(int(found.status)).name == status
    np.testing.assert_allclose(found.distance, distances[-1], atol=1e-7)


@pytest.mark.full
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), min_gain=st.floats(0, 0.02))
def test_greedy_equals_the_transcription_on_real_numbers(seed, min_gain):
    bank, deltas, image, goal, positions = problem(seed, exact=False)
    steps, distances, _ = twin.greedy(image, goal, deltas, positions, 6, min_gain=min_gain)
    gains = -np.diff(distances)
    found = run(bank, image, goal, positions, min_gain=min_gain)
    # A gain within rounding of the least gain may fall on either side of it.
    close = np.flatnonzero(np.abs(gains - min_gain) < 1e-6)
    sure = int(close[0]) if close.size else len(steps)
    assert steps_of(found)[:sure] == placed(steps, positions)[:sure]


@pytest.mark.full
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31))
def test_the_change_on_the_roi_equals_that_on_the_full_image(seed):
    bank, deltas, image, goal, positions = problem(seed, exact=False)
    strengths = (0.5, 2.0)
    found = sweep(*ready(bank, image, goal, positions, strengths))
    before = twin.distance(image, goal)
    for delta, centres, changes in zip(deltas, positions, found, strict=True):
        full = [
            [twin.distance(twin.inject(image, delta, at, s), goal) - before for s in strengths]
            for at in centres
        ]
        np.testing.assert_allclose(changes, full, atol=1e-6)


def test_prediction_is_clipped_when_it_is_put_back():
    bank = problem(1)[0]
    delta = np.asarray(bank.predictors[0].delta)
    ones, first = jnp.ones(CAMERA.shape), jnp.array([2, 3])
    after, share = after_action(bank.predictors[0], ones, first[::-1])
    np.testing.assert_array_equal(after, np.minimum(1 + delta, 1))
    assert float(share) == pytest.approx((delta > 0).mean())
    state = search_state(bank, ones, ones)
    np.testing.assert_array_equal(state.act(0, ones, first, 1.0)[2:8, 3:10], after)
    clipped = np.asarray(bank.predict("a0", np.ones((2, 6, 7), np.float32)))
    assert clipped.shape == (2, 6, 7) and clipped.max() <= 1


def test_untouched_candidates_are_not_evaluated_again():
    deltas = [np.full((h, w), 0.25) for w, h in ROIS]
    bank = bank_of(deltas)
    positions = [np.array([[4, 4], [19, 4], [4, 13], [19, 13]])] * 3
    image = np.zeros(CAMERA.shape)
    goal = twin.inject(twin.inject(image, deltas[0], [4, 4]), deltas[0], [19, 13])
    found = run(bank, image, goal, positions)
    assert Status(int(found.status)) == Status.CONVERGED
    # 12 at the start, then after the first of two actions only the 3 candidates of that place.
    assert int(found.evaluations) == 12 + 3
    found = run(bank, image, goal, positions, strengths=(0.5, 1.0))  # each counts
    assert int(found.evaluations) == 2 * (12 + 3)


@pytest.mark.full
def test_refresh_leaves_fresh_values_alone():
    bank, _, image, goal, positions = problem(3)
    state, candidates = ready(bank, image, goal, positions)
    every = sweep(state, candidates)
    stale = [np.arange(5) % 3 == number % 3 for number in range(3)]
    cache = empty_cache(candidates)
    waits = jnp.zeros_like(cache.stale).at[:15].set(np.concatenate(stale))
    cache = replace(cache, changes=jnp.full_like(cache.changes, 7.0), stale=waits)
    mixed, spent = refresh(state, state.now, candidates, cache)
    assert int(spent) == sum(mine.sum() for mine in stale)
    for number in range(3):
        expected = np.where(stale[number][:, None], every[number], 7.0)
        mine = candidates.of_move(number, mixed.changes)[:, :1]
        np.testing.assert_array_equal(mine, expected)
    assert not mixed.stale.any()


@pytest.mark.full
def test_limits_stop_the_search():
    bank, deltas, image, _, positions = problem(5)
    goal = twin.inject(image, deltas[0], positions[0][0])
    start = float(distance(np.float32(image), np.float32(goal)))
    found = run(bank, image, goal, positions, tolerance=start * (1 + 1e-6))
    assert (int(found.steps), Status(int(found.status))) == (0, Status.CONVERGED)
    found = run(bank, image, goal, positions, min_gain=start * 1.01)
    assert (int(found.steps), Status(int(found.status))) == (0, Status.NO_IMPROVEMENT)
    found = run(bank, image, goal, positions, errors=jnp.array([2.0, 0.0, 2.0]) * start)
    assert set(steps_of(found)) <= {(1, tuple(at.tolist()), 1.0) for at in positions[1]}
    deeper = run(bank, image, goal, positions, strengths=(2.0, 3.0), errors=start / 1.9)
    assert int(deeper.steps) == 0  # a deeper action must gain as many times more


@pytest.mark.full
def test_each_action_is_used_as_often_as_allowed():
    bank, _, image, _, positions = problem(7)
    free = run(bank, image, 1 - image, positions, max_steps=12)
    used = np.bincount([step[0] for step in steps_of(free)], minlength=3)
    most = np.maximum(used - 1, 0)
    found = run(bank, image, 1 - image, positions, max_steps=12, max_uses=jnp.asarray(most))
    assert used.max() > 1
    assert (np.bincount([step[0] for step in steps_of(found)], minlength=3) <= most).all()
    none = run(bank, image, 1 - image, positions, max_uses=jnp.zeros(3, jnp.int32))
    assert (int(none.steps), Status(int(none.status))) == (0, Status.NO_IMPROVEMENT)


@pytest.mark.parametrize("there_is", ["no place", "a place for one action"])
def test_no_candidates_is_an_empty_plan(there_is):
    bank, _, image, goal, positions = problem(5)
    none = np.zeros((0, 2), np.int32)
    if there_is == "no place":
        found = run(bank, image, 1 - image, [none] * 3)
        assert (int(found.steps), Status(int(found.status))) == (0, Status.NO_IMPROVEMENT)
        found = run(bank, image, image, [none] * 3)
        assert (int(found.steps), Status(int(found.status))) == (0, Status.CONVERGED)
    else:
        found = run(bank, image, 1 - image, [none, positions[1], none])
        assert {step[0] for step in steps_of(found)} == {1}


@pytest.mark.full
def test_vmap_over_goals_equals_a_loop():
    bank, _, image, _, positions = problem(11)
    goals = jnp.asarray(np.stack([problem(s)[3] for s in range(11, 16)]), jnp.float32)
    state, candidates = ready(bank, image, goals[0], positions)

    def one(goal):
        return greedy.run(replace(state, goal=goal), candidates, SearchLimits(), max_steps=6)

    many = jax.vmap(one)(goals)
    for k, goal in enumerate(goals):
        alone = one(goal)
        for name in ("steps", "move", "node", "strength", "status"):
            np.testing.assert_array_equal(getattr(many, name)[k], getattr(alone, name))
    assert len(np.unique(many.steps)) > 1  # they end at different times


TRACED = []


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Spy(Difference):
    """f_D that notes when it is traced."""

    def __call__(self, roi, corner, strength=1.0):
        TRACED.append(roi.shape)
        return super().__call__(roi, corner, strength)


@pytest.mark.full
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
    run(spied(bank), image, goal, positions, strengths=(0.7,))
    camera = replace(CAMERA, fx=31.0, z_max=0.48)
    run(replace(spied(bank), camera=camera), image, goal, positions)
    assert not TRACED  # another image, goal, place, limit, effect or camera: nothing compiled
    run(spied(bank), image, goal, [p[:2] for p in positions], strengths=(0.5, 0.7, 2.0))
    assert not TRACED  # nor for another number of places or strengths
    run(spied(bank), image, goal, [np.tile(p, (40, 1)) for p in positions])
    assert TRACED  # until they need larger storage: compiled once more


@pytest.mark.parametrize(("columns", "rows", "count"), [(5, 3, 15), (7, 3, 21), (1, 1, 1)])
def test_the_grid_keeps_the_largest_roi_inside(columns, rows, count):
    from jshape import PAPER_BOX
    from jshape.actions import fits

    positions = grid(PAPER_BOX, columns, rows)
    assert positions.shape == (count, 2) and len(np.unique(positions, axis=0)) == count
    assert fits(PAPER_BOX, positions, (183, 183)).all()
