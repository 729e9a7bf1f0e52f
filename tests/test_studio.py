"""The studio's state, its runs and its annotation, without a browser."""

import asyncio
import base64
import itertools
import json
import threading
import time
from dataclasses import replace
from unittest import mock

import jax
import numpy as np
import pytest

import jshape
from jshape.app import pictures
from jshape.app.advice import first_stroke, next_step, why_empty
from jshape.app.annotation import Annotation
from jshape.app.drawing import BrushStroke, Words
from jshape.app.editor_state import EditorState
from jshape.app.plan_job import PlanJob
from jshape.app.run_controller import (
    RunController,
    State,
    over_simulated,
    seen,
    simulated_robot,
)
from jshape.data.simulate import simulate_pairs, together
from jshape.data.view import image_of_depth
from jshape.errors import BadBank, BadCamera, BadDataset, BadFile, JShapeError
from jshape.height_map import as_frame
from jshape.io import annotations, datasets
from jshape.io.cameras import write_camera
from jshape.io.images import write_depth_png
from jshape.planning.options import options
from jshape.reproject import reproject
from jshape.robot.arms.base import ArmError
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.played import Played
from jshape.robot.cameras.simulated import levelled_world
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot

BRUSH = BrushStroke(((150.0, 200.0), (240.0, 150.0), (330.0, 200.0)), 30.0, 8.0)


@pytest.fixture(scope="module")
def bed():
    return image_of_depth(levelled_world(3).look(), jshape.PAPER_BOX).image


@pytest.fixture
def editor(bed):
    editor = EditorState("flour-robot")  # f_D: quick
    editor.see(bed, "simulated")
    return editor


@pytest.fixture
def planned(editor):
    editor.draw(BRUSH)
    editor.make_plan(max_steps=3, stride=32)
    assert len(editor.plan) == 3
    return editor


def change_mm(editor):
    return 1e3 * (editor.depth_of(editor.goal) - editor.depth_of(editor.bed))


@pytest.mark.full
def test_a_stroke_sinks_what_is_under_the_brush_with_walls_that_stand(editor):
    editor.draw(BRUSH)
    change = change_mm(editor)
    assert 7.5 < change[150, 240] < 8.5 and abs(change[350, 240]) < 0.01
    pixel = 1e3 * np.median(editor.depth_of(editor.bed)) / float(editor.camera.fx)
    steep = np.abs(np.diff(change, axis=0)).max() / pixel
    bed = np.abs(np.diff(1e3 * editor.depth_of(editor.bed), axis=0)).max() / pixel
    assert 0.5 < steep < np.tan(np.radians(40)) + bed  # flour lies at 40 degrees
    assert any("steep" in line for line in editor.warnings), editor.warnings


def test_marks_do_not_add_up_and_can_be_taken_back(editor):
    editor.draw(BRUSH)
    once = change_mm(editor)
    editor.draw(BRUSH)
    np.testing.assert_allclose(change_mm(editor), once, atol=1e-3)
    editor.draw(BRUSH._replace(depth_mm=-5.0, line=((240.0, 320.0),)))
    assert change_mm(editor)[320, 240] < -4
    editor.undo()
    np.testing.assert_allclose(change_mm(editor), once, atol=1e-3)
    editor.clear()
    assert editor.distance_mm == 0 and editor.to_move_cm3 == (0, 0)


def test_words_are_written_in_the_goal(editor):
    editor.draw(Words("L", (240.0, 197.0), 100.0, 6.0))
    change = change_mm(editor)
    assert change.max() > 5.5 and abs(change[60, 240]) < 0.01
    out, into = editor.to_move_cm3
    assert out > 5 and into < 0.1


@pytest.mark.parametrize(
    "mark, words",
    [
        (BRUSH._replace(depth_mm=0.0), "neither of them 0"),
        (BRUSH._replace(width_mm=1000.0), "up to 100 mm"),
        (BRUSH._replace(line=()), "0 points"),
        (BRUSH._replace(line=((np.nan, 3.0),)), "at least one"),
        (Words(" ", (240.0, 197.0), 100.0, 6.0), "empty"),
        (Words("WIDE", (20.0, 197.0), 400.0, 6.0), "leaves the view"),
    ],
)
def test_marks_that_make_no_sense_leave_the_goal_as_it_is(editor, mark, words):
    editor.draw(BRUSH)
    before = editor.distance_mm
    with pytest.raises(JShapeError, match=words):
        editor.draw(mark)
    assert abs(editor.distance_mm - before) < 1e-5 and len(editor.marks) == 1


