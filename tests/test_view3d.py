"""Plans and runs to be looked at in 3-D: what is read of each folder, and what is written."""

import json
import math
import shutil
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest

from jshape import PAPER_BOX, metric, plan
from jshape.actions import PlacedAction
from jshape.app import pictures
from jshape.app.view.episode import Episode, EpisodeStep
from jshape.app.view.read import read_episode
from jshape.app.view.recording import DEPTH_UNIT, write_recording
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError
from jshape.io import runs
from jshape.io.banks import save_bank
from jshape.io.images import write_depth_png
from jshape.robot.session import Session
from tests.browser import environment
from tests.conftest import ROOT, mm, paper
from tests.stage import PLACES, UNIT, mold, robot_of

MM = 0.16
"""Half a count (0.1 mm) of the look before, half of that after, and a count (0.05) of the stage."""

RERUN = (sys.executable, "-m", "rerun_cli")
"""Rerun's program by the Python that has it: nobody's PATH need lead there."""


def depth_of(image):
    return np.asarray(PAPER_BOX.depth(metric.unweigh(image, PAPER_BOX)))


@pytest.fixture(scope="module")
def stored_bank(bank, tmp_path_factory):
    return save_bank(bank, tmp_path_factory.mktemp("bank") / "bank")


@pytest.fixture
def planned(bank, molded):
    now, goal, _ = molded
    return plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))


@pytest.fixture
def session(tmp_path, molded, stored_bank):
    meta = {"what": "mold", "bank": str(stored_bank)}
    return Session.start(tmp_path / "run", molded[1], meta, say=lambda line: None)


def test_a_plan_foretells(planned, tmp_path):
    planned.to_json(tmp_path / "plan.json")
    for path in (tmp_path, tmp_path / "plan.json"):
        episode = read_episode(path)
        assert len(episode) == 3 and not episode.is_run and "plan, 3 actions" in episode.title
        assert episode.steps[0].predicted is None and episode.steps[0].action is None
        np.testing.assert_allclose(episode.steps[0].seen, depth_of(planned.images[0]), atol=1e-6)
        for k, shown in enumerate(episode.steps[1:]):
            assert shown.seen is None and shown.action == planned[k]
            np.testing.assert_allclose(shown.predicted, depth_of(planned.images[k + 1]), atol=1e-6)
            assert shown.before_mm == planned.distances_mm[k]
            assert shown.predicted_mm == planned.distances_mm[k + 1]
        np.testing.assert_allclose(episode.goal, depth_of(planned.goal), atol=1e-6)


@pytest.mark.full
def test_a_run_of_a_robot_tells_what_was_seen_and_predicted(session, bank, molded):
    now, goal, applied = molded
    with robot_of(bank, now) as robot:
        summary = mold(session, robot, bank)
    folder = session.run.folder
    for parts in ((), ("plan.json",), ("plan.json", "log.jsonl")):  # less and less is there
        for name in parts:
            (folder / name).unlink(missing_ok=True)
        episode = read_episode(folder)
        assert sorted((act.action, *act.position) for act in episode.actions()) == sorted(applied)
        assert len(episode) == 3 and episode.is_run
        for k, (shown, step) in enumerate(zip(episode.steps[1:], summary["steps"], strict=True)):
            seen = runs.Run.open(folder).depth(k)
            np.testing.assert_array_equal(shown.seen, seen)
            assert shown.action.roi == bank.roi(shown.action.action)
            # The stage's bed becomes what the bank predicts: both agree, wherever it was from.
            assert 1000 * np.abs(shown.predicted - seen).max() < MM
            assert shown.seen_mm == step["obtained_mm"] and shown.effort_nm == 0.0
            assert (shown.seconds is None) == ("log.jsonl" in parts)
        assert math.isclose(episode.steps[0].seen_mm, summary["before_mm"], rel_tol=1e-5)
        assert episode.notes[0].startswith("finished: the distance is within")


def test_a_prediction_is_of_the_bed_that_was_seen_before(session, bank, molded):
    """Nothing of what happens after an action is in what was predicted of it."""
    with robot_of(bank, molded[0]) as robot:
        mold(session, robot, bank, max_steps=2)
    folder = session.run.folder
    (folder / "plan.json").unlink()
    before = read_episode(folder).steps[2].predicted
    spoilt = runs.Run.open(folder).depth(1) + 0.004
    write_depth_png(folder / "frames/001.png", spoilt, session.run.depth_unit)
    np.testing.assert_array_equal(read_episode(folder).steps[2].predicted, before)


