"""Laws of all searches, on a bed small enough to search it dozens of times."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jshape import Camera, Status
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.planning.candidates import dense_positions
from jshape.planning.evaluate import candidates_at, empty_cache, evaluate, refresh, sweep
from jshape.planning.search import PLANNERS, refine
from jshape.planning.search.base import (
    UNLIMITED,
    Budget,
    SearchLimits,
    SearchProblem,
    compiled,
    empty_result,
)
from jshape.planning.search.local import begin_local, local_work, next_local
from jshape.planning.search.sequence import bounds, measured, numbers_of, pruned, without
from jshape.planning.search.step import resume
from jshape.planning.state import search_state

CAMERA = Camera(48, 40, 60.0, 60.0, 24.0, 20.0, 0.42, 0.47)
ROIS = ((15, 13), (9, 11), (7, 7))  # (w, h)
STRENGTHS = (0.6, 1.0, 1.4)
FREE = SearchLimits(errors=jnp.zeros(3), max_uses=jnp.full(3, UNLIMITED, jnp.int32))
WALL = 12
"""The hand does not reach columns to the left of this."""


@pytest.fixture(params=PLANNERS)
def planner(request):
    return request.param


def search(name, problem, budget=None):
    """A search with a budget of its own."""
    return PLANNERS[name](replace(problem, budget=budget or Budget()))


def crater(w, h, depth):
    x, y = np.linspace(-2, 2, w), np.linspace(-2, 2, h)[:, None]
    return Difference(jnp.asarray(-depth * np.exp(-(x**2) - y**2), jnp.float32))


BANK = Bank(
    CAMERA,
    tuple(crater(w, h, d) for (w, h), d in zip(ROIS, (0.15, 0.2, 0.25), strict=True)),
    ("knock", "press", "poke"),
)


def sequence(state, rows):
    """Rows of (move, (v, u), strength) as a search gives them."""
    found, count = empty_result(state, 8), len(rows)
    moves, nodes, strengths = zip(*rows, strict=True)
    return replace(
        found,
        steps=jnp.int32(count),
        move=found.move.at[:count].set(np.array(moves, np.int32)),
        node=found.node.at[:count].set(np.array(nodes, np.float32)),
        strength=found.strength.at[:count].set(np.array(strengths, np.float32)),
    )


def kernel_of(state, number):
    """A move's kernel and effect."""
    kernel, member = state.moves[number].evaluated
    return state.kernels[kernel], state.kernels[kernel].member(member)


def dense_within(reach):
    """Positions of every action at which the hand may be placed."""
    dense = dense_positions(BANK, 5).items()
    return {name: at[reach[at[:, 1], at[:, 0]]] for name, at in dense}


def made_problem(seed=0, count=5):
    """(problem, the goal's own sequence): at places and strengths between those that are tried."""
    rng = np.random.default_rng(seed)
    rough = gaussian_filter(rng.normal(size=CAMERA.shape), 3)
    now = jnp.asarray(0.6 + 0.03 * rough / rough.std(), jnp.float32)
    state = search_state(BANK, now, now)
    reach = np.ones(CAMERA.shape, bool)
    reach[:, :WALL] = False
    where = dense_within(reach)
    candidates = candidates_at(state, BANK, where, STRENGTHS, reach)
    low, high = (np.asarray(bound) for bound in bounds(state, candidates))
    own = sequence(
        state,
        [
            (move, rng.uniform(low[move, :2], high[move, :2]), rng.uniform(0.7, 1.3))
            for move in rng.integers(3, size=count)
        ],
    )
    goal = measured(state, own)[1]
    return SearchProblem(replace(state, goal=goal), candidates, FREE, max_steps=8, fine=2), own


def check(problem, found):
    """What holds of whatever any search finds."""
    steps = int(found.steps)
    assert 0 <= steps <= problem.max_steps
    move, node = np.asarray(found.move), np.asarray(found.node)
    assert (move[:steps] >= 0).all() and (move[steps:] == -1).all()
    move, node = move[:steps], node[:steps]
    if steps:
        low, high = (np.asarray(bound)[move] for bound in bounds(problem.state, problem.candidates))
        values = np.asarray(numbers_of(found))[:steps]
        assert (values >= low).all() and (values <= high).all()
        row, column = np.rint(node).astype(int).T
        assert np.asarray(problem.candidates.reachable)[row, column].all()
    used = np.bincount([problem.state.moves[m].action for m in move], minlength=3)
    assert (used <= np.asarray(problem.limits.max_uses)).all()
    again = measured(problem.state, found)[0].distance
    np.testing.assert_allclose(found.distance, again, atol=1e-6)
    assert float(found.distance) <= float(problem.state.distance) * (1 + 1e-6)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3))