@pytest.mark.full
def test_a_plan_is_edited_and_its_distances_follow(planned):
    first = planned.plan
    planned.drop(1)
    assert planned.plan.actions == (first.actions[0], first.actions[2])
    np.testing.assert_array_equal(planned.plan.images[1], first.images[1])
    planned.move(1, -1)
    assert planned.plan.actions == (first.actions[2], first.actions[0]) and planned.selected == 1
    planned.change(0, position=(101.0, 120.0))
    assert planned.plan.exact_positions[0].tolist() == [101, 120]
    shallow = planned.plan.distances[1]
    planned.change(0, strength=2.0)
    assert planned.plan.strengths[0] == 2 and planned.plan.distances[1] != shallow
    again = jshape.rollout(
        planned.bed, planned.goal, planned.plan.actions, planned.plan.exact_positions,
        strengths=planned.plan.strengths, yaws=planned.plan.yaws, bank=planned.bank,
    )  # fmt: skip
    np.testing.assert_array_equal(again.distances, planned.plan.distances)


@pytest.mark.full
def test_edits_that_make_no_sense_leave_the_plan(planned):
    before = planned.plan
    for wrong, words in (
        (lambda: planned.drop(3), "action 4 of a plan of 3"),
        (lambda: planned.change(0, strength=-1.0), "above 0"),
    ):
        with pytest.raises(JShapeError, match=words):
            wrong()
    assert planned.plan is before
    planned.move(0, -1)  # already the first
    assert planned.plan.actions == before.actions
    planned.select(99)
    assert planned.selected == 3


@pytest.mark.full
def test_another_goal_or_bed_drops_the_plan(planned, bed):
    planned.draw(BRUSH)
    assert planned.plan is None
    goal = planned.goal
    planned.see(bed + np.float32(0.001), "another", same_goal=True)
    np.testing.assert_array_equal(planned.goal, goal)
    with pytest.raises(BadBank):
        planned.use_bank("nobody's")


def test_nothing_to_take_back_keeps_the_plan(editor):
    for change in (editor.undo, editor.clear):
        with pytest.raises(JShapeError, match="nothing is drawn"):
            change()
    editor.draw(BRUSH)
    editor.make_plan(max_steps=1, stride=32)
    editor.undo()
    assert editor.plan is None and not editor.changed
    with pytest.raises(JShapeError, match="nothing is drawn"):
        editor.undo()


@pytest.mark.full
def test_the_first_stroke_ends_in_a_plan(editor):
    assert "Draw" in next_step(editor)
    width, deep = first_stroke(editor.bank, editor.pixels_per_mm)
    assert (width, deep) == (40.0, 15.0)  # a poke's ROI is 40 px = 41.6 mm wide
    editor.draw(BrushStroke(((170.0, 200.0), (310.0, 200.0)), width, deep))
    assert "Press plan" in next_step(editor)
    editor.make_plan(max_steps=8)
    assert len(editor.plan) >= 2
    assert editor.plan.distances_mm[-1] < 0.8 * editor.plan.distances_mm[0]
    assert why_empty(editor) == "" and "Step through" in next_step(editor)


@pytest.mark.full
def test_an_empty_plan_says_what_the_smallest_action_does_and_what_helps(editor):
    editor.draw(BrushStroke(((200.0, 200.0), (220.0, 200.0)), 8.0, 2.0))
    editor.make_plan(max_steps=2)
    assert len(editor.plan) == 0 and "empty" in next_step(editor)
    said = why_empty(editor)
    asked = np.abs(change_mm(editor)).max()
    assert f"{editor.distance_mm:.3f} mm on average, {asked:.1f} mm at most" in said
    one = jshape.rollout(editor.bed, editor.bed, ["poke"], [(210, 200)], strengths=[0.2],
                         bank=editor.bank)  # fmt: skip
    assert f"poke x0.2, moves {one.distances_mm[1]:.3f} mm on average" in said
    assert "mm farther" in said and "40 mm wide, 15 mm deep" in said


