"""Searches of many candidates: what is not evaluated again, shared windows, nothing compiled."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jshape import PAPER_BOX, Camera, compiling, load_bank, options, plan
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.planning import evaluate
from jshape.planning.candidates import dense_positions
from jshape.planning.evaluate import MANY, candidates_at, sweep
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchLimits, SearchProblem
from jshape.planning.state import search_state

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, 0.42, 0.47)
SMALL = replace(PAPER_BOX, width=120, height=98, fx=433 / 4, fy=433 / 4, u0=240 / 4, v0=197 / 4)
STRENGTHS = (0.5, 1.0)


def rough(rng, shape=CAMERA.shape, size=3.0):
    image = gaussian_filter(rng.normal(size=shape), size)
    return np.asarray(0.5 + 0.1 * image / image.std(), np.float32)


def differences(rng):
    """f_D of three actions that dig and heap up."""
    found = []
    for w, h in ((15, 9), (8, 11), (6, 6)):
        x, y = np.linspace(-2, 2, w), np.linspace(-2, 2, h)[:, None]
        dug = -0.2 * np.exp(-(x**2) - y**2) + 0.05 * np.exp(-((x - 1) ** 2) - y**2)
        found.append(Difference(jnp.asarray(dug + rng.normal(0, 0.002, (h, w)), jnp.float32)))
    return Bank(CAMERA, tuple(found), ("knock", "press", "poke"))


@pytest.fixture(scope="module")
def hands():
    """Two of the bundled hands below a camera of a quarter of the paper's resolution."""
    bank = load_bank("pressed-flour-robot").seen_by(SMALL, 0.45)
    chosen = [bank.actions.index(name) for name in ("knock", "poke")]
    predictors = tuple(bank.predictors[k] for k in chosen)
    return replace(
        bank, actions=("knock", "poke"), predictors=predictors, errors_mm=None, intervals=None
    )


def dense(bank, image, goal, moves=None):
    state = search_state(bank, image, goal, moves and [(*move, 1.0) for move in moves])
    return state, candidates_at(state, bank, dense_positions(bank, 1), STRENGTHS)


def on(kind, seed, hands):
    rng = np.random.default_rng(seed)
    if kind == "image":
        return dense(differences(rng), rough(rng), rough(rng))
    yaws = [(a, yaw) for a in (0, 1) for yaw in (None, 0.8)]
    return dense(hands, rough(rng, SMALL.shape, 6.0), rough(rng, SMALL.shape, 6.0), yaws)


@pytest.mark.full
@pytest.mark.parametrize("price", [None, 0.7])
@pytest.mark.parametrize("kind", ["image", "ground"])
def test_what_need_not_be_looked_at_again_cannot_gain_more(kind, price, hands):
    """After the best and after random actions."""
    state, candidates = on(kind, 3, hands)
    state = replace(state, price=price and np.float32(price))
    gains = [-np.asarray(changes).min(1) for changes in sweep(state, candidates)]
    first = [candidates.of_move(m) for m in range(len(state.moves))]
    rng = np.random.default_rng(5)
    for move in range(len(state.moves)):
        place = int(np.argmax(gains[move])) if move % 2 else int(rng.integers(len(gains[move])))
        now = state.act(move, state.now, jnp.asarray(first[move][place]), 1.0)
        after = [-np.asarray(c).min(1) for c in sweep(replace(state, now=now), candidates)]
        most = state.most_left(now, candidates.first, jnp.asarray(state.shapes)[candidates.move])
        assert (np.concatenate(after) <= np.asarray(most)[np.asarray(candidates.valid)]).all()
        grew = 0
        for m, shape in enumerate(state.shapes):
            shapes = jnp.broadcast_to(jnp.asarray(shape), first[m].shape)
            rise = state.most_gain(state.now, now, jnp.asarray(first[m]), shapes)
            assert (after[m] <= gains[m] + np.asarray(rise)).all()
            grew += np.count_nonzero(after[m] > gains[m] + 1e-7)
        assert grew > 0  # some do gain more than before


@pytest.mark.full
@pytest.mark.parametrize("kind", ["image", "ground"])
def test_bounds_and_turns_change_nothing_but_the_evaluations(kind, hands, monkeypatch):
    """Against one compiled loop that evaluates everything, and again all that was touched."""
    state, candidates = on(kind, 7, hands)
    assert len(candidates.first) >= MANY
    limits = SearchLimits(min_gain=1e-5)
    found = greedy.search(SearchProblem(state, candidates, limits, max_steps=6, fine=2))
    monkeypatch.setattr(evaluate, "MANY", 10**9)  # no bounds
    state, limits = replace(state, carry_over=None), SearchLimits(min_gain=1e-5)
    whole = greedy.run(state, candidates, limits, max_steps=6, fine=jnp.int32(2))
    assert int(found.steps) == 6
    for name in ("steps", "move", "node", "strength", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert int(found.evaluations) < 0.8 * int(whole.evaluations)


def test_zeros_around_an_effect_change_nothing(hands):
    """Moves share windows larger than their own: what each changes is what it would alone."""
    rng = np.random.default_rng(1)
    moves = [(0, None), (0, 0.5), (1, None)]
    image, goal = rough(rng, SMALL.shape, 6.0), rough(rng, SMALL.shape, 6.0)
    state, candidates = dense(hands, image, goal, moves)
    assert len(state.kernels) < 2 * len(moves)
    for m, (action, yaw) in enumerate(moves):
        hand = hands.predictors[action]
        effect = (hand if yaw is None else hand.turned(yaw)).on_grid()
        places = candidates.of_move(m)
        for place in places[:: max(len(places) // 5, 1)].tolist():
            (row, column), (rows, columns) = place, state.moves[m].shape
            window = np.s_[row : row + rows, column : column + columns]
            alone = np.array(state.now)
            alone[window] = state.seen(effect(jnp.asarray(alone[window]), place, 1.0))
            there = state.act(m, state.now, jnp.asarray(place, jnp.int32), 1.0)
            np.testing.assert_allclose(there, alone, atol=1e-7)


@pytest.mark.full
def test_another_mask_grid_or_list_of_strengths_compiles_nothing(hands):
    rng = np.random.default_rng(2)
    image, goal = rough(rng, SMALL.shape, 6.0), rough(rng, SMALL.shape, 6.0)
    compiled = []
    compiling.listen(lambda: compiled.append(1))

    def planned(**named):
        return plan(image, goal, **options(bank=hands, max_steps=4, yaws=2, **named))

    assert len(planned(stride=3)) == 4 and compiled
    compiled.clear()
    mask = np.zeros(SMALL.shape, bool)
    mask[:, :70] = True
    for named in ({"reachable": mask}, {"strengths": (0.3, 0.9)}, {"clearance_mm": 15.0}):
        assert planned(stride=3, **named).actions
    assert planned(stride=4).actions
    assert not compiled
    jax.block_until_ready(jax.jit(lambda x: x + 1)(jnp.zeros(7)))
    assert compiled  # it would have been noticed
