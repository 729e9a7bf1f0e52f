"""The studio finds how near any plan can come to the goal that is drawn, without a browser."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import jshape
from jshape.app import goal_limit, pictures
from jshape.app.advice import how_good, how_near
from jshape.app.drawing import BrushStroke
from jshape.app.editor_state import EditorState
from jshape.app.goal_limit import GoalLimit
from jshape.errors import JShapeError
from jshape.planning.limit import CAUSES
from tests.test_limit import SMALL, hole
from tests.test_search_state import CAMERA


@pytest.fixture
def editor(rng):
    """An editor of beds of 24x18 pixels, with a hole to be dug."""
    editor = EditorState("flour-robot")
    editor.bank = SMALL
    now, goal = hole(rng)
    editor.see(now, "made up")
    editor.want(goal)
    return editor


@pytest.fixture
def limits(monkeypatch):
    monkeypatch.setattr(goal_limit, "STILL", 0.0)
    return GoalLimit()


def found_by(limits, editor):
    """The answer, once there is one."""
    until = time.monotonic() + 60
    while not (found := limits.ask(editor)) and time.monotonic() < until:
        time.sleep(0.005)
    assert found
    return found


class Held:
    """Stands for `limit_images`: goes on until it is let go or told to end."""

    def __init__(self, monkeypatch):
        self.begun, self.running, self.go = [], 0, threading.Event()
        monkeypatch.setattr(goal_limit, "limit_images", self)

    def __call__(self, bank, bed, goal, seen, *, check, **how):
        self.begun.append((bank, bed, goal, how))
        self.running += 1
        try:
            while not self.go.wait(0.001):
                check()
        finally:
            self.running -= 1
        return f"answer {len(self.begun)}"

    def settle(self, running):
        until = time.monotonic() + 20
        while self.running != running and time.monotonic() < until:
            time.sleep(0.001)
        assert self.running == running


@pytest.fixture
def held(monkeypatch):
    held = Held(monkeypatch)
    yield held
    held.go.set()


def test_the_limit_is_that_of_the_plans_that_are_made_here(editor, limits):
    editor.max_steps = 1
    found = found_by(limits, editor)
    how = {name: how for name, how in editor.keywords.items() if name != "planner"}
    same = jshape.limit(*editor.both(), bank=SMALL, **how)
    assert found.bounds == same.bounds and found.proves
    said = how_near(found)
    assert said.startswith(f"No plan of 1 action leaves less than {100 * same.left:.1f}% (")
    assert said.endswith(f"leave {100 * same.fractions:.0f}%")
    editor.max_steps = 40
    more = found_by(limits, editor)
    assert more.max_steps == 40 and more.left < found.left
    none = replace(more, bounds=(replace(more.bounds[0], left=0.0),))
    assert how_near(none).startswith("Nothing is proven: no bound keeps a plan of 40 actions")
    plan = editor.make_plan(max_steps=1)
    share = float(plan.distances[-1] / plan.distances[0])
    best = 100 * (1 - share) / (1 - found.left)
    assert how_good(plan, found) == (
        f"{100 * share:.0f}% left, at least {best:.0f}% of what any plan can cover"
    )
    two = editor.make_plan(max_steps=2)
    assert len(two) == 2
    broken = replace(found, bounds=(replace(found.bounds[0], left=share + 0.01),))
    for one, of in ((plan, ""), (plan, broken), (two, found)):  # nothing holds for these
        share = float(one.distances[-1] / one.distances[0])
        assert how_good(one, of) == f"{100 * share:.0f}% left"
    assert limits.ask(editor) is more  # a plan, or one step of it looked at, changes nothing


def test_a_limit_is_of_a_goal_that_stands_still_and_of_the_newest(editor, held, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(goal_limit.time, "monotonic", lambda: now[0])
    limits = GoalLimit()
    for _ in range(3):  # strokes that follow each other
        editor.want(editor.goal + np.float32(0.001))
        assert limits.ask(editor) == ""
        now[0] += 0.6
        assert limits.ask(editor) == "" and not held.begun
    now[0] += 0.2
    limits.ask(editor)
    held.settle(1)
    limits.ask(editor)
    assert len(held.begun) == 1
    first = editor.goal
    editor.want(first + np.float32(0.001))
    limits.ask(editor)
    held.settle(0)  # nobody waits for the first any more
    now[0] += 0.8
    limits.ask(editor)
    held.settle(1)
    assert len(held.begun) == 2 and held.begun[0][2] is first
    assert held.begun[1][:3] == (SMALL, editor.bed, editor.goal)
    held.go.set()
    held.settle(0)
    monkeypatch.undo()
    assert found_by(limits, editor) == "answer 2"


@pytest.mark.parametrize("field, busy", [("search", object()), ("locked", "a run goes on")])
def test_none_is_looked_for_beside_a_plan_or_a_run(editor, limits, held, field, busy):
    free = getattr(editor, field)
    limits.ask(editor)
    held.settle(1)
    setattr(editor, field, busy)
    held.settle(0)
    assert limits.ask(editor) == "" and len(held.begun) == 1
    setattr(editor, field, free)
    until = time.monotonic() + 20
    while len(held.begun) == 1 and time.monotonic() < until:
        assert limits.ask(editor) == ""
        time.sleep(0.001)
    held.go.set()
    assert found_by(limits, editor) == "answer 2"


@pytest.mark.parametrize(
    "problem, said",
    [
        (JShapeError("the bank has\nno room"), "is not known: the bank has no room"),
        (ZeroDivisionError("by 0"), "is not known: ZeroDivisionError: by 0"),
    ],
)
def test_what_goes_wrong_is_said_in_a_line_and_not_tried_again(
    editor, limits, monkeypatch, problem, said
):
    tried = []

    def broken(*given, **more):
        tried.append(given)
        raise problem

    monkeypatch.setattr(goal_limit, "limit_images", broken)
    assert how_near(found_by(limits, editor)).endswith(said)
    limits.ask(editor)
    limits._thread.join()
    assert len(tried) == 1


def test_of_no_bed_and_of_a_goal_that_asks_for_nothing_nothing_is_said(editor, limits, held):
    assert limits.ask(EditorState("flour-robot")) == how_near("") == ""
    assert not limits._thread.is_alive()
    editor.clear()
    limits.ask(editor)
    limits._thread.join()
    assert limits.ask(editor) == "" and not held.begun


def test_who_asks_for_a_goal_that_is_being_drawn_gets_a_whole_one(monkeypatch):
    """Not the bed, which would be a goal that asks for nothing."""
    from jshape.app import goal_state

    editor, make, asked = EditorState("flour-robot"), goal_state.make_goal, []

    def made(*given):
        if not asked:
            asked.append(None)
            asked.append(editor.goal)
        return make(*given)

    monkeypatch.setattr(goal_state, "make_goal", made)
    editor.see(np.full(editor.camera.shape, 0.5, np.float32), "made up")
    editor.draw(BrushStroke(((150.0, 200.0), (240.0, 150.0)), 30.0, 8.0))
    np.testing.assert_array_equal(asked[1], editor.goal)
    assert editor.changed


def test_marks_differ_in_their_direction_and_leave_the_rest(rng):
    rgb = rng.integers(0, 256, (*CAMERA.shape, 3), dtype=np.uint8)
    causes = np.zeros(CAMERA.shape, np.int8)
    assert np.array_equal(pictures.marked(rgb, causes), rgb)
    causes[2, 3] = 4  # a speck
    seen = pictures.marked(rgb, causes) != rgb
    assert seen[2, 3].any() and seen.any(-1).sum() == 1
    whole = []
    for k in range(1, len(CAUSES) + 1):
        grey = pictures.marked(np.full((40, 40, 3), 128, np.uint8), np.full((40, 40), k))
        inside = (grey[1:-1, 1:-1] != 128).any(-1)  # the edge is all marked
        assert 0.4 < inside.mean() < 0.6
        assert not any(np.array_equal(inside, one) for one in whole)
        whole.append(inside)
    assert len({pictures.stripes(cause).split("deg")[0] for cause in CAUSES}) == len(CAUSES)