def test_a_search_that_is_cancelled_leaves_the_editor_and_its_waiter_free(editor, monkeypatch):
    hold = threading.Event()
    monkeypatch.setattr("jshape.app.editor_state.plan", lambda *a, **k: hold.wait(60))
    editor.draw(BRUSH)
    ended = []

    def wait_for_plan():
        try:
            editor.make_plan()
        except JShapeError as problem:
            ended.append(str(problem))

    waiter = threading.Thread(target=wait_for_plan)
    waiter.start()
    while editor.search is None:
        time.sleep(0.001)
    editor.search.cancel()
    waiter.join(5.0)
    assert ended == ["no plan: you cancelled it"] and editor.plan is None and editor.search is None
    hold.set()


def test_what_moves_is_asked_of_banks_that_move(editor):
    """Lengths, carries and stock go with the other options, for plans and runs alike."""
    editor.planner, editor.max_steps = "careful", 7
    editor.lengths, editor.stock_cm3 = (0.5, 1.0), 300.0
    assert not editor.has_paths and not editor.can_carry
    assert editor.keywords["constraints"].stock_cm3 is None  # f_D of presses would refuse one
    assert editor.keywords["planner"] == "careful" and editor.keywords["stop"].max_steps == 7
    editor.use_bank("moving-flour-robot")
    assert editor.has_paths and editor.can_carry
    space, stock = editor.keywords["space"], editor.keywords["constraints"].stock_cm3
    assert space.lengths == (0.5, 1.0) and space.carries is None and stock == 300
    editor.carries = False
    space, stock = editor.keywords["space"], editor.keywords["constraints"].stock_cm3
    assert space.carries == {} and stock is None


@pytest.mark.full
def test_a_run_pours_from_the_stock_that_was_set(bed, tmp_path):
    editor = EditorState("moving-flour-robot", stock_cm3=300.0, max_steps=1, lengths=(1.0,), yaws=1)
    editor.see(bed, "simulated")
    editor.draw(BrushStroke(((200.0, 200.0), (280.0, 200.0)), 80.0, -12.0))
    made = editor.make_plan(stride=40)
    assert made.actions == ("pour",) and made.volumes_cm3[0] > 20
    depth = editor.depth_of(editor.bed)
    robot = simulated_robot(depth, editor.bank, "flour", stock_cm3=editor.stock)
    search = options(editor.keywords, stride=40)
    run = RunController(robot, editor.bank, editor.goal, tmp_path / "run", meta={}, search=search)
    wait_for(run, State.ASKING)
    assert run.question.startswith("pour")
    run.answer(True)
    run.wait(200.0)
    assert run.state is State.FINISHED, run.why
    (step,) = json.loads((tmp_path / "run" / "summary.json").read_text())["steps"]
    assert step["obtained_mm"] < 0.9 * step["before_mm"]


def test_a_search_says_that_it_compiles(monkeypatch):
    hold = threading.Event()
    search = PlanJob(lambda: hold.wait(60))
    for waited, said in ((None, "planning: 0 s"), (7.2, "compiling, first time only: 7 s")):
        monkeypatch.setattr("jshape.compiling.seconds", lambda waited=waited: waited)
        assert search.said == said
    search.cancel()
    hold.set()


def test_an_editors_state_is_saved_as_plan_and_mold_read_it(planned, tmp_path):
    planned.save(tmp_path / "saved")
    again = EditorState("flour-robot")
    again.load_bed(tmp_path / "saved" / "now.png")
    again.load_goal(tmp_path / "saved" / "goal.png")
    assert abs(again.distance_mm - planned.distance_mm) < 0.02
    assert jshape.Plan.from_json(tmp_path / "saved" / "plan.json").actions == planned.plan.actions
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(BadFile):
        planned.save(tmp_path / "mine", overwrite=True)
    with pytest.raises(JShapeError, match="no bed"):
        EditorState("flour-robot").save(tmp_path / "none")


def wait_for(controller, state):
    until = time.monotonic() + 120
    while controller.state is not state and controller.running and time.monotonic() < until:
        time.sleep(0.01)
    assert controller.state is state, (controller.state, controller.why)


