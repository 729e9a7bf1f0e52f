"""Carries: two actions as one candidate."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jshape
from jshape import PAPER_BOX, Camera, JShapeError
from jshape.errors import BadBank, UnknownName
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.planning import problem
from jshape.planning.candidates import dense_positions
from jshape.planning.evaluate import candidates_at, sweep
from jshape.planning.problem import carries
from jshape.planning.state import search_state
from tests.reference import transfer as twin

CAMERA = Camera(48, 40, 30.0, 30.0, 24.0, 20.0, 0.42, 0.47)
STRENGTHS = (0.5, 1.0, 2.0)
FREE = {"min_gain_mm": 0.0, "error_margin": 0.0, "yaws": 1}


def blob(h, w, height):
    y, x = np.linspace(-2, 2, h)[:, None], np.linspace(-2, 2, w)
    return (height * np.exp(-(x**2) - y**2)).astype(np.float32)


TAKE, BRING, KNOCK = blob(9, 9, -0.1), blob(7, 7, 0.12), blob(5, 5, -0.2)


@pytest.fixture
def bank():
    predictors = (Difference(jnp.asarray(one)) for one in (KNOCK, TAKE, BRING))
    return Bank(CAMERA, tuple(predictors), ("knock", "scoop", "pour"))


def moved(image, p, s, q):
    """The image after a carry from p to q."""
    after = twin.put(image, TAKE, p, s)
    x = -(after - image).sum() / BRING.sum()
    return twin.put(after, BRING, q, x).astype(np.float32), x


@pytest.mark.parametrize(("p", "q"), [((12, 10), (33, 27)), ((20, 18), (25, 19))])
def test_a_carry_is_found_as_by_trying_all_pairs(bank, p, q):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal, x = moved(now, p, 1.0, q)
    where = dense_positions(bank, 2)
    gain, pair = twin.best(now, goal, TAKE, BRING, (where["scoop"], where["pour"]), STRENGTHS)
    assert pair == (p, 1.0, q, pytest.approx(x, rel=1e-5))
    plan = jshape.plan(
        now,
        goal,
        bank=bank,
        **jshape.options(positions=where, strengths=STRENGTHS, max_steps=2, **FREE),
    )
    assert plan.actions == ("scoop", "pour") and plan.positions.tolist() == [list(p), list(q)]
    np.testing.assert_allclose(plan.strengths, [1.0, x], rtol=1e-4)
    assert plan.distances[0] - plan.distances[-1] == pytest.approx(gain, rel=1e-4)
    np.testing.assert_allclose(plan.strokes, [np.subtract(q, p), (0, 0)])
    assert abs(plan.images[-1].sum() - now.sum()) < 1e-3  # nothing lost, nothing made
    dug, heaped = plan.volumes_cm3
    assert dug < 0 < heaped and heaped == pytest.approx(-dug, rel=0.03)  # I is weighed


def test_on_a_random_bed_little_is_missed(bank, rng):
    """The tables propose the places: nearly always the best pair, or one almost as good."""
    shares = []
    where = dense_positions(bank, 3)
    for _ in range(6):
        now = rng.uniform(0.3, 0.7, (5, 6)).repeat(8, 0).repeat(8, 1).astype(np.float32)
        goal = rng.uniform(0.3, 0.7, (5, 6)).repeat(8, 0).repeat(8, 1).astype(np.float32)
        gain, _ = twin.best(now, goal, TAKE, BRING, (where["scoop"], where["pour"]), STRENGTHS)
        only = jshape.options(
            positions=where | {"knock": where["knock"][:0]},
            strengths=STRENGTHS,
            max_steps=2,
            **FREE,
        )
        plan = jshape.plan(now, goal, bank=bank, **only)
        assert plan.actions == ("scoop", "pour")
        shares.append((plan.distances[0] - plan.distances[2]) / gain)
        assert shares[-1] <= 1 + 1e-4
    assert np.mean(shares) > 0.97 and min(shares) > 0.85


def test_a_single_action_that_gains_more_than_half_comes_first(bank):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal = twin.put(moved(now, (12, 10), 0.5, (34, 28))[0], KNOCK, (40, 8), 2.0)
    how = jshape.options(stride=2, strengths=STRENGTHS, **FREE)
    plan = jshape.plan(now, goal.astype(np.float32), bank=bank, **how)
    assert plan.actions[0] == "knock" and plan.actions[1:3] == ("scoop", "pour")
    alone = jshape.plan(
        now,
        goal.astype(np.float32),
        bank=bank,
        **jshape.options(how, max_steps=2, max_uses={"knock": 1}),
    )
    assert alone.actions == ("knock",)  # no room for both of a carry


def test_without_pairs_its_actions_are_single_ones(bank):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal = twin.put(now, BRING, (34, 28), 1.0).astype(np.float32)
    how = jshape.options(stride=2, strengths=STRENGTHS, max_steps=1, **FREE)
    assert jshape.plan(now, goal, bank=bank, **how).actions == ()
    plan = jshape.plan(now, goal, bank=bank, **jshape.options(how, carries={}))
    assert plan.actions == ("pour",) and not plan.strokes.any()


@pytest.mark.full
@pytest.mark.parametrize("planner", ["careful", "refine"])
def test_other_planners_keep_carries_whole(bank, planner):
    """What greedy's tables miss by a node or two is found, and nothing is lost or made."""
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal = moved(moved(now, (12, 10), 1.0, (33, 27))[0], (33, 10), 0.8, (11, 28))[0]
    goal = twin.put(goal, KNOCK, (23, 20), 1.3).astype(np.float32)
    where = dense_positions(bank, 4)
    how = jshape.options(positions=where, strengths=STRENGTHS, max_steps=6, **FREE)
    found, first = (
        jshape.plan(now, goal, bank=bank, planner=one, **how) for one in (planner, "greedy")
    )
    assert found.distances[-1] <= first.distances[-1] * (1 + 1e-5)
    assert "scoop" in found.actions
    for act, after in zip(found, [*found][1:] + [None], strict=True):
        assert act.carries == (act.action == "scoop")
        assert not act.carries or after.action == "pour"
    changes = np.diff([image.sum() for image in found.images])
    of_carries = [name != "knock" for name in found.actions]
    assert abs(changes[of_carries].sum()) < 1e-3 * np.abs(changes[of_carries]).sum()
    if planner == "refine":
        assert found.distances[-1] < 0.9 * first.distances[-1]
    with pytest.raises(
        JShapeError, match=f"only greedy uses a stock, and the planner is {planner}"
    ):
        jshape.plan(now, goal, bank=bank, planner=planner, **jshape.options(how, stock_cm3=3.0))


