"""Batches: which actions may go without a look in between, and what a look says of each of them."""

from dataclasses import fields

import jax
import numpy as np
import pytest

from jshape import JShapeError, load_bank, metric, options, plan
from jshape.actions import PlacedAction
from jshape.planning.api import rollout
from jshape.planning.batch import batched, nearest
from jshape.planning.plan import Plan
from jshape.robot.loop import Stop, mold
from jshape.robot.simulated import SimulatedWorld

FAR = [(91, 92), (239, 197), (387, 302), (91, 302)]


@pytest.fixture(scope="module")
def bed(bank):
    return np.full(bank.camera.shape, 0.5, np.float32)


def of_pokes(bank, bed, places):
    return rollout(bed, 0.8 * bed, ["poke"] * len(places), places, bank=bank)


def same(one, other):
    assert one.actions == other.actions
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_allclose(one.distances, other.distances, atol=1e-6)
    np.testing.assert_allclose(one.images, other.images, atol=1e-6)


def test_actions_that_meet_none_go_first_and_bring_the_same(bank, bed):
    w, h = bank.roi("poke")
    (u, v), near = FAR[0], (FAR[0][0] + w // 2, FAR[0][1])
    made = of_pokes(bank, bed, [(u, v), near, FAR[1], (u, v), FAR[2], FAR[3]])
    found, count = batched(made, 3)
    order = [0, 2, 4, 1, 3, 5]
    assert count == 3
    same(found, of_pokes(bank, bed, made.positions[order]))
    found, count = batched(made, 3, reorder=False)
    assert found is made and count == 1
    assert batched(made, 9)[1] == 4  # `near` meets the first, and the fourth both of them
    assert batched(made, 1) == (made, 1) and batched(made.rest(6), 4)[1] == 0


@pytest.mark.parametrize("apart", [0, 1])
def test_rois_side_by_side_do_not_meet(bank, bed, apart):
    w, _ = bank.roi("poke")
    u, v = FAR[1]
    made = of_pokes(bank, bed, [(u, v), (u + w - 1 + apart, v)])
    assert batched(made, 2)[1] == 1 + apart
    if apart:
        by = nearest(list(made), bed.shape)
        for k in range(2):
            assert (by[made.images[k + 1] != made.images[k]] == k).all()


def test_a_carry_is_done_whole(bank, bed):
    made = of_pokes(bank, bed, FAR)
    acts = [PlacedAction("poke", place) for place in FAR]
    strokes = np.zeros((4, 2), np.float32)
    strokes[1] = np.subtract(FAR[2], FAR[1])
    carrying = Plan(**{**vars_of(made), "strokes": strokes})
    assert [act.carries for act in carrying] == [False, True, False, False] and len(acts) == 4
    found, count = batched(carrying, 2)  # of the carry only a half would fit
    assert count == 2 and [act.position for act in found][:2] == [FAR[0], FAR[3]]
    assert [act.carries for act in found] == [False, False, True, False]
    assert batched(carrying, 3)[1] == 3 and batched(carrying, 3)[0][1].carries


def vars_of(made):

    return {one.name: getattr(made, one.name) for one in fields(made)}


def test_a_plan_without_images_changes_no_order(bank, bed, tmp_path):
    w, _ = bank.roi("poke")
    (u, v) = FAR[0]
    of_pokes(bank, bed, [(u, v), (u + w // 2, v), FAR[1]]).to_json(tmp_path / "p", images=False)
    with pytest.raises(JShapeError, match="stored without its images"):
        batched(Plan.from_json(tmp_path / "p"), 2)


class Recorded(SimulatedWorld):
    """Notes what is asked of it; its looks have no noise and its hand no errors."""

    def __init__(self, *args):
        super().__init__(*args, spread=0.0, noise=0.0, frames=1)
        self.said = ""

    def look(self):
        self.said += "l"
        return super().look()

    def act(self, *args, **how):
        self.said += "a"
        super().act(*args, **how)


@pytest.fixture(scope="module")
def problem():
    from jshape import sim

    bank = load_bank("pressed-flour-robot")
    start = sim.flat_bed()
    other = SimulatedWorld(jax.random.key(1), start)
    for place in FAR:
        other.act("press", place)
    depth = other.look()
    goal = np.asarray(
        metric.weigh(bank.camera.luminance(np.where(depth > 0, depth, 0.45)), bank.camera)
    )
    return bank, start, goal


@pytest.mark.parametrize("planner", ["greedy", "refine"])
def test_the_loop_looks_after_each_batch(problem, planner):
    bank, start, goal = problem
    how = options(max_steps=5, strengths=(1.0,), yaws=1, stride=40, planner=planner)
    runs = []
    for batch in (1, 3):
        world = Recorded(jax.random.key(0), start)
        runs.append(mold(world, goal, bank, batch=batch, **how))
        assert world.said.startswith("la" + "l" * (batch == 1) + "a")
        assert world.said.count("a") == len(runs[-1].steps)
    assert world.said.count("l") < len(runs[1].steps)
    for run in runs:
        assert len(run.images) == len(run.depths) == len(run.seen) == len(run.steps) + 1
        assert run.distances_mm[-1] < 0.6 * run.distances_mm[0]
        np.testing.assert_allclose(run.distances_mm[1:], [s.obtained_mm for s in run.steps])
        np.testing.assert_allclose(run.distances_mm[:-1], [s.before_mm for s in run.steps])
    assert runs[1].distances_mm[-1] < 1.1 * runs[0].distances_mm[-1]


def test_a_look_after_a_batch_tells_what_each_action_did(problem):
    """As looks after each would have, where the hand repeats itself."""
    bank, start, goal = problem
    image = np.asarray(
        metric.weigh(bank.camera.luminance(np.full(bank.camera.shape, 0.45)), bank.camera)
    )
    first = rollout(image, goal, ["press"] * 4, FAR, bank=bank)
    seen = []
    for batch in (1, 4):
        world = Recorded(jax.random.key(0), start)
        run = mold(world, goal, bank, first=first, replan=False, batch=batch)
        assert run.stop is Stop.PLAN_ENDED and world.said == ("lalalalal", "laaaal")[batch == 4]
        seen.append(run)
    one, four = seen
    np.testing.assert_allclose(four.distances_mm, one.distances_mm, rtol=0.01)
    by = nearest(list(first), image.shape)
    for k in range(4):
        np.testing.assert_allclose(four.images[k + 1][by <= k], one.images[-1][by <= k], atol=0.02)
        np.testing.assert_array_equal(four.images[k + 1][by > k], four.images[0][by > k])


def test_a_person_may_decline_within_a_batch(problem):
    bank, start, goal = problem
    asked = []

    def agree(ahead):
        asked.append(ahead[0].position)
        return len(asked) < 3

    world = Recorded(jax.random.key(0), start)
    how = options(max_steps=5, strengths=(1.0,), yaws=1, stride=40)
    run = mold(world, goal, bank, batch=4, confirm=agree, **how)
    assert run.stop is Stop.DECLINED and world.said == "laal" and len(run.steps) == 2
    assert len(set(asked)) == 3


@pytest.mark.parametrize("batch", [0, -1, True])
def test_a_batch_that_is_none_is_refused(problem, batch):
    bank, start, goal = problem
    with pytest.raises(JShapeError, match="batch is .*; it must be a whole number from 1"):
        mold(Recorded(jax.random.key(0), start), goal, bank, batch=batch)


def test_plans_and_batches_agree_on_what_is_left(problem):
    """Actions that change places leave a plan's end as it is."""
    bank, start, goal = problem
    image = np.full_like(goal, np.median(goal))
    made = plan(image, goal, bank=bank, **options(max_steps=6, strengths=(1.0,), yaws=1, stride=40))
    found, count = batched(made, 4)
    assert count >= 2
    np.testing.assert_allclose(found.images[-1], made.images[-1], atol=1e-6)
    np.testing.assert_allclose(found.distances[-1], made.distances[-1], atol=1e-6)
    exact = rollout(image, goal, list(found), bank=bank)
    np.testing.assert_allclose(found.distances, exact.distances, atol=1e-5)


def test_a_batch_keeps_to_the_actions_that_are_left(problem):
    bank, start, goal = problem
    first = rollout(np.full_like(goal, np.median(goal)), goal, ["press"] * 4, FAR, bank=bank)
    world = Recorded(jax.random.key(0), start)
    run = mold(world, goal, bank, first=first, batch=3, **options(max_steps=2))
    assert run.stop is Stop.MAX_STEPS and world.said == "laal" and len(run.steps) == 2
