"""What every arm must obey, whoever built it: a new row of `ARMS` inherits these."""

import importlib.util
import os
import signal
import threading
import time

import numpy as np
import pytest

from jshape.camera import PAPER_BOX
from jshape.robot.arms.base import (
    Arm,
    ArmError,
    ArmLost,
    ArmSettings,
    Doing,
    EffortLimit,
    Moved,
    stop_arm,
)
from jshape.robot.arms.guarded import GuardedArm
from jshape.robot.arms.names import ARMS, open_arm
from jshape.robot.perform import perform
from jshape.robot.procedure import NAMES
from jshape.robot.procedure_file import load_hand
from jshape.robot.signals import SIGNALS

NEEDS = {"mujoco": ("mujoco", "mink")}


@pytest.fixture(params=ARMS)
def opened(request):
    for package in NEEDS.get(request.param, ()):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    address = ":3" if ARMS[request.param].address else ""
    opened = open_arm(request.param + address, ArmSettings(PAPER_BOX, say=lambda line: None))
    yield opened
    opened.arm.stop()
    opened.arm.close()
    if opened.depth_camera is not None:
        opened.depth_camera.close()


def _surface(opened):
    """A point of the bed near its middle, in the camera's frame."""
    if opened.depth_camera is None:
        return np.array([0.02, -0.01, 0.45])
    camera, counts = opened.depth_camera.camera, opened.depth_camera.frame()
    x, y = 0.02, -0.01
    u, v = (round(float(c)) for c in (x / 0.45 * camera.fx + camera.u0,
                                      y / 0.45 * camera.fy + camera.v0))  # fmt: skip
    around = counts[v - 3 : v + 4, u - 3 : u + 4]
    return np.array([x, y, float(np.median(around[around > 0])) * opened.depth_camera.depth_unit])


def _base(opened):
    return np.eye(4) if opened.base_camera is None else opened.base_camera


@pytest.mark.full
def test_an_arm_goes_where_it_is_told_and_says_so(opened):
    arm, hand, point = opened.arm, load_hand(), _surface(opened)
    assert isinstance(arm, Arm) and arm.name
    procedure = hand.procedures["poke"]
    pose = _base(opened) @ procedure.poses(hand.limits, point)[0][1][0]
    arm.begin(Doing("poke", "above", 1.0, 0.0), procedure.tool)
    moved = arm.move(pose, speed=0.25, threshold=40.0)
    assert isinstance(moved, Moved) and not moved.contact
    for reached in (moved.pose, arm.pose()):
        assert 1000 * np.linalg.norm(reached[:3, 3] - pose[:3, 3]) < 2.0
        assert np.degrees(np.arccos(np.clip(reached[2, :3] @ pose[2, :3], -1, 1))) < 1.0
    assert np.isfinite(moved.effort) and moved.effort >= 0


@pytest.mark.full
def test_an_action_is_six_operations_and_ends_at_home(opened):
    arm, done = opened.arm, []
    perform(arm, load_hand(), "poke", _surface(opened), _base(opened), on_operation=done.append)
    assert [one.operation for one in done] == list(NAMES)
    assert all(one.effort_nm >= 0 for one in done)
    camera_base = np.linalg.inv(_base(opened))
    above, act = (np.array(done[NAMES.index(name)].tool_mm) for name in ("above", "act"))
    assert act[2] > above[2] + 100  # into the bed
    arm.stop()
    arm.stop()  # as often as one likes
    assert np.isfinite(camera_base @ arm.pose()).all()


def test_an_action_that_is_none_is_refused(opened):
    with pytest.raises(ArmError, match="cannot stroke"):
        perform(opened.arm, load_hand(), "stroke", _surface(opened), _base(opened))


TURNED = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
"""Where the test's arm is."""