@pytest.mark.full
def test_hands_are_turned_and_paths_stretched_only_where_several_are_tried(moving):
    """A sweep in a direction and of a length between those tried is found by descent alone."""
    bank = replace(
        moving, actions=("sweep",), predictors=(moving.predictor("sweep"),), errors_mm=None
    )
    level = np.full(bank.camera.shape, 0.5, np.float32)
    middle = (bank.camera.width // 2, bank.camera.height // 2)
    made = {"yaws": [0.4], "lengths": [1.15], "strengths": [1.0]}
    goal = jshape.rollout(level, level, ["sweep"], [middle], **made, bank=bank).images[-1]
    how = jshape.options(positions=[middle], strengths=(0.8, 1.2), max_steps=1)
    left = {}
    for name, space in (
        ("all", {"yaws": 4, "lengths": (1.0, 1.6)}),
        ("none", {"yaws": 1, "lengths": (1.0,)}),
    ):
        space = jshape.options(how, min_gain_mm=0.0, **space)
        plan = jshape.plan(level, goal, bank=bank, planner="refine", **space)
        left[name] = plan.distances[-1] / plan.distances[0]
        assert plan.actions == ("sweep",)
    assert (plan.yaws == 0).all() and (plan.lengths == 1).all()
    assert left["all"] < 0.15 < 0.4 < left["none"]


def test_uses_of_either_action_limit_the_pairs(bank):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal, _ = moved(now, (12, 10), 1.0, (34, 28))
    goal, _ = moved(goal, (36, 10), 1.0, (12, 30))
    for uses, pairs in (({"scoop": 1}, 1), ({"pour": 0}, 0), ({}, 2)):
        how = jshape.options(stride=2, strengths=STRENGTHS, max_uses=uses, max_steps=4, **FREE)
        plan = jshape.plan(now, goal, bank=bank, **how)
        assert plan.actions.count("scoop") == plan.actions.count("pour") == pairs


def test_pairs_that_make_no_sense_are_refused(bank):
    assert carries(bank, None) == ((1, 2),)
    with pytest.raises(UnknownName, match="shovel"):
        carries(bank, {"shovel": "pour"})
    with pytest.raises(JShapeError, match="both takes material out and brings it"):
        carries(bank, {"scoop": "pour", "pour": "scoop"})


QUARTER = replace(PAPER_BOX, width=120, height=98, fx=433 / 4, fy=433 / 4, u0=240 / 4, v0=197 / 4)


@pytest.fixture(scope="module")
def moving():
    """Three of the bundled hands that move material, below a camera of a quarter of the pixels."""
    bank = jshape.load_bank("moving-flour-robot").seen_by(QUARTER, 0.45)
    names = ("sweep", "scoop", "pour")
    return replace(
        bank, actions=names, predictors=tuple(map(bank.predictor, names)), errors_mm=None
    )


@pytest.mark.full
def test_a_stock_is_used_as_far_as_it_lasts(moving):
    now = np.full(QUARTER.shape, 0.4, np.float32)
    goal = now.copy()
    goal[30:60, 40:80] = 0.6  # 9 mm higher, of 12 x 9 cm: about 100 cm³
    bank = replace(moving, actions=moving.actions[1:], predictors=moving.predictors[1:])
    how = jshape.options(max_steps=5, min_gain_mm=0.0, yaws=1, stride=4)
    plans = {
        stock: jshape.plan(now, goal, bank=bank, **jshape.options(how, stock_cm3=stock))
        for stock in (None, 40.0, 500.0)
    }
    singles = {stock: plan.actions[:1] == ("pour",) for stock, plan in plans.items()}
    assert singles == {None: False, 40.0: True, 500.0: True}
    assert plans[40.0].volumes_cm3.sum() <= 40.0 * 1.03
    assert plans[500.0].volumes_cm3.sum() > 80.0
    assert plans[500.0].distances[-1] < plans[40.0].distances[-1] < plans[None].distances[-1]


@pytest.mark.full
def test_what_a_longer_sweep_did_is_found_with_its_length_and_direction(moving):
    rng = np.random.default_rng(1)
    relief = ndimage.gaussian_filter(rng.normal(size=QUARTER.shape), 6)
    now = (0.5 + 0.1 * relief / relief.std()).astype(np.float32)
    done = jshape.rollout(now, now, ["sweep"], [(60, 50)], yaws=[np.pi], lengths=[1.6], bank=moving)
    assert done.strokes[0] == pytest.approx(
        (-1.6 * moving.predictor("sweep").path_mm * 1e-3 * float(QUARTER.scale(0.445)[0]), 0.0),
        rel=0.02,
        abs=0.01,
    )
    how = jshape.options(positions=[(60, 50), (50, 44)], strengths=[0.5, 1.0], max_steps=1)
    plan = jshape.plan(now, done.images[-1], bank=moving, **how)
    assert plan.actions == ("sweep",) and plan.positions.tolist() == [[60, 50]]
    assert (plan.lengths[0], plan.strengths[0]) == (pytest.approx(1.6), 1.0)
    assert (
        abs(plan.yaws[0]) == pytest.approx(np.pi) and plan.distances[-1] < 0.2 * plan.distances[0]
    )
    np.testing.assert_allclose(plan.strokes, done.strokes, atol=1e-3)


def test_a_stock_needs_a_bank_in_metres_and_actions_that_use_it(bank):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    with pytest.raises(BadBank, match="stock_cm3 is for banks that work in metres"):
        jshape.plan(now, now, bank=bank, **jshape.options(stock_cm3=100.0))
    with pytest.raises(JShapeError, match="no actions that take and bring"):
        jshape.plan(now, now, bank=bank, **jshape.options(stock_cm3=100.0, carries={}))
    with pytest.raises(JShapeError, match="stock_cm3 is -1.0; it must be a number from 0"):
        jshape.plan(now, now, bank=bank, **jshape.options(stock_cm3=-1.0))


def test_material_that_is_missing_elsewhere_is_carried_not_packed(bank, monkeypatch):
    """A knock gains more per action, but then nothing is left to fill the hollow with."""
    level = np.full(CAMERA.shape, 0.5, np.float32)
    dug = twin.put(level, TAKE, (12, 10), 1.0)
    heap = ndimage.gaussian_filter(moved(level, (12, 10), 1.0, (33, 27))[0] - dug, 1.5)
    goal = (dug + heap).astype(np.float32)
    deep = replace(bank, predictors=(Difference(jnp.asarray(1.2 * TAKE)), *bank.predictors[1:]))
    how = jshape.options(stride=2, strengths=(0.5, 0.8, 1.0, 2.0), max_steps=4, **FREE)
    plans = []
    for price in (0.0, problem.PRICE):
        monkeypatch.setattr(problem, "PRICE", price)
        plans.append(jshape.plan(level, goal, bank=deep, **how))
    packed, kept = plans
    assert packed.actions[0] == "knock" and kept.actions[:2] == ("scoop", "pour")
    assert kept.distances[-1] < 0.8 * packed.distances[-1]


@pytest.mark.parametrize(("missing", "share"), [(1.0, 1.0), (2.0, 1.0), (0.75, 0.5), (0.4, 0.0)])
def test_material_has_a_price_where_it_is_scarce(bank, missing, share):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal = now.copy()
    goal[:8, :8] -= 0.1
    goal[20:28, 20:28] += 0.1 * missing
    state = search_state(bank, now, goal)
    assert problem.price(state) == pytest.approx(-share * problem.PRICE, abs=1e-4)


def test_the_objective_is_d_and_the_price_of_what_was_lost(moving, rng):
    """What a candidate changes of it, from its window, is what its action changes of the map's."""
    now, goal = (rng.uniform(0.35, 0.65, (7, 8)).repeat(14, 0).repeat(15, 1) for _ in range(2))
    now, goal = (ndimage.gaussian_filter(one, 3).astype(np.float32) for one in (now, goal))
    state = replace(search_state(moving, now, goal), price=np.float32(0.7))
    where = {name: np.array([[60, 50], [50, 44]]) for name in moving.actions}
    candidates = candidates_at(state, moving, where, (0.5, 1.0))
    for number, changes in enumerate(sweep(state, candidates)):
        for first, row in zip(jnp.asarray(candidates.of_move(number)), changes, strict=True):
            for strength, change in zip((0.5, 1.0), row, strict=True):
                after = state.act(number, state.now, first, strength)
                whole = state.objective(after) - state.objective(state.now)
                assert float(change) == pytest.approx(float(whole), abs=2e-6)
    lost = ((state.now - state.goal) * state.weight).sum()
    free = replace(state, price=None)
    assert float(state.objective(state.now)) == pytest.approx(
        float(free.objective(state.now) + 0.7 * lost), rel=1e-5
    )