def begin(editor, folder, **more):
    robot = simulated_robot(editor.depth_of(editor.bed), editor.bank, "flour")
    looks = []
    controller = RunController(
        robot, editor.bank, editor.goal, folder, meta={"bank": editor.bank_name, "arm": "sim"},
        on_look=looks.append, search=editor.keywords, **more,
    )  # fmt: skip
    return controller, looks


def test_the_simulated_bed_is_the_one_that_is_edited(editor):
    robot = simulated_robot(editor.depth_of(editor.bed), editor.bank, "flour")
    off = np.abs(editor.depth_of(seen(robot)) - editor.depth_of(editor.bed))
    assert np.median(off) < 0.0004


@pytest.mark.full
def test_a_run_asks_before_each_action(planned, tmp_path):
    controller, looks = begin(planned, tmp_path / "run", plan=planned.plan)
    asked = []
    for k in range(3):
        wait_for(controller, State.ASKING)
        assert controller.ahead.actions == planned.plan.actions[k:]
        assert len(looks) == k + 1
        # What the action starts from is what was seen last, not what was planned from.
        seen_mm = jshape.to_mm(jshape.distance(looks[-1], planned.goal), planned.camera)
        np.testing.assert_allclose(controller.ahead.distances_mm[0], seen_mm, rtol=1e-5)
        asked.append(controller.ahead.distances_mm[:2])
        controller.answer(True)
        while controller.state is State.ASKING:
            time.sleep(0.001)
    controller.wait(60.0)
    assert controller.state is State.FINISHED and len(looks) == 4
    assert len(controller.lines) == 4  # a head and a line for each
    steps = json.loads((tmp_path / "run" / "summary.json").read_text())["steps"]
    said = [(step["before_mm"], step["predicted_mm"]) for step in steps]
    np.testing.assert_allclose(said, asked, rtol=1e-5)


@pytest.mark.full
def test_a_run_ends_when_it_is_told_to(planned, tmp_path):
    planned.draw(BRUSH._replace(depth_mm=25.0, width_mm=90.0))  # worth an action
    controller, _ = begin(planned, tmp_path / "run")
    wait_for(controller, State.ASKING)
    controller.answer(True, controller.number - 1)  # to an earlier question: none to this one
    assert controller.state is State.ASKING
    controller.answer(False, controller.number)
    controller.wait(60.0)
    assert controller.state is State.FINISHED and "declined" in controller.why
    controller.answer(True)  # too late: nothing happens
    assert not controller.running


class Slow(SimulatedArm):
    """An arm that takes its time, and remembers what it was told."""

    def __init__(self, arm):
        self.__dict__.update(arm.__dict__)
        self.told = []
        self.moving = threading.Event()

    def _spend(self, name):
        self.told.append(name)
        self.moving.set()
        time.sleep(0.2)

    def move(self, pose, *, speed, threshold):
        self._spend("move")
        return super().move(pose, speed=speed, threshold=threshold)

    def home(self):
        self._spend("home")
        return super().home()


def test_stop_ends_the_action_and_nothing_more_is_commanded(planned, tmp_path):
    robot = simulated_robot(planned.depth_of(planned.bed), planned.bank, "flour")
    arm = Slow(robot.arm)
    robot = Robot(robot.depth_camera, arm, load_hand(), planned.bank.camera)
    bed = arm.world.bed
    controller = RunController(
        robot, planned.bank, planned.goal, tmp_path / "run", meta={"bank": planned.bank_name},
        plan=planned.plan,
    )  # fmt: skip
    wait_for(controller, State.ASKING)
    arm.moving.clear()
    controller.answer(True)
    assert arm.moving.wait(60)
    told = len(arm.told)
    began = time.monotonic()
    controller.stop()
    assert time.monotonic() - began < 0.05  # the motion takes 0.2 s
    controller.wait(60.0)
    assert not controller.running and len(arm.told) == told and arm.world.bed is bed
    assert controller.state is State.FAILED and "stopped by a person" in controller.why
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["state"] == "aborted"
    with pytest.raises(ArmError, match="stopped by a person"):
        robot.home()
    controller.stop()  # the run has ended: the arm is told all the same
    again = RunController(
        robot, planned.bank, planned.goal, tmp_path / "again", meta={"bank": planned.bank_name},
        plan=planned.plan,
    )  # fmt: skip
    wait_for(again, State.ASKING)  # the next run moves it again
    again.stop()
    again.wait(60.0)