class Plain:
    """An arm that does as it is told; a test replaces a method."""

    name = "plain arm"

    def __init__(self, **methods):
        self.at, self.told, self.freed = TURNED, [], threading.Event()
        self.__dict__ |= methods

    def limit(self, *, effort, speed):
        self.told.append("limit")

    def check(self, poses, postures, tool):
        self.told.append("check")

    def begin(self, doing, tool):
        self.told.append("begin")

    def move(self, pose, *, speed, threshold):
        self.at = pose
        return Moved(False, 0.0, pose)

    def posture(self, name, *, seconds, threshold):
        return Moved(False, 0.0, self.at)

    def home(self):
        self.told.append("home")
        return Moved(False, 0.0, self.at)

    def pose(self):
        return self.at

    def stop(self):
        self.told.append("stop")

    def close(self):
        self.told.append("close")


CALLS = {
    "limit": lambda arm: arm.limit(effort=1.0, speed=0.1),
    "check": lambda arm: arm.check([TURNED], [], TURNED),
    "begin": lambda arm: arm.begin(Doing("poke", "above", 1.0, 0.0), TURNED),
    "move": lambda arm: arm.move(TURNED, speed=1e3, threshold=1.0),
    "posture": lambda arm: arm.posture("fist", seconds=0.001, threshold=1.0),
    "home": lambda arm: arm.home(),
    "pose": lambda arm: arm.pose(),
}


@pytest.fixture
def hung():
    """What never returns, until the test ends."""
    end = threading.Event()
    yield lambda *given, **named: end.wait(30)
    end.set()


def fast(arm, **more):
    """Guarded, with waits that a test can afford."""
    waits = {"floor": 0.05, "stopping": 0.1, "closing": 0.05, "homing": 0.0}
    guard = GuardedArm(arm)
    vars(guard).update(waits | more)
    return guard


@pytest.mark.parametrize("call", CALLS)
def test_a_call_that_hangs_is_given_up_and_the_arm_is_stopped(call, hung):
    arm = Plain(**{call: hung})
    guard, began = fast(arm), time.monotonic()
    with pytest.raises(ArmLost, match=f"plain arm: {call} has not ended after 0.0.* told to stop"):
        CALLS[call](guard)
    assert stop_arm(guard) is None and time.monotonic() - began < 1
    assert "stop" in arm.told
    with pytest.raises(ArmLost, match=f"{call} has not ended"):  # nothing is told behind it
        guard.limit(effort=1.0, speed=1.0)
    assert "limit" not in arm.told or call == "limit"


def test_a_deadline_is_longer_for_a_long_way_at_a_low_speed():
    """0.2 m at 0.5 m/s may take 1.6 s and the floor, at 1,000 m/s not even 0.2 s."""

    def move(pose, *, speed, threshold):
        time.sleep(0.2)
        return Moved(False, 0.0, pose)

    there = TURNED.copy()
    there[0, 3] += 0.2
    guard = fast(Plain(move=move))
    guard.home()
    assert guard.move(there, speed=0.5, threshold=1.0).pose[0, 3] == there[0, 3]
    with pytest.raises(ArmLost, match="move has not ended after 0.05"):
        guard.move(TURNED, speed=1e3, threshold=1.0)
    slow = Plain(move=move)
    slow.slowness = 20.0
    guard = fast(slow)
    guard.home()
    guard.move(there, speed=1e3, threshold=1.0)


def test_stop_returns_at_once_whatever_the_arm_does(hung):
    """Before, during and after a motion, as often as one likes, with a `stop` that hangs."""
    arm = Plain(move=hung, stop=hung)
    guard, ended = fast(arm, floor=20.0), []

    def mover():
        with pytest.raises(ArmError, match="plain arm: stopped by a person"):
            CALLS["move"](guard)
        ended.append(time.monotonic())

    thread = threading.Thread(target=mover)
    thread.start()
    while guard._worker.busy is None:
        time.sleep(0.001)
    began = time.monotonic()
    for _ in range(20):
        guard.interrupt()
    assert time.monotonic() - began < 0.05 and guard.trouble is None
    thread.join(1.0)
    assert ended and ended[0] - began < 0.1  # whoever waited for the motion goes on
    with pytest.raises(ArmError, match="stopped by a person"):
        guard.home()
    assert "did not stop: no answer for" in stop_arm(guard)
    assert time.monotonic() - began < 0.5
    fresh = fast(Plain())
    fresh.interrupt()  # before the first call
    with pytest.raises(ArmError, match="stopped by a person"):
        fresh.home()
    fresh.allow()
    assert fresh.home().contact is False and fresh.trouble is None