def test_a_run_of_the_demo_has_its_goal_and_start_from_the_plan(
    planned, bank, stored_bank, tmp_path
):
    run = runs.Run.create(tmp_path / "demo", {"what": "demo", "bank": str(stored_bank)})
    d_mm = planned.distances_mm
    for k, name in enumerate(planned.actions):
        step = {"action": name, "position": planned.positions[k], "before_mm": d_mm[k],
                "predicted_mm": d_mm[k + 1], "obtained_mm": d_mm[k + 1]}  # fmt: skip
        run.append(step, depth_of(planned.images[k + 1]))
        episode = read_episode(run.folder)  # half-finished: no plan, no goal, no start yet
        assert len(episode) == k + 1 and episode.goal is None and episode.last(0) is None
        assert "the run holds no goal" in episode.notes
        assert episode.notes[0] == "the run has not ended, or was killed"
    planned.to_json(run.folder / "plan.json")
    (run.folder / "summary.json").write_text(json.dumps({"stop": "MAX_STEPS"}))
    episode = read_episode(run.folder)
    assert episode.notes == ("finished: as many actions as allowed",)
    np.testing.assert_allclose(episode.steps[0].seen, depth_of(planned.initial), atol=1e-6)
    np.testing.assert_allclose(episode.goal, depth_of(planned.goal), atol=1e-6)
    assert all(shown.predicted is not None for shown in episode.steps[1:])


@pytest.mark.full
def test_an_action_that_nobody_looked_at_is_told_of_and_a_resumed_run_too(session, bank, molded):
    done = []

    def pulled_out(operation):
        done.append(operation)
        if len(done) == 11:  # of six operations each, in the middle of the second action
            raise KeyboardInterrupt

    with robot_of(bank, molded[0], pulled_out) as robot, pytest.raises(KeyboardInterrupt):
        mold(session, robot, bank)
    folder = session.run.folder
    episode = read_episode(folder)
    assert len(episode) == 2 and episode.steps[2].seen is None
    assert episode.steps[2].seconds is None
    assert episode.steps[2].predicted is not None  # the look before it is known
    assert episode.notes == (
        "interrupted: interrupted", "the last action was begun and not looked at"
    )  # fmt: skip
    again = Session.resume(folder, say=lambda line: None)
    with robot_of(bank, robot.depth_camera.image) as fresh:
        mold(again, fresh, bank)
    later = read_episode(folder)
    assert later.actions()[:2] == episode.actions() and len(later) == 2 + len(fresh.arm.acted)
    assert [m.seen is None for m in later.steps] == [False, False, True, False]
    # The look after the run was resumed was not kept: no guess of what it showed.
    (folder / "plan.json").unlink()
    assert read_episode(folder).steps[3].predicted is None


def test_a_run_whose_bank_is_gone_is_shown_as_far_as_it_goes(session, bank, molded, tmp_path):
    with robot_of(bank, molded[0]) as robot:
        mold(session, robot, bank)
    folder = session.run.folder
    described = json.loads((folder / "run.json").read_text())
    described["meta"]["bank"] = str(tmp_path / "gone")
    (folder / "run.json").write_text(json.dumps(described))
    assert any("not all that was predicted" in note for note in read_episode(folder).notes)
    (folder / "plan.json").unlink()
    with pytest.raises(BadCamera, match="--camera-file"):
        read_episode(folder)
    episode = read_episode(folder, camera=PAPER_BOX)
    assert len(episode) == 3 and episode.steps[1].predicted is None
    assert episode.box(1) is None and episode.actions()[0].roi is None
    with pytest.raises(BadImage, match="480x395"):
        (folder / "goal.npy").unlink()
        read_episode(folder, camera=PAPER_BOX.crop(0, 0, 100, 100))


def test_odd_folders_are_refused_in_one_line(tmp_path, planned, stored_bank):
    with pytest.raises(BadFile, match="no such file"):
        read_episode(tmp_path / "nothing")
    with pytest.raises(BadFile, match="neither a run"):
        read_episode(tmp_path)
    run = runs.Run.create(tmp_path / "run", {"bank": str(stored_bank)})
    with pytest.raises(BadFile, match="no frame yet"):
        read_episode(run.folder)
    run.append({"action": "knock"}, np.full(PAPER_BOX.shape, 0.45))
    with pytest.raises(BadFile, match="line 1: missing position"):
        read_episode(run.folder)
    other = runs.Run.create(tmp_path / "other", {"bank": str(stored_bank)})
    other.append({"action": "knock", "position": [9, 9], "before_mm": "much"}, None)
    with pytest.raises(BadFile, match="before_mm is 'much'; expected a number"):
        read_episode(other.folder)
    planned.to_json(tmp_path / "bare.json", images=False)
    with pytest.raises(JShapeError, match="without its images"):
        read_episode(tmp_path / "bare.json")