def test_stop_answers_a_question_and_says_what_went_wrong_with_it(planned, tmp_path):
    robot = simulated_robot(planned.depth_of(planned.bed), planned.bank, "flour")

    def broken():
        raise OSError("no answer")

    controller = RunController(
        robot, planned.bank, planned.goal, tmp_path / "run", meta={"bank": planned.bank_name},
        plan=planned.plan, ask_first=True,
    )  # fmt: skip
    wait_for(controller, State.ASKING)
    assert "goes home" in controller.question and controller.ahead is None
    assert not (tmp_path / "run" / "log.jsonl").is_file()  # nothing has begun
    robot.arm.stop = broken
    controller.stop()
    controller.wait(60.0)
    assert controller.state is State.FAILED
    assert controller.why.startswith(
        "simulated arm: stopped by a person; simulated arm: did not stop"
    )
    assert "OSError: no answer" in controller.trouble


def test_an_editors_state_is_locked_while_a_run_goes_on(planned):
    planned.locked = "a run goes on"
    version, plan = planned.version, planned.plan
    for change in (
        planned.undo, planned.clear, planned.make_plan, lambda: planned.drop(0),
        lambda: planned.draw(BRUSH), lambda: planned.use_bank("flour-robot"),
    ):  # fmt: skip
        with pytest.raises(JShapeError, match="a run goes on"):
            change()
    assert planned.plan is plan and planned.version == version
    planned.follow(plan.rest(1))
    assert planned.selected == 1 and planned.version > version


def test_a_goal_that_is_the_bed_is_not_planned_for(editor):
    with pytest.raises(JShapeError, match="draw, write or load one first"):
        editor.make_plan()


def test_a_run_that_breaks_says_why(planned, tmp_path):
    robot = simulated_robot(planned.depth_of(planned.bed), planned.bank, "flour")

    def broken(*given, **more):
        raise RuntimeError("the driver is gone")

    robot.arm.home = broken
    controller = RunController(
        robot, planned.bank, planned.goal, tmp_path / "run", meta={"bank": "flour-robot"}
    )
    controller.wait(60.0)
    assert (
        controller.state is State.FAILED
        and "home: RuntimeError: the driver is gone" in controller.why
    )


@pytest.fixture
def dataset(tmp_path):
    made = simulate_pairs(jax.random.key(0), 3, actions=("poke",))
    datasets.save_pairs(together(made), tmp_path / "pairs")
    return tmp_path / "pairs"


def test_boxes_are_corrected_and_written(dataset):
    work = Annotation(dataset)
    table = (dataset / datasets.TABLE).read_text()
    before = [work.box(k) for k in range(3)]
    assert work.correct(1, (120.4, 90.2), (60.0, 40.0)) == (60, 40, 60, 50)
    work.put_back(1)
    assert work.box(1) == before[1] and not work.changed
    work.correct(1, (60.0, 40.0), (120.0, 90.0))
    found = work.take_found(2)
    assert (dataset / datasets.TABLE).read_text() == table  # nothing is written yet
    assert work.save() == 2 and not work.changed
    again = Annotation(dataset)
    assert [again.box(k) for k in range(3)] == [before[0], (60, 40, 60, 50), found]
    assert again.by_hand.tolist()[1] is True
    assert annotations.boxes_by_hand(dataset)[1]


def test_boxes_that_make_no_sense_are_refused(dataset):
    work = Annotation(dataset)
    with pytest.raises(BadDataset, match="box of 3x50"):
        work.correct(0, (60.0, 40.0), (63.0, 90.0))
    assert work.correct(0, (-50.0, -50.0), (1e4, 1e4)) == (0, 0, 480, 395)
    with pytest.raises(BadDataset, match="has no pair 'nobody'"):
        annotations.write_boxes(dataset, {"nobody": (0, 0, 9, 9)})
    with pytest.raises(BadDataset):
        Annotation(dataset / "nowhere")


