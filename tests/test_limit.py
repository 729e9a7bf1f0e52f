"""Limits hold: no sequence of actions ends below them, and linear programs say the same."""

import itertools
import json
from functools import partial

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jshape
from jshape import HeightMap, SearchSpace, distance, limit
from jshape.cli.main import main
from jshape.errors import BadOption, JShapeError
from jshape.io.maps import write_map
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.planning import limit as limits
from jshape.planning.ascent import climbed
from jshape.planning.certificate import certified
from jshape.planning.coarse import Allowance, LevelChange
from jshape.planning.inputs import search_inputs
from jshape.planning.options import Constraints, StopCriteria
from jshape.planning.relaxation import level_changes, solved
from tests.reference import limit as reference
from tests.test_search_state import CAMERA, QUARTER, knock_and_poke

ONCE = SearchSpace(stride=1, strengths=(1.0,), yaws=1)
"""Every place, one strength: what brute force can try."""


def craters(camera=CAMERA, *sizes):
    """A bank of dents with low rims, in I: what it does is the same on every bed."""

    def dent(w, h, depth):
        x, y = np.linspace(-2, 2, w), np.linspace(-2, 2, h)
        far = x**2 + y[:, None] ** 2
        return Difference(jnp.asarray(-depth * (1 - 0.4 * far) * np.exp(-far / 2), jnp.float32))

    predictors = tuple(dent(*one) for one in sizes)
    return Bank(camera, predictors, tuple(f"a{k}" for k in range(len(sizes))))


SMALL = craters(CAMERA, (9, 7, 0.10), (5, 5, 0.06))


def hole(rng, rows=slice(5, 12), columns=slice(6, 18)):
    now = np.full(CAMERA.shape, 0.5, np.float32)
    goal = now.copy()
    goal[rows, columns] -= 0.08
    return now, goal + rng.normal(0, 0.003, goal.shape).astype(np.float32)


def all_sequences(bank, now, goal, steps):
    """The least distance that any sequence of actions leaves, at any places, in plain NumPy."""
    least, (rows, columns) = float(np.abs(now - goal).mean()), now.shape
    moves = []
    for predictor in bank.predictors:
        change = np.asarray(predictor.delta)
        h, w = change.shape
        moves += [(change, v, u) for v in range(rows - h + 1) for u in range(columns - w + 1)]
    wholes = np.zeros((len(moves), rows, columns), np.float32)
    for whole, (change, v, u) in zip(wholes, moves, strict=True):
        whole[v : v + change.shape[0], u : u + change.shape[1]] = change
    for count in range(1, steps + 1):
        for first in itertools.combinations_with_replacement(range(len(moves)), count - 1):
            bed = now + wholes[list(first)].sum(0)
            least = min(least, float(np.abs(bed + wholes - goal).mean((1, 2)).min()))
    return least


@pytest.mark.parametrize("steps", [1, 2])
def test_no_sequence_of_actions_is_below_the_limit(rng, steps):
    now, goal = hole(rng)
    found = limit(now, goal, bank=SMALL, max_steps=steps, space=ONCE)
    least = all_sequences(SMALL, now, goal, steps) / float(distance(now, goal))
    assert 0.3 < found.left <= least + 1e-6, (found.bounds, least)


def problem_of(bank, now, goal, steps, **how):
    space = how.pop("space", ONCE)
    constraints, stop = Constraints(**how), StopCriteria(max_steps=steps)
    state, candidates, limited, _ = search_inputs(
        bank, now, goal, None, "greedy", space, constraints, stop
    )
    changes = level_changes(state, candidates, space.strengths)
    r = np.asarray(state.goal, np.float64) - np.asarray(state.now, np.float64)
    weight = np.full(r.shape, 1 / r.size) if state.weight is None else np.asarray(state.weight)
    return r, weight.astype(np.float64), changes, limits._allowance(state, limited, steps)


@pytest.mark.parametrize(
    ("steps", "most"), [(1, None), (4, None), (16, None), (4, {"a0": 1}), (3, {"a1": 0})]
)
def test_what_is_proven_is_below_the_linear_program_and_near_it(rng, steps, most):
    r, weight, changes, uses = problem_of(SMALL, *hole(rng), steps, max_uses=most)
    found = solved(r, weight, changes, uses)
    first = certified(r, weight, changes, uses, found.plain, found.beyond)
    proven = certified(r, weight, changes, uses, *climbed(r, weight, changes, uses, found))
    exact = reference.relaxed(r, weight, changes, uses)
    start = float((weight * np.abs(r)).sum())
    left = float((weight * found.left).sum())
    assert exact - 0.15 * start < first + 0.07 * start < proven <= exact + 1e-9
    assert exact - 0.05 * start < proven
    assert exact - 0.02 * start < left < exact + 0.1 * start  # u at three levels of r only