def _episode(depth, acts=(), goal=None):
    after = tuple(EpisodeStep(predicted=depth, action=act) for act in acts)
    return Episode("test", PAPER_BOX, goal, (EpisodeStep(seen=depth), *after))


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_box_holds_the_material_of_its_roi_and_projects_to_its_outline(rng, yaw):
    depth = (0.45 + 0.002 * rng.standard_normal(PAPER_BOX.shape)).astype(np.float32)
    act = PlacedAction("knock", (300.0, 150.0), yaw=yaw, roi=(100, 60))
    episode = _episode(depth, [act])
    box, corners = episode.box(1), act.outline
    assert len({tuple(c) for c in np.round(box, 9)}) == 8
    x, y, z = box.T
    u, v = x / z.mean() * 433.0 + 240, y / z.mean() * 433.0 + 197
    seen = {tuple(c) for c in np.round(np.stack([u, v], -1), 3)}
    assert seen == {tuple(c) for c in np.round(corners, 3)}
    left, top = np.floor(corners.min(0)).astype(int)
    right, bottom = np.ceil(corners.max(0)).astype(int)
    inside = depth[top:bottom, left:right]
    assert np.isclose(z.min(), inside.min() - 0.001) and np.isclose(z.max(), inside.max() + 0.001)


def test_an_episode_says_and_ends_its_strokes(rng):
    depth = np.full(PAPER_BOX.shape, 0.45, np.float32)
    sweep = PlacedAction("sweep", (100.0, 150.0), yaw=0.5, stroke=(60.0, -20.0))
    scoop = PlacedAction("scoop", (200.0, 150.0), 0.8, stroke=(99.6, 70.4))
    pour = PlacedAction("pour", (300.0, 220.0))
    episode = _episode(depth, [sweep, scoop, pour])
    assert episode.words(1) == "sweep (100, 150), yaw 29°, 65 mm long: not looked at"
    assert episode.words(2).startswith("scoop x0.8 (200, 150), taken 125 mm to the next: ")
    assert episode.words(3) == "pour (300, 220): not looked at"
    assert episode.actions(2) == episode.actions()[:2] and len(episode.actions()) == 3
    ends = [act.ends for act in episode.actions()]
    np.testing.assert_allclose(ends[0], [(70, 160), (130, 140)])
    np.testing.assert_allclose(ends[1], [(200, 150), (299.6, 220.4)])  # places of runs are rounded
    np.testing.assert_allclose(ends[2], [(300, 220)] * 2)
    assert _episode(depth).actions() == ()


def test_colours_say_which_is_higher():
    scale = pictures.Scale(-25.0, 25.0, pictures.HEIGHTS)
    flat = np.zeros((9, 9))
    colours = [pictures.shaded(flat + mm, scale)[4, 4].astype(int) for mm in (20.0, 0.0, -20.0)]
    assert colours[0].sum() > colours[1].sum() > colours[2].sum()
    scale = pictures.Scale(-5.0, 5.0, pictures.DIFFERENCES)
    row = pictures.differing(np.array([[5.0, 0.0, -5.0, np.nan]]), scale)[0].astype(int)
    high, none, low, unknown = row
    assert high[0] > high[2] and low[2] > low[0] and none.min() > 240
    assert unknown.tolist() == list(pictures.NOTHING)