def test_no_search_is_worse_than_greedy(planner, seed):
    problem, _ = made_problem(seed)
    found, first = search(planner, problem), search("greedy", problem)
    check(problem, found)
    assert int(found.steps) and float(first.distance) < 0.5 * float(problem.state.distance)
    assert float(found.distance) <= float(first.distance) + 1e-7
    assert int(found.evaluations) >= int(first.evaluations)
    assert Status(int(found.status)) in (Status.NO_IMPROVEMENT, Status.MAX_STEPS)


@pytest.mark.full
def test_searching_longer_pays(planner):
    """On one of a few beds at least each search finds what greedy does not."""
    gains = []
    for seed in range(3):
        problem, _ = made_problem(seed)
        ends = [float(search(name, problem).distance) for name in ("greedy", planner)]
        gains.append(1 - ends[1] / ends[0])
    assert max(gains) > 0.02 or planner == "greedy"


@pytest.mark.full
def test_the_same_key_gives_the_same_sequence(planner):
    problem, _ = made_problem(1)
    one, other = search(planner, problem), search(planner, problem)
    for field in fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.full
@pytest.mark.parametrize("allowed", [37, 700, 1500])
def test_no_more_is_evaluated_than_allowed(planner, allowed):
    problem, _ = made_problem(2)
    assert len(problem.candidates) > 37  # not even one sweep
    budget = Budget(evaluations=allowed)
    found = search(planner, problem, budget)
    check(problem, found)
    assert Status(int(found.status)) is Status.BUDGET
    assert int(found.evaluations) == budget.spent <= 1.1 * allowed
    assert float(found.distance) < float(problem.state.distance)


@pytest.mark.parametrize("pace", [40.0, 600.0])
def test_time_is_kept(planner, pace):
    problem, _ = made_problem(2)
    running = []

    def clock():  # as long as evaluations take
        return running[0].spent / pace if running else 0.0

    running.append(budget := Budget(seconds=2.0, clock=clock))
    found = search(planner, problem, budget)
    check(problem, found)
    assert Status(int(found.status)) is Status.BUDGET
    assert 1.5 <= budget.elapsed <= 2.2
    assert float(found.distance) < float(problem.state.distance)


def test_an_interrupted_search_uses_only_what_it_knows():
    """Values from before the last action are not taken for true: each action still gains."""
    problem, _ = made_problem(1)
    for allowed in range(100, 1200, 40):
        found = search("greedy", problem, Budget(evaluations=allowed))
        distances = measured(problem.state, found)[2][: int(found.steps) + 1]
        assert (np.diff(distances) < 0).all() and int(found.steps) > 0


def test_compiling_is_not_counted_nor_taken_for_speed():
    now = [0.0]
    budget = Budget(seconds=10.0, clock=lambda: now[0])

    def slow(x):
        now[0] += 60.0  # while it is traced only
        return x + 1

    jitted = compiled(slow)
    for _ in range(3):
        budget.call(jitted, jnp.float32(1))
        now[0] += 0.1
        budget.spend(1000)
    assert budget.elapsed == pytest.approx(0.3)
    # 2000 in 0.3 s, besides those of the first call in a time that is not known.
    assert budget.room() == int(2000 / 0.3 * 0.5) + 1
    assert budget.holds(60_000) and not budget.holds(70_000) and not budget.over
    now[0] += 10.0
    assert budget.over


def test_a_budget_may_be_larger_than_any_search():
    budget = Budget(evaluations=10**12)
    assert budget.room() == budget.left == UNLIMITED and not budget.over