def test_a_stop_that_came_before_the_motion_is_repeated():
    """A command that was on its way to the arm as somebody pressed STOP moves it after `stop`."""
    entered, told = threading.Event(), []

    def move(pose, **how):
        entered.set()
        time.sleep(0.05)  # the stop is told; only then the arm begins to move
        told.append("moves")
        until = time.monotonic() + 5
        while told[-1] != "stop" and time.monotonic() < until:
            time.sleep(0.001)
        raise ArmError("stopped")

    guard = fast(Plain(move=move, stop=lambda: told.append("stop")), floor=20.0)
    thread = threading.Thread(target=lambda: pytest.raises(ArmError, CALLS["move"], guard))
    thread.start()
    entered.wait(5)
    guard.interrupt()
    thread.join(5)
    until = time.monotonic() + 5
    while guard._worker.busy is not None and time.monotonic() < until:
        time.sleep(0.001)
    assert told[:3] == ["stop", "moves", "stop"]


def test_what_waits_behind_a_call_that_hangs_is_never_told():
    """A motion that nobody waits for any more must not begin later."""
    arm, end = Plain(), threading.Event()
    arm.pose = lambda: end.wait(30) and TURNED
    guard = fast(arm)
    for call in ("pose", "home"):
        with pytest.raises(ArmLost, match="pose has not ended"):
            CALLS[call](guard)
    end.set()
    guard.close()
    assert "home" not in arm.told and arm.told[-1] == "close"


def test_a_close_that_hangs_does_not_keep_the_program(hung):
    with pytest.raises(ArmLost, match="close has not ended after 0.05 s"):
        fast(Plain(close=hung)).close()
    assert all(one.daemon for one in threading.enumerate() if one.name in ("plain arm", "stop"))


@pytest.mark.parametrize("number", SIGNALS)
def test_a_second_interruption_does_not_cut_a_stop_short(number):
    ended = []

    def stop():
        time.sleep(0.1)
        ended.append(True)

    arm = Plain(stop=stop)
    for guard in (GuardedArm(arm), arm):  # the arm itself likewise
        before = signal.signal(number, signal.default_int_handler)
        try:
            timer = threading.Timer(0.03, os.kill, (os.getpid(), number))
            timer.start()
            assert stop_arm(guard) is None and ended.pop()
            timer.join()
            with pytest.raises(KeyboardInterrupt):  # and is heard again afterwards
                os.kill(os.getpid(), number)
                time.sleep(1)
        finally:
            signal.signal(number, before)


def test_ctrl_c_tells_the_arm_to_stop_while_its_motion_hangs(hung):
    arm = Plain(home=hung)
    guard = GuardedArm(arm)
    timer = threading.Timer(0.05, signal.raise_signal, (signal.SIGINT,))
    # What a shell starts in the background ignores Ctrl-C from its birth.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            timer.start()
            guard.home()
    finally:
        signal.signal(signal.SIGINT, before)
    assert stop_arm(guard) is None and "stop" in arm.told and time.monotonic() - began < 1