def test_any_map_proves_something_that_is_true(rng):
    r, weight, changes, uses = problem_of(SMALL, *hole(rng), 4)
    exact = reference.relaxed(r, weight, changes, uses)
    maps = [rng.normal(size=r.shape), np.sign(r), np.full(r.shape, 1e6), 0 * r]
    for plain, beyond in itertools.product(maps, repeat=2):
        assert certified(r, weight, changes, uses, plain, beyond) <= exact + 1e-9
    assert certified(r, weight, changes, uses, np.sign(r), 0 * r) < exact


@given(st.lists(st.floats(-2, 2), max_size=6), st.floats(-2, 2).filter(lambda r: abs(r) > 1e-3))
def test_no_order_of_actions_leaves_less_than_the_inequality_says(changes, r):
    """The one that the relaxation is made of (see its docstring), at one node."""
    c = np.sign(r) * np.array(changes)
    useful = np.minimum(np.maximum(c, 0), abs(r)).sum()
    assert abs(abs(r) - c.sum()) >= abs(r) - 2 * useful + c.sum() - 1e-9


def test_carried_material_is_no_more_than_was_taken(rng):
    """A dent takes material out, a heap brings some: with a stock more can be brought."""
    dent = np.outer(np.hanning(7), np.hanning(7))
    places = np.ones((12, 18), bool)
    changes = [
        LevelChange(0, 1.0, 0.010 * dent, places, (0, 0)),
        LevelChange(1, 1.0, -0.015 * dent, places, (0, 0)),
    ]
    r, weight = np.zeros((18, 24)), np.full((18, 24), 1 / 432)
    r[4:12, 6:16] = -0.02
    proven = []
    for stock in (0.0, 0.3, 10.0):
        uses = Allowance(6, np.full(2, np.inf), frozenset({0, 1}), stock, 1.0)
        found = solved(r, weight, changes, uses)
        multipliers = climbed(r, weight, changes, uses, found)
        proven.append(certified(r, weight, changes, uses, *multipliers))
        exact = reference.relaxed(r, weight, changes, uses)
        assert exact - 0.06 * np.abs(r).mean() < proven[-1] <= exact + 1e-9
    assert proven[0] > proven[1] > proven[2]


@pytest.fixture(scope="module")
def pressed():
    return knock_and_poke()


def metres(change, camera=QUARTER):
    """I of a level bed, and of one whose depth differs by `change` metres."""
    depth = np.full(camera.shape, 0.45, np.float32)
    now, goal = (
        np.asarray(jshape.weigh(camera.luminance(z, quantize=False), camera), np.float32)
        for z in (depth, depth + change)
    )
    return now, goal


def test_a_mound_needs_material_that_a_pressing_bank_does_not_have(pressed):
    change = np.zeros(QUARTER.shape, np.float32)
    change[30:60, 40:80] = -0.01
    now, goal = metres(change)
    found = limit(now, goal, bank=pressed, max_steps=4)
    named = {one.name: one.left for one in found.bounds}
    assert found.left > 0.8 and named["material"] > 0.8
    assert max(found.shares, key=found.shares.get) == "needs material"
    middle = np.s_[33:57, 43:77]
    assert found.mask[middle].all() and not found.mask[:20].any()
    assert found.remains_mm[middle].max() < -3  # the bed is too low
    plan = jshape.plan(now, goal, bank=pressed, **jshape.options(max_steps=4, min_gain_mm=0.0))
    assert plan.distances[-1] / plan.distances[0] >= found.left - 0.01


def test_of_a_goal_that_no_action_helps_all_remains(rng):
    """Not 105 % of it: no fractions are as good as those that are found."""
    now, goal = hole(rng)
    goal = 2 * now - goal
    found = limit(now, goal, bank=SMALL, max_steps=4, space=ONCE)
    assert found.left <= found.fractions <= 1 + 1e-6
    assert found.fractions > 0.99
    np.testing.assert_allclose(found.remains_mm, found.wanted_mm, atol=0.5)