@pytest.mark.parametrize("why", ["no steps", "no candidates", "nothing to do"])
def test_an_empty_plan(planner, why):
    problem, _ = made_problem(0)
    status = {Status.NO_IMPROVEMENT, Status.MAX_STEPS}
    if why == "no steps":
        problem = replace(problem, max_steps=0)
    elif why == "no candidates":
        none = {name: np.zeros((0, 2), np.int32) for name in BANK.actions}
        problem = replace(problem, candidates=candidates_at(problem.state, BANK, none, STRENGTHS))
    else:
        problem = replace(problem, state=replace(problem.state, goal=problem.state.now))
        status = {Status.CONVERGED}
    found = search(planner, problem)
    assert int(found.steps) == 0 and (np.asarray(found.move) == -1).all()
    assert Status(int(found.status)) in status
    assert float(found.distance) == pytest.approx(float(problem.state.distance), rel=1e-6)


@pytest.mark.full
def test_actions_are_used_as_often_as_allowed(planner):
    problem, own = made_problem(2)
    used = np.bincount(np.asarray(own.move[:5]), minlength=3)
    assert used.max() > 1
    problem = replace(problem, limits=replace(FREE, max_uses=jnp.array([1, 1, 2])), start=own)
    found = search(planner, problem)
    check(problem, found)
    assert 0 < int(found.steps) <= 4