def test_pictures_show_what_is_high_and_what_is_wrong(editor):
    editor.draw(BRUSH)
    height = -1e3 * editor.depth_of(editor.goal)
    scale = pictures.height_scale(height, height + 3)
    assert scale.low <= np.median(height) - 7 and scale.high >= height.max() - 1
    rgb = pictures.shaded(height, scale)
    assert rgb.shape == (*height.shape, 3) and rgb.dtype == np.uint8
    assert pictures.data_url(rgb).startswith("data:image/png;base64,")
    change = np.zeros((40, 40), np.float32)
    change[:, :20], change[:, 20:] = 8.0, -8.0
    scale = pictures.difference_scale(change)
    assert (scale.low, scale.high) == (-8.0, 8.0)
    painted = pictures.differing(change, scale)
    red, blue = painted[5, 5], painted[5, 35]
    assert red[0] > red[2] and blue[2] > blue[0]
    first, last = scale.gradient.split("#")[1], scale.gradient.split("#")[-1]
    assert bytes.fromhex(first[:6]) == blue.tobytes() and bytes.fromhex(last[:6]) == red.tobytes()


def test_a_flat_bed_is_not_all_noise():
    scale = pictures.height_scale(np.full((4, 4), -440.0))
    assert (scale.low, scale.high) == (-443.0, -437.0)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("fails", [False, True])
def test_work_of_a_page_that_was_closed_draws_nothing_and_says_nothing(monkeypatch, closed, fails):
    from jshape.app import widgets as page

    said = []
    client = mock.MagicMock(is_deleted=False)
    fake = mock.MagicMock(notify=lambda text, **how: said.append(text))
    fake.context.client = client
    monkeypatch.setattr(page, "ui", fake)

    def work():
        client.is_deleted = closed
        if fails:
            raise OSError("no answer \x1b[2J")

    guard = page.OneAtATime()
    asked = guard("working", work, lambda: said.append("drawn"))
    if closed:  # whoever waits for it draws nothing either
        with pytest.raises(asyncio.CancelledError):
            asyncio.run(asked)
        assert said == []
    else:
        asyncio.run(asked)
        assert said == ["OSError: no answer \\x1b[2J"] * fails + ["drawn"]


def test_a_goal_of_the_beds_camera_is_seen_from_where_the_bed_is(tmp_path):
    """Its whole middle is dug 10 mm: that is not taken for raised surroundings."""
    other = replace(jshape.PAPER_BOX, fx=350.0, fy=350.0, z_max=1.0)
    write_camera(tmp_path / "camera.json", other, 1e-4)
    now = np.full(jshape.PAPER_BOX.shape, 0.55, np.float32)
    wanted = now.copy()
    wanted[79:316, 96:384] += 0.010
    editor = EditorState("flour-robot")
    for name, depth, load in (("now", now, editor.load_bed), ("wanted", wanted, editor.load_goal)):
        write_depth_png(tmp_path / f"{name}.png", depth, 1e-4)
        load(tmp_path / f"{name}.png")
    change = editor.goal - editor.bed  # I falls where the bed is lower
    assert change.min() < -0.1 and change.max() < 0.01


TILTED = jshape.Camera(640, 480, 500.0, 500.0, 319.5, 239.5, 0.3, 1.0)


def tilted(depth):
    """What `TILTED`, at 30 degrees, 0.5 m from the bed's middle, sees of what the bank's saw."""
    a, pose = np.radians(30.0), np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]]
    pose[:3, 3] = [0.0, 0.0, 0.45] - 0.5 * pose[:3, 2]
    posed, span = replace(TILTED, pose=as_frame(pose)), np.array([0.3, 0.8], np.float32)
    return np.nan_to_num(np.asarray(reproject(depth, jshape.PAPER_BOX, posed, span)))