NONE = np.eye(4)
WRONG = {
    "nothing": (None, ArmError, "returned None; expected Moved"),
    "a pair": ((False, 0.0), ArmError, "expected Moved"),
    "negative": ((False, -50.0, NONE), EffortLimit, "effort -50 Nm; it is a magnitude"),
    "-inf": ((False, -np.inf, NONE), EffortLimit, "effort -inf Nm"),
    "inf": ((False, np.inf, NONE), EffortLimit, "effort inf Nm"),
    "NaN": ((False, np.float32("nan"), NONE), EffortLimit, "effort nan Nm"),
    "a text": ((False, "3", NONE), EffortLimit, "effort '3' Nm"),
    "six joints": ((False, np.zeros(6), NONE), EffortLimit, "effort array"),
    "contact": (("no", 0.0, NONE), ArmError, "contact is 'no'; it is True or False"),
    "zeros": ((False, 0.0, np.zeros((4, 4))), ArmError, "the last row is"),
    "no numbers": ((False, 0.0, np.full((4, 4), np.nan)), ArmError, "holds NaN or infinity"),
    "infinite": ((False, 0.0, np.diag([1, 1, np.inf, 1])), ArmError, "holds NaN or infinity"),
    "sheared": ((False, 0.0, np.diag([1, 1, 1.01, 1])), ArmError, "is not rigid"),
    "mirrored": ((False, 0.0, np.diag([1.0, 1, -1, 1])), ArmError, "det R is -1"),
    "3x4": ((False, 0.0, np.eye(4)[:3]), ArmError, "has shape \\(3, 4\\)"),
    "a list of texts": ((False, 0.0, [["x"]]), ArmError, "no array of numbers"),
    "millimetres": ((False, 0.0, NONE + 450 * np.eye(4, k=3)), ArmError, "are these mm"),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("call", ["move", "posture", "home"])
def test_what_an_arm_cannot_have_done_is_refused(wrong, call):
    value, error, said = WRONG[wrong]
    guard = fast(Plain(**{call: lambda *given, **named: value}), floor=5.0)
    with pytest.raises(error, match=f"^plain arm: {call}.*{said}"):
        CALLS[call](guard)


def test_readings_are_checked_where_they_come_in():
    with pytest.raises(ArmError, match="plain arm: pose: the tool's pose: the last row"):
        fast(Plain(pose=lambda: np.zeros((4, 4)))).pose()
    felt = Moved(False, np.float32(2.5), NONE.astype(np.float32))
    guard = fast(Plain(posture=lambda *given, **named: felt, pose=lambda: felt.pose))
    moved = guard.posture("fist", seconds=0.001, threshold=9.0)
    assert moved.effort == 2.5 and moved.pose.dtype == guard.pose().dtype == np.float64
    with pytest.raises(ArmError, match="Nothing: an arm has .*stop"):
        GuardedArm(type("Nothing", (), {})())
    forgot = type("Forgot", (Arm,), {n: getattr(Plain, n) for n in vars(Arm) if n in CALLS})
    with pytest.raises(ArmError, match="Forgot: an arm has stop, close; this has none"):
        GuardedArm(forgot())  # the protocol's own do nothing
    with pytest.raises(ArmError, match="plain arm: pose: OSError: \\[Errno 5\\] lost"):
        fast(Plain(pose=lambda: (_ for _ in ()).throw(OSError(5, "lost")))).pose()


def test_a_pose_that_stays_the_same_while_the_tool_moves_is_noticed():
    there = TURNED.copy()
    there[0, 3] += 0.1
    guard = fast(Plain(move=lambda pose, **how: Moved(False, 0.0, TURNED)), floor=5.0)
    guard.home()
    with pytest.raises(ArmError, match="same to 0.01 mm after a way of 100 mm without contact"):
        guard.move(there, speed=1.0, threshold=1.0)
    far = TURNED.copy()
    far[1, 3] += 2.0
    guard = fast(Plain(move=lambda pose, **how: Moved(False, 0.0, far)), floor=5.0)
    guard.home()
    with pytest.raises(ArmError, match="2002 mm from where it was to go, after a way of 100 mm"):
        guard.move(there, speed=1.0, threshold=1.0)
    touched = fast(Plain(move=lambda pose, **how: Moved(True, 9.0, TURNED)), floor=5.0)
    touched.home()
    assert touched.move(there, speed=1.0, threshold=1.0).contact  # it may stand at once
