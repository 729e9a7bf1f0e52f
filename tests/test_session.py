"""A run with a robot: written as it happens, stopped by whatever goes wrong, gone on with after."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from jshape import PAPER_BOX, JShapeError
from jshape.actions import PlacedAction
from jshape.errors import BadCamera, BadFile, MissingDepth
from jshape.io import journal, runs
from jshape.planning.options import StopCriteria
from jshape.robot.arms.base import ArmError, ArmLost, EffortLimit, Moved, PoseRefused
from jshape.robot.arms.guarded import GuardedArm
from jshape.robot.cameras.base import CameraLost
from jshape.robot.cameras.guarded import GuardedCamera
from jshape.robot.checks import BedMoved, Occluded, check_still, touched_by
from jshape.robot.procedure import NAMES
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from jshape.robot.signals import SIGNALS, interruptible
from tests.conftest import ROOT, mm, paper
from tests.stage import Arm, Eye, mold, robot_of


def quiet(line):
    """Says nothing."""


@pytest.fixture
def session(tmp_path, molded):
    return Session.start(tmp_path / "run", molded[1], {"bank": "fixture"}, say=quiet)


def _summary(session):
    return json.loads((session.run.folder / "summary.json").read_text())


def _events(session):
    return [event["event"] for event in journal.events(session.run.folder / journal.NAME)]


def test_a_run_molds_the_bed_and_keeps_all_of_it(session, bank, molded):
    now, goal, applied = molded
    with robot_of(bank, now) as robot:
        summary = mold(session, robot, bank)
    assert sorted(robot.arm.acted) == sorted(applied)
    assert summary == _summary(session) and summary["stop"] == "CONVERGED"
    assert summary["obtained_mm"] < 0.02 < 0.2 < summary["before_mm"]
    assert robot.arm.stops and robot.arm.closed == 1 and robot.depth_camera.closed == 1
    run = runs.Run.open(session.run.folder)
    assert len(run) == 3 and run.depth(2).shape == bank.camera.shape
    for step in run.steps:
        assert [one["operation"] for one in step["operations"]] == list(NAMES)
    begins = ["started", "homing", "looked", "planned", "acting", "operation"]
    assert _events(session)[:6] == begins and robot.arm.homes == 4  # before all, after each
    assert _events(session)[-1] == "stopped"


def test_a_plan_is_carried_out_as_it_is(session, bank, molded):
    from jshape import plan
    from tests.stage import PLACES

    now, goal, applied = molded
    planned = plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    with robot_of(bank, now) as robot:
        summary = session.mold(robot, bank, plan=planned)
    assert [name for name, *_ in robot.arm.acted] == list(planned.actions)
    assert summary["stop"] == "PLAN_ENDED"
    predicted = [step["predicted_mm"] for step in summary["steps"]]
    np.testing.assert_allclose(predicted, planned.distances_mm[1:], rtol=1e-6)


def test_strokes_are_kept_and_make_another_plan(session, bank, molded):
    from jshape import plan
    from tests.stage import PLACES

    now, goal, _ = molded
    made = plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    strokes = np.zeros((3, 2), np.float32)
    strokes[0] = made.exact_positions[1] - made.exact_positions[0]
    carry = replace(made, strokes=strokes)
    with robot_of(bank, now) as robot:
        session.mold(robot, bank, plan=carry, confirm=lambda ahead: len(robot.arm.acted) < 1)
    first = session.run.steps[0]
    assert first["stroke"] == strokes[0].tolist() and first["length"] == 1.0
    events = journal.events(session.run.folder / journal.NAME)
    planned = next(event for event in events if event["event"] == "planned")
    assert planned["stroke"] == strokes[0].tolist() and planned["length"] == 1.0
    again = Session.resume(session.run.folder, say=quiet)
    for other in (made, replace(carry, lengths=np.array([1, 1, 2], np.float32))):
        with robot_of(bank, now) as robot, pytest.raises(BadFile, match="with another plan"):
            again.mold(robot, bank, plan=other)
    with robot_of(bank, now) as robot:
        again.mold(robot, bank, plan=carry)
    assert [name for name, *_ in robot.arm.acted] == list(made.actions[1:])


def test_a_path_that_the_hand_has_not_is_refused_before_it_moves(session, bank, molded):
    from jshape.planning.api import rollout

    now, goal, _ = molded
    made = rollout(now, goal, ["knock", "poke"], [[239, 197]] * 2, bank=bank)
    made = replace(made, lengths=np.array([1.0, 1.5], np.float32))
    with robot_of(bank, now) as robot, pytest.raises(PoseRefused, match="poke: .* no path_mm"):
        session.mold(robot, bank, plan=made)
    assert not robot.arm.acted


def test_people_are_asked_and_may_say_no(session, bank, molded):
    asked = []

    def ask(ahead):
        asked.append(ahead.actions[0])
        return len(asked) < 2

    with robot_of(bank, molded[0]) as robot:
        summary = mold(session, robot, bank, confirm=ask)
    assert len(asked) == 2 and len(robot.arm.acted) == 1 and summary["stop"] == "DECLINED"


def _unplugged(robot):
    def lost(counts):
        raise CameraLost("test camera: nothing came for 5 s")

    robot.depth_camera.spoil = lost


def _frozen(robot):
    kept = robot.depth_camera.frame()
    robot.depth_camera.spoil = lambda counts: kept


def _without_depth(robot):
    holes = np.random.default_rng(0).random(robot.camera.shape) < 0.6
    robot.depth_camera.spoil = lambda counts: np.where(holes, 0, counts).astype(np.uint16)


def _occluded(robot):
    def hand(counts):
        counts[150:200, 100:160] = round(0.3 / robot.depth_camera.depth_unit)
        return counts

    robot.depth_camera.spoil = hand


def _moved(robot):
    robot.depth_camera.spoil = lambda counts: (
        counts + round(0.003 / robot.depth_camera.depth_unit)
    ).astype("uint16")


EYES = {
    "unplugged": (_unplugged, CameraLost, "nothing came for 5 s"),
    "frozen": (_frozen, CameraLost, "3 frames are the same to the bit"),
    "60 % missing": (_without_depth, MissingDepth, "have no depth reading"),
    "occluded": (_occluded, Occluded, "something is in front of the bed"),
    "moved": (_moved, BedMoved, "the bed or the camera was moved"),
}


@pytest.mark.full
@pytest.mark.parametrize("fault", EYES)
@pytest.mark.parametrize("after", [0, 1])
def test_an_eye_that_fails_ends_the_run_in_a_clear_state(session, bank, molded, fault, after):
    """Before anything was done, or once an action was."""
    spoil, error, said = EYES[fault]
    if fault == "moved" and after == 0:
        pytest.skip("a bed that was never seen elsewhere has not moved")

    def acted(operation):
        if operation == "clear" and after:
            spoil(robot)

    with robot_of(bank, molded[0], acted) as robot:
        if not after:
            spoil(robot)
        with pytest.raises(error, match=said):
            mold(session, robot, bank)
    assert robot.arm.stops and len(robot.arm.acted) == after
    summary = _summary(session)
    assert summary["state"] == "aborted" and summary["stop"] == error.__name__
    assert said in summary["why"] and "\n" not in summary["why"]
    assert _events(session)[-1] == "aborted"
    _goes_on(session, bank, robot)


ARMS = {
    "refuses a pose": PoseRefused("inverse kinematics found no way to (1, 2, 3) mm"),
    "breaks": ArmError("a fuse blew"),
    "effort": EffortLimit("act: effort 130 Nm; the hard limit is 120"),
    "bug": ZeroDivisionError("a mistake of ours"),
    "Ctrl-C": KeyboardInterrupt(),
}


@pytest.mark.full
@pytest.mark.parametrize("fault", ARMS)
@pytest.mark.parametrize("when", ["above", "act", "clear"])
def test_an_arm_that_fails_is_stopped_and_the_run_is_whole(session, bank, molded, fault, when):
    problem = ARMS[fault]
    error = ArmError if fault == "bug" else type(problem)  # one line, whatever a driver raises
    done = []

    def fails(operation):
        done.append(operation)
        if operation == when and len(done) > len(NAMES):  # in the second action
            raise problem

    with robot_of(bank, molded[0], fails) as robot:
        with pytest.raises(error):
            mold(session, robot, bank)
        assert robot.arm.stops >= 1
    state = "interrupted" if fault == "Ctrl-C" else "aborted"
    assert _summary(session)["state"] == state and len(_summary(session)["steps"]) == 1
    assert len(runs.Run.open(session.run.folder)) == 1
    robot.arm.fails = lambda operation: None
    _goes_on(session, bank, robot)


def _goes_on(session, bank, robot):
    """The same bed, a run resumed: the rest is done, and nothing twice."""
    robot.depth_camera.spoil = lambda counts: counts
    robot.arm.fails = lambda operation: None
    before = len(runs.Run.open(session.run.folder))
    again = Session.resume(session.run.folder, say=quiet)
    fresh = robot_of(bank, robot.depth_camera.image)
    with fresh:
        summary = mold(again, fresh, bank)
    assert summary["stop"] == "CONVERGED" and summary["obtained_mm"] < 0.02
    assert len(summary["steps"]) == before + len(fresh.arm.acted)
    assert "resumed" in _events(again)


def test_three_looks_in_a_row_that_show_nothing_new_end_the_run(session, bank, molded):
    """An arm that digs where nothing is wanted: twice is bad luck, three times a reason to stop."""
    with robot_of(bank, molded[0]) as robot:
        wanted = robot.arm.move

        def elsewhere(pose, **how):
            moved = pose.copy()
            if robot.arm.doing.operation == "act":
                moved[:2, 3] = [0.12, -0.1]
            return wanted(moved, **how)

        robot.arm.move = elsewhere
        summary = mold(session, robot, bank)
    assert summary["stop"] == "WORSE" and len(summary["steps"]) == 3
    obtained = [step["obtained_mm"] for step in summary["steps"]]
    assert summary["before_mm"] < obtained[0] < obtained[1]


def test_an_arm_that_cannot_even_stop_is_said_to(session, bank, molded):
    """The first problem is passed on, the second is written down, and all is closed."""

    def fails(operation):
        if operation == "act":
            raise ConnectionResetError("the cable")

    def stop():
        raise ConnectionError("still gone")

    robot = robot_of(bank, molded[0], fails)
    robot.arm.stop = stop
    with pytest.raises(ArmError, match="test arm: begin: ConnectionResetError: the cable"), robot:
        mold(session, robot, bank)
    assert "did not stop: ConnectionError: still gone" in _summary(session)["why"]
    assert robot.arm.closed == 1 and robot.depth_camera.closed == 1


def _planned(bank, molded):
    from jshape import plan
    from tests.stage import PLACES

    return plan(molded[0], molded[1], bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))


def test_an_action_that_was_not_looked_at_is_not_done_twice(session, bank, molded):
    """The camera was lost after the second of three actions: the plan goes on with the third."""
    planned, count = _planned(bank, molded), 0

    def second(operation):
        nonlocal count
        count += operation == "clear"
        if count == 2:
            _unplugged(robot)

    with robot_of(bank, molded[0], second) as robot, pytest.raises(CameraLost):
        session.mold(robot, bank, plan=planned, stop=StopCriteria(max_steps=3))
    again = Session.resume(session.run.folder, say=quiet)
    assert again.done == 2 and len(again.run) == 1
    with robot_of(bank, robot.depth_camera.image) as fresh:
        again.mold(fresh, bank, plan=planned, stop=StopCriteria(max_steps=3))
    places = planned.positions.tolist()
    wanted = [(name, *at) for name, at in zip(planned.actions, places, strict=True)]
    assert robot.arm.acted + fresh.arm.acted == wanted
    third = Session.resume(session.run.folder, say=quiet)
    with robot_of(bank, molded[0]) as robot, pytest.raises(BadFile, match="with another plan"):
        third.mold(robot, bank, plan=planned.rest(1), stop=StopCriteria(max_steps=9))


def test_all_of_a_plan_is_checked_before_the_first_action(session, bank, molded):
    planned = _planned(bank, molded)
    wrong = replace(planned, actions=(*planned.actions[:2], "fly"))
    with robot_of(bank, molded[0]) as robot, pytest.raises(ArmError, match="cannot fly"):
        session.mold(robot, bank, plan=wrong)
    assert not robot.arm.acted
    seen = replace(planned, camera=replace(PAPER_BOX, fx=250.0))
    with robot_of(bank, molded[0]) as robot, pytest.raises(BadFile, match="with another plan"):
        session.mold(robot, bank, plan=planned)
    other = session.run.folder.with_name("other")
    fresh = Session.start(other, molded[1], {"bank": "fixture"}, say=quiet)
    with robot_of(bank, molded[0]) as robot, pytest.raises(BadCamera, match="the plan's"):
        fresh.mold(robot, bank, plan=seen)


def test_a_run_belongs_to_one_program(session, bank, molded):
    other = Session.resume(session.run.folder, say=quiet)

    def ask(ahead):
        with robot_of(bank, molded[0]) as robot, pytest.raises(BadFile, match="another program"):
            mold(other, robot, bank)
        assert not robot.arm.acted and not robot.arm.homes
        return False

    with robot_of(bank, molded[0]) as robot:
        assert mold(session, robot, bank, confirm=ask)["stop"] == "DECLINED"


def test_a_full_disk_stops_the_arm(session, bank, molded, monkeypatch):
    """The journal is written before the arm moves: what cannot be kept is not done."""

    def full(path, data, at):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(journal, "append", full)
    with robot_of(bank, molded[0]) as robot, pytest.raises(BadFile, match="No space left"):
        mold(session, robot, bank)
    assert robot.arm.stops and not robot.arm.acted
    assert _summary(session)["state"] == "aborted"


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 900 kB: room for a goal, a look and little more."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=900k", "tmpfs", str(folder)]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("a small disk needs the right to mount one")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_disk_that_fills_up_keeps_what_was_done(small_disk, bank, molded):
    session = Session.start(small_disk / "run", molded[1], {"bank": "fixture"}, say=quiet)
    with robot_of(bank, molded[0]) as robot:

        def fill(operation):
            if operation == "clear":  # all is done but the look and what is written of it
                with suppress(OSError), (small_disk / "rest").open("wb") as file:
                    for _ in range(1000):
                        file.write(bytes(1024))
                        file.flush()

        robot.arm.fails = fill
        with pytest.raises(BadFile, match="No space left"):
            mold(session, robot, bank)
    assert robot.arm.stops and len(robot.arm.acted) == 1
    (small_disk / "rest").unlink()
    subprocess.run(["mount", "-o", "remount,size=8m", str(small_disk)], check=True)
    assert len(runs.Run.open(session.run.folder)) == 0  # the step's line was not whole
    assert session.done == 1  # but what was done is known
    _goes_on(session, bank, robot)


def _fill(folder):
    """Fill a disk up to its last byte."""
    with suppress(OSError), (folder / "rest").open("wb", buffering=0) as file:
        for size in (2**20, 2**12, 1):
            with suppress(OSError):
                while file.write(bytes(size)) == size:
                    pass


@pytest.mark.full
def test_a_disk_that_is_full_at_any_write_leaves_what_goes_on_or_nothing(
    small_disk, bank, molded, monkeypatch
):
    """After each of the syncs of a run of one action; `--resume` or the same command goes on."""
    subprocess.run(["mount", "-o", "remount,size=8m", str(small_disk)], check=True)
    folder, sync, count = small_disk / "run", os.fsync, 0
    pictures = {"steps.png": bytes(9000), "result.png": bytes(9000)}
    few = {"max_steps": 1, "draw": lambda result: pictures}
    failed, resumed = [], 0

    def synced(handle):
        nonlocal count
        sync(handle)
        count += 1
        if count == number:
            _fill(small_disk)

    monkeypatch.setattr(os, "fsync", synced)
    for number in range(1, 99):
        count, session = 0, None
        try:
            with robot_of(bank, molded[0]) as robot:
                session = Session.start(folder, molded[1], {"bank": "fixture"}, say=quiet)
                mold(session, robot, bank, **few)
        except BadFile as problem:
            failed.append(str(problem))
            assert "No space left" in str(problem) and robot.arm.stops
            notes = getattr(problem, "__notes__", [])
            (small_disk / "rest").unlink()
            if session is None:  # nothing is there: the same command again
                assert not notes and not folder.exists()
                session = Session.start(folder, molded[1], {"bank": "fixture"}, say=quiet)
            else:
                assert notes == [f"jshape mold --resume --out {folder} goes on"]
                session, resumed = Session.resume(folder, say=quiet), resumed + 1
            with robot_of(bank, robot.depth_camera.image) as again:
                if session.done > len(session.run):  # done, and not looked at any more
                    with pytest.raises(JShapeError, match="are done; --overwrite replaces it"):
                        mold(session, again, bank, **few)
                    mold(session, again, bank, **few | {"max_steps": 2})
                else:
                    mold(session, again, bank, **few)
        last = not (small_disk / "rest").exists() and count < number
        (small_disk / "rest").unlink(missing_ok=True)
        count = 99  # and no more
        assert _summary(session)["state"] == "finished" and _events(session)
        Session.start(folder, molded[1], {"bank": "fixture"}, overwrite=True, say=quiet)
        shutil.rmtree(folder)
        if last:
            break
    kinds = {text.split(":")[0].rsplit("/", 1)[1] for text in failed}
    names = {"goal.npy", "start.png", "000.png", "log.jsonl", "steps.jsonl"}
    assert names | {"plan.json", "summary.json"} <= kinds and resumed > 5


def test_a_torn_line_of_the_log_is_cut_off(tmp_path):
    path, line = tmp_path / journal.NAME, b'{"event": "looked"}\n'
    path.write_bytes(line + b'{"event": "pla')
    journal.note(path, {"event": "resumed"})
    assert [one["event"] for one in journal.events(path)] == ["looked", "resumed"]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    whole = path.stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (whole + 9, hard))  # nine bytes of the next line
    try:
        with pytest.raises(BadFile, match="File too large"):
            journal.note(path, {"event": "acting"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.stat().st_size == whole
    (tmp_path / "made").touch()
    assert journal.events(tmp_path / "made") == []


HANG = ["frame", "home", "begin", "pose", "stop", "close", "eye.close"]


@pytest.mark.full
@pytest.mark.parametrize("what", HANG)
def test_whatever_hangs_the_run_ends_and_goes_on_later(session, bank, molded, what):
    """In the second action; a `stop` that hangs, once the camera failed too."""
    end, count = threading.Event(), 0

    def hangs(*given, **named):
        end.wait(20)

    def second(operation):
        nonlocal count
        count += operation == "clear"
        if count == 1 and operation == "clear":
            if what == "frame":
                robot.depth_camera.spoil = hangs
            elif what == "stop":
                arm.stop = hangs
                _unplugged(robot)
            elif what not in ("close", "eye.close"):
                setattr(arm, what, hangs)

    eye = Eye(molded[0].copy())
    arm = Arm(bank, eye, second)
    guards = GuardedCamera(eye), GuardedArm(arm)
    vars(guards[0]).update(hangs=0.3, closing=0.1)
    vars(guards[1]).update(floor=0.3, stopping=0.2, closing=0.1, homing=0.0)
    robot = Robot(*guards, load_hand(), bank.camera, frames=3)
    if what == "close":
        arm.close = hangs
    if what == "eye.close":
        eye.close = hangs
    closing = what in ("close", "eye.close")
    error = CameraLost if what in ("frame", "stop", "eye.close") else ArmLost
    began = time.monotonic()
    try:
        with pytest.raises(error) as raised, robot:
            mold(session, robot, bank)
    finally:
        end.set()
    assert time.monotonic() - began < 20
    said = {"stop": "nothing came for 5 s"}.get(what, f"{what.split('.')[-1]} has not ended after")
    assert said in str(raised.value)
    summary = _summary(session)
    if closing:
        assert summary["state"] == "finished"
        return
    assert summary["state"] == "aborted" and summary["stop"] == error.__name__
    assert said in summary["why"] and _events(session)[-1] == "aborted"
    assert ("did not stop: no answer" in summary["why"]) == (what == "stop")
    assert arm.stops or what == "stop"
    if what == "frame":
        _goes_on(session, bank, robot)


EVENTS = ["started", "homing", "looked", "planned", "acting", "operation", "stopped"]


PHASES = [(where, signal.SIGINT) for where in [*EVENTS, "frame", "home", "move", "append", "ask"]]


@pytest.mark.full
@pytest.mark.parametrize(
    ("where", "number"), [*PHASES, *(("move", number) for number in SIGNALS[1:])]
)
def test_ctrl_c_in_any_phase_stops_the_arm_and_the_run_goes_on(
    session, bank, molded, monkeypatch, where, number
):
    """And once more while the arm is being stopped, and the run written down."""
    noted, appended, interrupted = journal.note, runs.Run.append, 0

    def press(at):
        nonlocal interrupted
        if at == where and not interrupted:
            interrupted += 1
            os.kill(os.getpid(), number)
            time.sleep(0.05)

    def note(path, event):
        noted(path, event)
        press(event["event"])
        if event["event"] == "aborted":
            os.kill(os.getpid(), number)

    def append(run, step, depth=None):
        index = appended(run, step, depth)
        press("append")
        return index

    def stop():
        os.kill(os.getpid(), number)
        time.sleep(0.02)
        robot.arm.stops += 1

    def ask(ahead):
        press("ask")
        return True

    monkeypatch.setattr(journal, "note", note)
    monkeypatch.setattr(runs.Run, "append", append)
    robot = robot_of(bank, molded[0])
    moved, homed = robot.arm.move, robot.arm.home
    robot.depth_camera.spoil = lambda counts: press("frame") or counts
    robot.arm.move = lambda pose, **how: press("move") or moved(pose, **how)
    robot.arm.home = lambda: press("home") or homed()
    robot.arm.stop = stop
    before = signal.signal(number, signal.default_int_handler)
    try:
        if where == "stopped":  # it has ended by itself: nothing is lost
            with robot:
                assert mold(session, robot, bank, confirm=ask)["state"] == "finished"
            return
        with pytest.raises(KeyboardInterrupt), robot:
            mold(session, robot, bank, confirm=ask)
    finally:
        signal.signal(number, before)
    assert robot.arm.stops and robot.arm.closed == 1 and robot.depth_camera.closed == 1
    assert _summary(session)["state"] == "interrupted"
    assert _events(session)[-1] == "aborted"
    if where == "append":  # the rest is as short to go on with, and takes a second each
        monkeypatch.undo()
        _goes_on(session, bank, robot)


def test_a_signal_between_any_two_lines_of_the_ending_cuts_nothing_short(session, bank, molded):
    """SIGTERM, and again at each line of the package that handles the first."""
    robot, count = robot_of(bank, molded[0]), 0

    def again(frame, event, given):
        nonlocal count
        if isinstance(sys.exception(), KeyboardInterrupt):
            count += 1
            signal.raise_signal(signal.SIGTERM)
        return again if "jshape" in frame.f_code.co_filename else None

    robot.arm.home = lambda: os.kill(os.getpid(), signal.SIGTERM) or time.sleep(5)
    with interruptible():
        sys.settrace(again)
        try:
            with robot:
                mold(session, robot, bank)
        except KeyboardInterrupt as problem:
            sys.settrace(None)
            assert problem.__notes__ == [f"jshape mold --resume --out {session.run.folder} goes on"]
        finally:
            sys.settrace(None)
        assert count > 100 and robot.arm.stops and robot.depth_camera.closed == 1
        assert _summary(session)["state"] == "interrupted" and _events(session)[-1] == "aborted"
        with pytest.raises(KeyboardInterrupt):  # heard again, and by who asks while it is handled
            try:
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(1)
            except KeyboardInterrupt:
                signal.raise_signal(signal.SIGTERM)
                with interruptible():
                    os.kill(os.getpid(), signal.SIGTERM)
                    time.sleep(1)
                raise AssertionError("not heard") from None


BAD = {
    "NaN": np.full((4, 4), np.nan),
    "infinite": np.diag([1.0, 1.0, np.inf, 1.0]),
    "zeros": np.zeros((4, 4)),
}


@pytest.mark.parametrize(
    ("pose", "reading"), [*((pose, "move") for pose in BAD), ("NaN", "pose"), ("zeros", "home")]
)
def test_a_pose_that_cannot_be_ends_the_run_and_blames_the_arm(
    session, bank, molded, pose, reading
):
    robot = robot_of(bank, molded[0])
    wrong = BAD[pose] if reading == "pose" else Moved(False, 0.0, BAD[pose])
    setattr(robot.arm, reading, lambda *given, **named: wrong)
    with robot, pytest.raises(ArmError, match=f"test arm: {reading}: the tool's pose"):
        mold(session, robot, bank)
    assert robot.arm.stops and _events(session)[-1] == "aborted"
    why = _summary(session)["why"]
    assert "the tool's pose" in why and "JSON" not in why and "written" not in why


@pytest.mark.parametrize("effort", [-50.0, -np.inf, np.nan])
def test_an_effort_that_cannot_be_ends_the_run(session, bank, molded, effort):
    robot = robot_of(bank, molded[0])
    robot.arm.posture = lambda name, **how: Moved(False, effort, robot.arm.at)
    with robot, pytest.raises(EffortLimit, match=f"test arm: posture: effort {effort:g} Nm"):
        mold(session, robot, bank)
    assert robot.arm.stops and _summary(session)["stop"] == "EffortLimit"


def test_an_arm_that_does_not_stop_at_the_end_is_said_to(session, bank, molded):
    robot = robot_of(bank, molded[0])
    robot.arm.stop = lambda: (_ for _ in ()).throw(OSError("no answer"))
    with robot:
        summary = mold(session, robot, bank)
    assert summary["stop"] == "CONVERGED" and "did not stop: OSError" in summary["why"]


def test_a_run_that_is_none_is_not_resumed(tmp_path, session, bank, molded):
    with pytest.raises(BadFile):
        Session.resume(tmp_path / "none", say=quiet)
    (session.run.folder / "goal.npy").unlink()
    with pytest.raises(BadFile, match="is not a run of `jshape mold`"):
        Session.resume(session.run.folder, say=quiet)


def test_a_run_whose_steps_are_done_says_so(session, bank, molded):
    with robot_of(bank, molded[0]) as robot:
        mold(session, robot, bank, max_steps=1, tolerance_mm=0.0)
    again = Session.resume(session.run.folder, say=quiet)
    with robot_of(bank, molded[0]) as robot, pytest.raises(JShapeError, match="all 1 actions"):
        mold(again, robot, bank, max_steps=1)


def _killed(folder, event):
    """A process that dies at an event; how many actions are on disk afterwards."""
    command = [sys.executable, "-m", "tests.stage", str(folder), str(event)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    return done.returncode


@pytest.mark.full
@pytest.mark.parametrize("event", [6, pytest.param(None, marks=pytest.mark.slow)])
def test_a_killed_process_leaves_a_run_that_goes_on(tmp_path, bank, molded, event):
    """Dead at one event, or (slow) at each of them; what was done by then is on disk."""
    events = [event] if event is not None else range(40)
    for number in events:
        folder = tmp_path / f"run{number}"
        code = _killed(folder, number)
        if code == 0:
            break
        assert code == 9
        steps = len(runs.Run.open(folder))
        # An action has six operations, and stands between "acting" and the look after it.
        written = len(journal.events(folder / journal.NAME)) if number else 0
        assert written == number and steps == max(0, (number - 3) // 9)
        resumed = Session.resume(folder, say=quiet)
        with robot_of(bank, molded[0]) as robot:
            summary = mold(resumed, robot, bank, max_steps=9)
        assert summary["stop"] in ("CONVERGED", "NO_IMPROVEMENT")
    else:
        assert event is not None  # the slow test saw the run end by itself


def test_what_an_action_touched_may_change(rng):
    before = 0.45 + 0.0001 * rng.standard_normal((395, 480)).astype(np.float32)
    touched = touched_by(PAPER_BOX, PlacedAction("knock", (240, 197), roi=(100, 80)))
    after = before.copy()
    after[touched] += 0.02
    check_still(before, after, touched)
    with pytest.raises(BedMoved, match="1.5 mm"):
        check_still(before, after + 0.0015, touched)


def test_a_batch_is_kept_action_by_action(session, bank, molded):
    """Steps have their own operations and frames, and every action of a batch is asked about."""
    asked = []
    with robot_of(bank, molded[0]) as robot:
        summary = mold(session, robot, bank, batch=3, confirm=lambda ahead: not asked.append(ahead))
    steps, acted = summary["steps"], robot.arm.acted
    assert [step["action"] for step in steps] == [name for name, *_ in acted]
    assert len(asked) == len(steps) > _events(session).count("looked") > 1
    for step in steps:
        assert [one["operation"] for one in step["operations"]] == list(NAMES)
    run = runs.Run.open(session.run.folder)
    frames = [run.depth(k) for k in range(len(run))]
    assert all((one != other).any() for one, other in zip(frames, frames[1:], strict=False))