@pytest.mark.full
@pytest.mark.parametrize("name", ["pressed-flour-robot", "flour-robot"])
def test_a_bed_of_a_tilted_camera_is_drawn_on_planned_saved_and_run(bed, tmp_path, name):
    depth = np.asarray(jshape.PAPER_BOX.depth(jshape.metric.unweigh(bed, jshape.PAPER_BOX)))
    write_camera(tmp_path / "camera.json", TILTED, 1e-4)
    write_depth_png(tmp_path / "now.png", tilted(depth), 1e-4)
    editor = EditorState(name)
    own = editor.camera
    editor.load_bed(tmp_path / "now.png")
    camera = editor.camera
    assert camera.orthographic is (name == "pressed-flour-robot")
    assert editor.bed.shape == camera.shape and editor.bank.rois
    level = float(np.median(editor.depth_of(editor.bed)))
    assert editor.pixels_per_mm == pytest.approx(float(camera.scale(level)[0]) / 1e3, rel=1e-3)
    # A brush of 30 mm is as wide as that on the bed, and what it moves is told in cm3.
    u, v = (camera.width - 1) / 2, (camera.height - 1) / 2
    editor.draw(BrushStroke(((u - 60, v), (u + 60, v)), 30.0, 8.0))
    change = change_mm(editor)
    wide = (change[:, int(u)] > 4).sum() / editor.pixels_per_mm
    assert 20 < wide < 32 and 7 < change.max() < 8.5
    area = change.clip(0).sum() / editor.pixels_per_mm**2
    assert editor.to_move_cm3[0] == pytest.approx(area / 1e3, rel=0.05)
    editor.make_plan(max_steps=1, stride=32)
    assert len(editor.plan) == 1

    editor.save(tmp_path / "saved")
    again = EditorState(name)
    again.load_bed(tmp_path / "saved" / "now.png")
    again.load_goal(tmp_path / "saved" / "goal.png")
    assert again.camera.shape == camera.shape
    assert again.distance_mm == pytest.approx(editor.distance_mm, abs=0.05)

    bank, plan = over_simulated(editor.bank, editor.plan)
    robot = simulated_robot(editor.depth_of(editor.bed), bank, "flour")
    off = np.abs(editor.depth_of(seen(robot)) - editor.depth_of(editor.bed))
    assert np.median(off) < 0.0006
    run = RunController(robot, bank, editor.goal, tmp_path / "run", meta={}, plan=plan)
    wait_for(run, State.ASKING)
    run.answer(True)
    run.wait(200.0)  # it draws its pictures at the end
    assert run.state is State.FINISHED, run.why

    editor.use_bank(name)  # for what is seen now
    assert editor.camera == camera
    straight = tmp_path / "straight"
    straight.mkdir()
    write_camera(straight / "camera.json", jshape.PAPER_BOX, 1e-4)
    write_depth_png(straight / "now.png", depth, 1e-4)
    editor.load_bed(straight / "now.png")
    assert editor.camera == own


def test_the_3d_scene_gets_places_of_parallel_rays():
    from jshape.app.bed_scene import BedScene

    scene = mock.MagicMock(_props={})
    flat = replace(TILTED, orthographic=True, fx=1000.0, fy=1000.0)
    for camera in (TILTED, flat):
        BedScene.use(scene, camera)
        x = np.frombuffer(base64.b64decode(scene._props["x"]), np.float32)
        assert scene._props["parallel"] is camera.orthographic
        away = 1.0 if camera.orthographic else 0.7
        np.testing.assert_allclose(x * away, camera.at(np.arange(640), 0, 0.7)[0], rtol=1e-5)


def test_a_robots_camera_looks_as_the_bed_was_seen(bed):
    """A tilted one is not refused: its first look says from where the others are seen."""
    depth = np.asarray(jshape.PAPER_BOX.depth(jshape.metric.unweigh(bed, jshape.PAPER_BOX)))
    frame = np.rint(tilted(depth) / 1e-4).astype(np.uint16)
    editor = EditorState("pressed-flour-robot")
    eye = Played("tilted", TILTED, 1e-4, itertools.repeat(frame), live=False)
    with Robot(eye, mock.MagicMock(), load_hand(None), editor.camera, frames=1) as robot:
        editor.look(robot)
        view = robot.view
        assert editor.camera.orthographic and robot.camera == editor.camera
        editor.look(robot)
        assert robot.view is view and editor.came_from == "tilted"
        editor.show_to(robot)
        other = EditorState("flour-robot")
        other.see(bed, "simulated")
        with pytest.raises(BadCamera, match="the bed is not of tilted: look with the camera"):
            other.show_to(robot)