@pytest.mark.full
def test_what_is_out_of_reach_is_left_alone(planner):
    """A hole in the reach around the one place where an action would do it all."""
    problem, _ = made_problem(0)
    state, candidates = problem.state, problem.candidates
    own = sequence(state, [(0, (20.0, 30.0), 1.2)])
    free = np.asarray(candidates.reachable).copy()
    free[18:23, 28:33] = False
    row, column = (candidates.first + state.shapes[candidates.move] // 2).T
    usable = candidates.valid & free[row, column]
    problem = replace(
        problem,
        state=replace(state, goal=measured(state, own)[1]),
        candidates=replace(candidates, valid=usable, reachable=jnp.asarray(free)),
        start=own,
    )
    found = search(planner, problem)
    check(problem, found)
    assert int(found.steps) > 0


def test_each_action_gains_what_it_must():
    problem, _ = made_problem(0)
    errors = jnp.array([0.001, 0.0005, 0.0])
    problem = replace(problem, limits=replace(FREE, min_gain=0.0005, errors=errors))
    found = search("greedy", problem)
    check(problem, found)
    gains = -np.diff(measured(problem.state, found)[2])
    for k in range(int(found.steps)):
        error = float(errors[found.move[k]]) * float(found.strength[k]) ** 0.5
        assert gains[k] > max(0.0005, error) - 1e-6
    assert 0 < int(found.steps) < int(search("greedy", replace(problem, limits=FREE)).steps)


def test_a_search_ends_when_it_is_near_enough(planner):
    problem, _ = made_problem(0)
    near = 0.5 * float(problem.state.distance)
    found = search(planner, replace(problem, limits=replace(FREE, tolerance=near)))
    assert Status(int(found.status)) is Status.CONVERGED
    assert float(found.distance) <= near
    assert int(found.steps) < int(search("greedy", problem).steps)


@pytest.mark.parametrize("name", ["careful", "refine"])
def test_a_known_sequence_is_begun_with(name):
    problem, own = made_problem(4)
    found = search(name, replace(problem, start=own))
    check(problem, found)
    assert float(found.distance) < 1e-6
    np.testing.assert_allclose(found.node[:5], own.node[:5], atol=1e-5)
    assert float(search("greedy", problem).distance) > 1e-3  # which is why it helps


def test_what_others_made_superfluous_is_taken_out():
    problem, own = made_problem(3, count=3)
    goal = measured(problem.state, own)[1]
    problem = replace(problem, state=replace(problem.state, goal=goal))
    steps = [(int(own.move[k]), own.node[k], float(own.strength[k])) for k in range(3)]
    # A weak one before it makes the first too deep.
    more = sequence(problem.state, [(steps[0][0], steps[0][1], 0.2), *steps])
    more = measured(problem.state, more)[0]
    left = pruned(problem, replace(more, status=jnp.int32(Status.MAX_STEPS)))
    assert Status(int(left.status)) is Status.MAX_STEPS  # nobody has looked for others
    assert int(left.steps) == 3 and float(left.distance) < 1e-5 < float(more.distance)
    np.testing.assert_array_equal(left.move, own.move)
    np.testing.assert_allclose(numbers_of(left), numbers_of(own), atol=1e-6)


@pytest.mark.parametrize(("weak", "kept"), [(0.01, False), (0.5, True)])
def test_what_adds_less_than_is_known_of_the_others_is_taken_out(weak, kept):
    problem, own = made_problem(3, count=3)
    steps = [(int(own.move[k]), own.node[k], float(own.strength[k])) for k in range(3)]
    more = sequence(problem.state, [*steps, (steps[0][0], steps[0][1], weak)])
    goal = measured(problem.state, more)[1].at[0, 0].add(0.1)  # which none of them reaches
    problem = replace(problem, state=replace(problem.state, goal=goal))
    more, _, distances = measured(problem.state, more)
    assert 1e-7 < distances[4] < distances[3] - 1e-6  # it does gain
    counted = replace(FREE, errors=1e-9)
    found = pruned(replace(problem, limits=counted), more)
    assert int(found.steps) == 3 + kept
    np.testing.assert_array_equal(found.move[:3], own.move[:3])
    near = replace(counted, tolerance=float(distances[4]))
    for limits in (FREE, near):  # errors that do not count; a goal that is reached
        assert int(pruned(replace(problem, limits=limits), more).steps) == 4


def test_what_is_taken_out_adds_up_to_little():
    problem, own = made_problem(3, count=3)
    weak = [(int(own.move[0]), own.node[0] + 2.0 * k, 0.03) for k in range(8)]
    more = sequence(problem.state, [(int(own.move[1]), own.node[1], 1.0), *weak])
    goal = measured(problem.state, more)[1].at[0, 0].add(0.1)  # which none of them reaches
    problem = replace(problem, state=replace(problem.state, goal=goal))
    more, _, distances = measured(problem.state, more)
    gains = -np.diff(np.asarray(distances))[:9]
    unsure = 1.1 * float(gains[1:].max() / np.sqrt((gains**2).sum()))  # each alone is below it
    found = pruned(replace(problem, limits=replace(FREE, errors=1e-9)), more, unsure)
    assert 1 < int(found.steps) < 9
    lost = float(found.distance) - float(more.distance)
    assert 0 < lost <= 3 * unsure * float(np.sqrt((gains**2).sum())) + 1e-6


def test_a_search_that_goes_on_knows_what_was_used():
    problem, own = made_problem(4)
    state, candidates = problem.state, problem.candidates
    one, now, _ = measured(state, sequence(state, [(0, own.node[0], 1.0)]))
    progress = resume(state, candidates, one, now)
    assert progress.used.tolist() == [1, 0, 0] and int(progress.result.status) == -1
    np.testing.assert_array_equal(progress.cache.stale, candidates.valid)


@pytest.mark.full
def test_what_is_missing_is_put_in():
    problem, own = made_problem(4)
    fewer = measured(problem.state, without(own, 4))[0]
    found = search("careful", replace(problem, start=fewer))
    check(problem, found)
    assert int(found.steps) == 5
    assert float(found.distance) < 0.8 * float(fewer.distance)


@pytest.mark.parametrize("name", ["careful", "refine"])
@pytest.mark.parametrize("spoil", ["reach", "strength", "steps"])
def test_of_a_known_sequence_what_is_not_allowed_is_left_out(name, spoil):
    problem, given = made_problem(4)
    if spoil == "reach":
        given = replace(given, node=given.node.at[0, 1].set(WALL - 5.0))
    elif spoil == "strength":
        given = replace(given, strength=given.strength.at[1].set(2.0))
    else:
        problem = replace(problem, max_steps=3)
    state = replace(problem.state, goal=measured(problem.state, given)[1])
    problem = replace(problem, state=state, start=given)
    check(problem, search(name, problem))


@pytest.mark.full
@pytest.mark.parametrize("strengths", [(1.0,), STRENGTHS])
def test_polishing_gains_what_it_says_and_costs_what_it_says(strengths):
    problem, _ = made_problem(3)
    state, reach = problem.state, np.asarray(problem.candidates.reachable)
    where = dense_within(reach)
    candidates = candidates_at(state, BANK, where, strengths, reach)
    changes = [np.asarray(change) for change in sweep(state, candidates)]
    best = [np.unravel_index(change.argmin(), change.shape) for change in changes]
    gains = np.array([-change[at] for change, at in zip(changes, best, strict=True)])
    firsts = np.stack([candidates.of_move(m)[at[0]] for m, at in enumerate(best)])
    assert gains.min() > 0
    order = np.argsort(-gains)
    cache, _ = refresh(state, state.now, candidates, empty_cache(candidates))

    def of(left):
        used = jnp.zeros(3, jnp.int32)
        local, spent = begin_local(state, candidates, cache, used, FREE, 2, left=left)
        while int(local.round) < 2:
            work = local_work(state, candidates, local, 2)
            changes = evaluate(state, state.now, work, jnp.zeros_like(cache.changes))
            local = next_local(state, candidates, local, changes, FREE, 2)
        return local, spent

    def known(left):
        local, spent = of(left)
        return jax.device_get((local.move, local.first, local.strength, local.gain, spent))

    moves, places, depths, gained, spent = known(UNLIMITED)
    each = 9 * len(strengths) * 2
    assert int(spent) == 3 * each and moves.tolist() == order.tolist()
    assert (gained >= gains[order]).all() and (gained > gains[order]).any()
    for move, place, depth, gain in zip(moves, places, depths, gained, strict=True):
        (kernel, effect), first = kernel_of(state, move), jnp.asarray(place)[None]
        windows = state.windows(kernel, state.now, first)
        change = state.change(effect, windows, first, jnp.asarray(depth))
        assert float(-change[0]) == pytest.approx(float(gain), rel=1e-5)
    # What the evaluations left do not suffice for stays as it was, the best comes first.
    some, none = known(2 * each), known(each - 1)
    assert (int(some[4]), int(none[4])) == (2 * each, 0)
    np.testing.assert_array_equal(some[3], [*gained[:2], gains[order[2]]])
    np.testing.assert_array_equal(none[1], firsts[order])


@pytest.mark.parametrize("seed", [10, 14, 16])  # where greedy begins with the right hand
def test_a_moved_and_weakened_action_is_recovered(seed):
    problem, own = made_problem(seed, count=1)
    problem = replace(problem, fine=0)  # every 5 pixels and no further
    coarse, found = search("greedy", problem), search("refine", replace(problem, max_steps=1))
    check(problem, found)
    assert float(found.distance) < 0.1 * float(coarse.distance)
    assert int(found.move[0]) == int(own.move[0])
    np.testing.assert_allclose(found.node[0], own.node[0], atol=0.1)
    np.testing.assert_allclose(found.strength[0], own.strength[0], atol=0.03)


@pytest.mark.full
def test_descent_keeps_the_best_on_the_way():
    problem, own = made_problem(4)
    start = measured(problem.state, own)[0]
    # From the goal itself every step leads away.
    again = refine.descend(problem.state, problem.candidates, start, jnp.float32(1.0))
    np.testing.assert_array_equal(again.node, start.node)
    assert float(again.distance) <= float(start.distance)


@pytest.mark.full
def test_64_bits_change_no_search(planner):
    def found():
        problem, _ = made_problem()
        return search(planner, replace(problem, max_steps=2))

    expected = found()
    with jax.enable_x64(True):
        wide = found()
    for field in fields(expected):
        one, other = (np.asarray(getattr(f, field.name)) for f in (wide, expected))
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def ring():
    """A problem whose goal is narrower than the tools: a dug ring around what stays as it is."""
    problem, _ = made_problem(0)
    v, u = np.ogrid[: CAMERA.height, : CAMERA.width]
    around = np.hypot(u - 30, v - 20)
    dug = 0.12 * gaussian_filter((np.abs(around - 9) < 3).astype(float), 1.0)
    goal = jnp.asarray(problem.state.now - dug, jnp.float32)
    return replace(problem, state=replace(problem.state, goal=goal), max_steps=16)


def test_careful_digs_less_too_deep():
    problem = ring()
    usual, found = (search(name, problem) for name in ("greedy", "careful"))
    assert Status(int(usual.status)) is Status.NO_IMPROVEMENT
    assert float(found.distance) < 0.9 * float(usual.distance)
    assert int(usual.steps) < int(found.steps) <= 16
    assert int(found.evaluations) > int(usual.evaluations)
    few = replace(problem, max_steps=int(usual.steps))
    assert float(search("careful", few).distance) <= float(usual.distance)
