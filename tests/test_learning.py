"""A run that learns: between looks, when it is gone on with, and for whoever takes its bank."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import jshape
from jshape import JShapeError
from jshape.actions import PlacedAction
from jshape.cli.main import main
from jshape.data.view import image_of_depth
from jshape.errors import BadFile
from jshape.io import datasets, journal, runs
from jshape.learn.lessons import hand_of, lessons_of
from jshape.planning.api import rollout
from jshape.planning.options import Constraints
from jshape.robot.learning import Learning, bank_of, learned_from
from jshape.robot.loop import Stop
from jshape.robot.loop import mold as loop_of
from jshape.robot.probe import probe
from jshape.robot.run_pairs import pairs_of, turned_back
from jshape.robot.session import Session
from tests.conftest import mm, paper
from tests.stage import PLACES, robot_of
from tests.test_loop import Obedient
from tests.test_online import bank, other  # noqa: F401 - fixtures


@pytest.fixture(scope="module")
def bed(bank):  # noqa: F811
    rng = np.random.default_rng(0)
    waves = ndimage.gaussian_filter(rng.normal(size=bank.camera.shape), 12)
    depth = (0.445 + 1.5e-3 * waves / waves.std()).astype(np.float32)
    return image_of_depth(depth, bank.camera).image


@pytest.fixture(scope="module")
def goal(bed, other):  # noqa: F811
    acts = ["press", "poke", "pinch"]
    return np.asarray(rollout(bed, bed, acts, PLACES, bank=other).images[-1])


HOW = {"positions": PLACES, "tolerance_mm": mm(4e-3), "max_steps": 6}


@pytest.fixture(scope="module")
def learned(tmp_path_factory, bank, other, bed, goal):  # noqa: F811
    """The summary of a run that learned, its session, and what it said."""
    said = []
    folder = tmp_path_factory.mktemp("learning") / "run"
    session = Session.start(folder, goal, {"bank": "pressed-flour-robot"}, say=said.append)
    with robot_of(other, bed) as robot:
        summary = session.mold(robot, bank, adapt=True, **paper(**HOW))
    return summary, session, said


def test_each_action_teaches_the_bank(learned, bank):  # noqa: F811
    summary, session, said = learned
    events = journal.events(session.run.folder / journal.NAME)
    taught = [event for event in events if event["event"] == "learned"]
    assert len(taught) == len(session.run) == summary["learned"]["looks"]
    assert taught[0]["learned_mm"] == taught[0]["start_mm"] == taught[0]["used_mm"]
    assert json.loads((session.run.folder / "summary.json").read_text()) == summary
    (told,) = [line for line in said if line.startswith("looks like")]
    assert "molded by" in told and "mm off" in told


def test_the_bank_of_a_run_is_what_the_run_learned(learned, bank, other, bed):  # noqa: F811
    _, session, _ = learned
    again = bank_of(session.run.folder)
    assert again.actions == bank.actions and again.camera == bank.camera
    assert not np.allclose(again.intervals, bank.intervals)
    act = PlacedAction("press", (240, 150))
    true, before, after = (
        np.asarray(rollout(bed, bed, [act], bank=one).images[1]) for one in (other, bank, again)
    )
    assert np.abs(after - true).sum() < 0.8 * np.abs(before - true).sum()
    assert bank_of("pressed-flour-robot").actions == bank.actions


def test_a_resumed_run_learns_what_it_had_learned(learned, bank):  # noqa: F811
    _, session, _ = learned
    known = learned_from(runs.Run.open(session.run.folder), bank)
    assert known.evidence.count == len(session.run)
    mine = known.evidence.numbers
    theirs = [
        event["numbers"]
        for event in journal.events(session.run.folder / journal.NAME)
        if event["event"] == "learned"
    ][-1]
    # The run's frames are whole tenths of a millimetre.
    np.testing.assert_allclose(mine, list(theirs.values()), rtol=0.1, atol=2e-4)


def test_a_run_becomes_a_data_set(learned, bank, other, tmp_path, capsys):  # noqa: F811
    _, session, _ = learned
    out = tmp_path / "pairs"
    assert main(["dataset", "from-run", str(session.run.folder), str(out)]) == 0
    pairs = datasets.load_pairs(out)
    assert f"{len(session.run)} pairs: {out}" in capsys.readouterr().out
    assert len(pairs) == len(session.run)
    found = lessons_of(bank, pairs)
    names = [bank.actions[one.action] for one in found]
    off = [
        [one.error_mm(hand_of(hands, name)) for one, name in zip(found, names, strict=True)]
        for hands in (other, bank)
    ]
    assert np.mean(off[0]) < 0.1 < np.mean(off[1])


@pytest.mark.parametrize("yaw", [0.5, -2.0])
def test_frames_are_turned_back_about_the_camera_s_axis(bank, bed, yaw):  # noqa: F811
    camera = bank.camera
    act = PlacedAction("poke", (250, 190), 1.0, yaw)
    after = np.asarray(rollout(bed, bed, [act], bank=bank).images[1])
    depths = [
        np.asarray(camera.depth(jshape.metric.unweigh(image, camera)), np.float32)
        for image in (bed, after)
    ]
    before, turned = (turned_back(depth, camera, yaw) for depth in depths)
    v, u = np.unravel_index(np.nanargmax(np.nan_to_num(turned - before)), turned.shape)
    straight = np.asarray(rollout(bed, bed, [replace(act, yaw=0.0)], bank=bank).images[1])
    deepest = np.unravel_index(np.argmin(straight - bed), bed.shape)
    x, y = camera.at(250, 190, 1.0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    place = camera.pixel(cos * x + sin * y, cos * y - sin * x, 1.0)
    beside = deepest[1] - 250, deepest[0] - 190
    expected = [float(p) + d for p, d in zip(place, beside, strict=True)]
    np.testing.assert_allclose((u, v), expected, atol=4)


def test_what_an_action_cannot_leave_ends_the_loop_and_teaches_nothing(bank, goal, bed):  # noqa: F811
    class Slipping(Obedient):
        def act(self, action, position):
            super().act(action, position)
            if len(self.acted) in slips:
                (u, v), (w, h) = position, self.bank.roi(action)
                window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
                self.image[window] = np.maximum(self.image[window] - 0.2, 0)  # 10 mm lower

    slips, learning = (2, 3), Learning(bank)
    result = loop_of(Slipping(bank, bed), goal, bank, learn=learning, **paper(**HOW))
    assert result.stop is Stop.UNLIKELY
    assert [step.unlikely for step in result.steps] == [False, True, True]
    assert learning.evidence.count == 1


def test_a_test_press_is_beside_the_goal(bank, bed, goal):  # noqa: F811
    act = probe(bank, bed, goal)
    assert act.action == "poke"
    (u, v), (w, h) = act.position, bank.roi("poke")
    asked = np.abs(goal - bed)
    assert asked[v - h // 2 : v + h // 2, u - w // 2 : u + w // 2].sum() < 0.02 * asked.sum()
    world = Obedient(bank, bed)
    result = loop_of(world, goal, bank, probe=True, **paper(**HOW | {"max_steps": 2}))
    assert result.steps[0].position == act.position and len(result.steps) == 2
    middle = np.zeros(bed.shape, bool)
    middle[192:202, 234:244] = True
    with pytest.raises(JShapeError, match="no place for a test press"):
        probe(bank, bed, goal, Constraints(reachable=middle))


def test_odd_runs_are_refused(tmp_path, capsys):
    run = runs.Run.create(tmp_path / "run", {"what": "mold"})
    with pytest.raises(BadFile, match="names no bank"):
        bank_of(run.folder)
    circle = runs.Run.create(tmp_path / "circle", {"bank": str(tmp_path / "circle")})
    with pytest.raises(BadFile, match="chain"):
        bank_of(circle.folder)
    left_out = Counter()
    assert list(pairs_of(circle, jshape.load_bank("flour-robot"), left_out)) == [] == [*left_out]
    for words in (["--arm", "dry", "--adapt"], ["--arm", "sim:3", "--probe"]):
        assert main(["mold", "x.png", *words, "--yes", "--out", str(tmp_path / "new")]) == 2
        assert capsys.readouterr().err.count("\n") == 1