@pytest.fixture
def rerun_home(tmp_path, monkeypatch):
    """Rerun's programs with their telemetry off."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home/.config"))
    (tmp_path / "home").mkdir()
    subprocess.run([*RERUN, "analytics", "disable"], check=True, capture_output=True)
    return tmp_path


@pytest.mark.full
def test_a_recording_holds_it_all_on_one_timeline(session, bank, molded, rerun_home):
    with robot_of(bank, molded[0]) as robot:
        mold(session, robot, bank)
    episode = read_episode(session.run.folder)
    path = write_recording(rerun_home / "run.rrd", episode)
    checked = subprocess.run([*RERUN, "rrd", "verify", str(path)], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr
    rows, depths, timelines = {}, [], set()
    for chunk in _chunks(path):
        batch = chunk.to_record_batch()
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
        names = set(batch.schema.names)
        timelines |= {
            f.name for f in batch.schema if b"index" in (f.metadata or {}).get(b"rerun:kind", b"")
        }
        if chunk.entity_path == "/world/seen/depth":
            column = next(n for n in names if n.endswith("buffer"))
            depths += [np.array(one[0]) for one in batch.column(column).to_pylist()]
    beds = {f"/world/{bed}/depth" for bed in ("seen", "predicted", "goal")}
    pictures = {f"/difference/{name}" for name in ("seen", "predicted", "error")}
    curves = {"/distance/obtained", "/distance/predicted", "/effort/effort"}
    boxes = {"/world/actions", "/world/seen/actions", "/world/predicted/actions"}
    assert beds | pictures | curves | boxes | {"/log", "/world/seen", "/words"} <= set(rows)
    assert timelines == {"step"}
    assert len(depths) == 4 and rows["/world/predicted/depth"] == 3 and rows["/log"] == 4
    for k, raw in enumerate(depths[1:]):
        counts = raw.astype(np.uint8).view(np.uint16).reshape(PAPER_BOX.shape)
        np.testing.assert_allclose(counts * DEPTH_UNIT, session.run.depth(k), atol=1e-7)
    assert UNIT != DEPTH_UNIT and session.run.depth_unit == DEPTH_UNIT


def _chunks(path):
    from rerun.chunk import RrdReader

    return list(RrdReader(path).stream())


def test_a_recording_replaces_nothing_unasked(planned, rerun_home):
    planned.to_json(rerun_home / "plan.json")
    episode, path = read_episode(rerun_home / "plan.json"), rerun_home / "kept.rrd"
    path.write_text("mine")
    with pytest.raises(BadFile, match="--overwrite"):
        write_recording(path, episode)
    assert path.read_text() == "mine"
    write_recording(path, episode, overwrite=True)
    assert path.read_bytes()[:3] == b"RRF"
    with pytest.raises(BadFile, match="ends in .rrd"):
        write_recording(rerun_home / "plan.json", episode, overwrite=True)


def test_rerun_that_is_missing_is_one_line(planned, tmp_path, monkeypatch):
    planned.to_json(tmp_path / "plan.json")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(JShapeError, match=r"pip install 'jshape\[rerun\]'") as said:
        write_recording(tmp_path / "plan.rrd", read_episode(tmp_path))
    assert "\n" not in str(said.value) and not (tmp_path / "plan.rrd").exists()


def _view(planned, folder, capsys, *words):
    """What `jshape view` says on stderr when it ends with code 2."""
    from jshape.cli.main import main

    planned.to_json(folder / "plan.json")
    assert main(["view", str(folder), "--no-open", *words]) == 2
    return capsys.readouterr().err


def test_nicegui_that_is_missing_is_one_line(planned, tmp_path, monkeypatch, capsys):
    for name in ("view.page", "pages", "bed_scene", "curve", "widgets"):
        monkeypatch.delitem(sys.modules, f"jshape.app.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    said = _view(planned, tmp_path, capsys, "--port", "0")
    assert "pip install 'jshape[studio]'" in said and said.count("\n") == 1


def test_a_port_that_is_taken_is_refused(planned, tmp_path, capsys):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        said = _view(planned, tmp_path, capsys, "--port", str(other.getsockname()[1]))
        assert "nothing can listen at 127.0.0.1" in said and "--port 0" in said
    for host in ("203.0.113.7", "a..b"):
        said = _view(planned, tmp_path, capsys, "--host", host)
        assert f"nothing can listen at {host}" in said and "--port 0" not in said


@pytest.mark.full
def test_ctrl_c_ends_the_command_cleanly(planned, tmp_path, request):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    planned.to_json(tmp_path / "plan.json")
    words = ["view", str(tmp_path), "--port", "0", "--no-open"]
    command = [sys.executable, "-m", "jshape", *words]
    # Where Ctrl-C is ignored, as in a shell's background, a child would ignore it too.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    with subprocess.Popen(
        command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=environment(),
    ) as process:  # fmt: skip
        line = process.stderr.readline()
        assert "jshape view is at http://127.0.0.1:" in line
        process.send_signal(signal.SIGINT)
        try:
            told, complained = process.communicate(timeout=60)
        finally:
            process.kill()  # leaving the block waits for its end
    assert process.returncode == 0 and "Traceback" not in complained
    assert told.startswith("plan, 3 actions")


@pytest.mark.full
def test_the_command_writes_a_recording(planned, rerun_home, capsys):
    from jshape.cli.main import main

    planned.to_json(rerun_home / "plan.json")
    out = rerun_home / "plan.rrd"
    words = ["view", str(rerun_home / "plan.json"), "--save", str(out), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["recording"] == str(out) and len(told["steps"]) == 4 and out.is_file()
    assert main(words) == 2 and "--overwrite" in capsys.readouterr().err
    shutil.rmtree(rerun_home / "home")
    assert main(["view", str(rerun_home), "--save", str(out), "--overwrite"]) == 0
    assert not (rerun_home / "home").exists()  # writing one leaves no telemetry behind