def test_the_material_bound_is_the_least_of_a_linear_program(rng, pressed):
    change = np.zeros(QUARTER.shape, np.float32)
    change[30:60, 40:80] = -0.012
    now, goal = metres(change)
    r, weight, changes, uses = problem_of(pressed, now, goal, 2)
    state, *_ = search_inputs(
        pressed, now, goal, None, "greedy", ONCE, Constraints(), StopCriteria()
    )
    found = limits._material(state, changes, weight, uses)
    inside = weight > 0
    room = float(state.limits[1]) - np.asarray(state.goal, np.float64)[inside]
    rise = max(0.0, *(-one.change.sum() for one in changes))
    expected = reference.least_left(weight[inside], room, -r.sum() - uses.steps * rise)
    assert found == pytest.approx(expected, rel=1e-5) and found > 0


def test_a_goal_that_one_action_makes_has_no_limit_above_what_it_leaves(pressed):
    now, _ = metres(np.zeros(QUARTER.shape, np.float32))
    w, h = pressed.roi("knock")
    goal, window = now.copy(), np.s_[40 - h // 2 : 40 - h // 2 + h, 60 - w // 2 : 60 - w // 2 + w]
    goal[window] = pressed.predict("knock", now[window], position=(60, 40))
    found = limit(now, goal, bank=pressed, max_steps=1)
    plan = jshape.plan(now, goal, bank=pressed, **jshape.options(max_steps=1))
    assert plan.actions == ("knock",)
    # The place is between two nodes; those of the relaxation are not.
    assert found.left <= plan.distances[-1] / plan.distances[0] + 0.01


def test_more_actions_never_raise_what_one_map_proves_and_limits_fall(rng, pressed):
    change = np.zeros(QUARTER.shape, np.float32)
    change[20:75, 20:100] = 0.012
    now, goal = metres(change)
    lefts = [limit(now, goal, bank=pressed, max_steps=k).left for k in (0, 1, 2, 4)]
    assert lefts[0] == 1.0 and all(np.diff(lefts) < 0.02) and lefts[-1] < lefts[0]
    r, weight, changes, uses = problem_of(pressed, now, goal, 1)
    maps = solved(r, weight, changes, uses)[:2]
    proven = [certified(r, weight, changes, uses._replace(steps=k), *maps) for k in range(6)]
    assert all(np.diff(proven) <= 1e-12)


def test_where_no_hand_may_go_everything_stays(pressed):
    change = np.zeros(QUARTER.shape, np.float32)
    change[10:30, 10:30] = 0.01
    now, goal = metres(change)
    mask = np.zeros(QUARTER.shape, bool)
    mask[70:, 90:] = True
    found = limit(now, goal, bank=pressed, constraints=Constraints(reachable=mask))
    assert found.by == "window" and found.left == pytest.approx(1.0, abs=1e-6)
    assert found.shares == {"out of reach": pytest.approx(1.0)}


def test_what_lies_beyond_the_view_is_not_missing_in_it(pressed):
    """The map goes on beyond the image as at its edge: a wall there asks for no material."""
    change = np.zeros(QUARTER.shape, np.float32)
    change[:, :4] = -0.01
    change[30:60, 40:80] = 0.012
    now, goal = metres(change)
    found = limit(now, goal, bank=pressed)
    plan = jshape.plan(now, goal, bank=pressed)
    assert found.left <= plan.distances[-1] / plan.distances[0] < 1
    assert {one.name: one.left for one in found.bounds}["material"] < 0.5


def test_of_a_goal_that_is_there_nothing_can_be_covered(pressed):
    now = np.full(QUARTER.shape, 0.5, np.float32)
    assert np.isnan(limit(now, now, bank=pressed).efficiency(0.0))


def test_the_window_bound_knows_how_often_an_action_may_be_used(pressed):
    change = np.zeros(QUARTER.shape, np.float32)
    change[5:90, 5:110] = 0.01
    now, goal = metres(change)

    def window(steps, **uses):
        most = dict.fromkeys(pressed.actions, 0) | uses
        found = limit(
            now, goal, bank=pressed, max_steps=steps, constraints=Constraints(max_uses=most)
        )
        return found.bounds[0].left

    knock, poke = window(1, knock=9), window(1, poke=9)
    assert 0 < knock < poke < 1
    assert window(9, knock=1) == pytest.approx(knock)
    assert window(9, knock=1, poke=2) == pytest.approx(knock - 2 * (1 - poke), abs=1e-6)
    assert window(2, knock=1, poke=2) == pytest.approx(knock - (1 - poke), abs=1e-6)


def test_where_nothing_is_allowed_all_stays(pressed):
    """Also where the coarse map of the relaxation has no place left."""
    now = np.full(QUARTER.shape, 0.5, np.float32)
    goal = now.copy()
    goal[30:60, 40:70] -= 0.1
    none = jshape.options(max_uses=dict.fromkeys(pressed.actions, 0))
    found = limit(now, goal, bank=pressed, max_steps=4, **none)
    assert found.left == 1.0 and found.fractions == pytest.approx(1.0)
    assert found.shares == {"out of reach": pytest.approx(1.0)}
    one = jshape.options(positions={pressed.actions[0]: [(60, 49)]}, strengths=(1.0,), yaws=1)
    found = limit(now, goal, bank=pressed, max_steps=4, **one)
    assert 0 <= found.left <= found.fractions <= 1 + 1e-6


def test_equal_images_and_height_maps(pressed):
    now, _ = metres(np.zeros(QUARTER.shape, np.float32))
    same = limit(now, now, bank=pressed)
    assert same.left == 0 and not same.mask.any() and same.shares == {}
    heights = np.zeros((80, 100), np.float32)
    wanted = heights.copy()
    wanted[30:50, 40:60] = 0.01
    found = limit(HeightMap(heights, 0.004), HeightMap(wanted, 0.004), bank=pressed, max_steps=3)
    assert found.left > 0.7 and found.mask.shape == (80, 100)


def test_what_is_refused(pressed):
    now, _ = metres(np.zeros(QUARTER.shape, np.float32))
    with pytest.raises(BadOption, match="max_stepss"):
        limit(now, now, bank=pressed, max_stepss=3)
    with pytest.raises(JShapeError, match="max_steps is -1"):
        limit(now, now, bank=pressed, max_steps=-1)
    with pytest.raises(JShapeError, match="wanted has shape"):
        limit(now, now[1:], bank=pressed)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Height maps of a level bed, and of one with a mound, in the working directory."""
    monkeypatch.chdir(tmp_path)
    heights = np.zeros((80, 100), np.float32)
    write_map("now.npz", HeightMap(heights, 0.004))
    heights[30:50, 40:60] = 0.01
    write_map("wanted.npz", HeightMap(heights, 0.004))
    return tmp_path


def test_the_command_says_draws_and_tells_programs_the_limit(folder, capsys):
    words = ["limit", "now.npz", "wanted.npz", "--max-steps", "4"]
    assert main([*words, "--out", "limit.png"]) == 0
    said = capsys.readouterr().out
    assert "at most 4 actions" in said and "no plan of 4 actions leaves less than" in said
    assert "needs material" in said and "picture: limit.png" in said
    assert cv2.imread("limit.png").shape[0] > 300
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["left"] == max(one["left"] for one in told["bounds"]) > 0.7
    assert [one["name"] for one in told["bounds"]] == ["window", "material", "shape"]
    assert told["by"] in said and f"{told['left']:.1%}" in said


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--out", "limit.pdf"], "limit.pdf: a picture's file ends in .png"),
        (["--out", "old.png"], "old.png: exists"),
        (["--stock-cm3", "5"], "stock_cm3 has no effect: the bank has no actions that take"),
        (["--camera-file", "x.json"], "--camera-file: for frames"),
        (["--planner", "refine"], "unknown option --planner"),
    ],
)
def test_what_the_command_refuses(folder, capsys, words, match):
    (folder / "old.png").write_bytes(b"")
    assert main(["limit", "now.npz", "wanted.npz", *words]) == 2
    assert match in capsys.readouterr().err


def test_work_that_nobody_waits_for_ends(rng):
    """Both in the search for multipliers and in what they prove."""
    calls = []
    limits.limit_images(SMALL, *hole(rng), None, space=ONCE, check=lambda: calls.append(None))
    assert len(calls) > 50
    for stop in (3, len(calls)):
        left = partial(next, iter(range(stop - 1)))
        with pytest.raises(StopIteration):
            limits.limit_images(SMALL, *hole(rng), None, space=ONCE, check=left)
