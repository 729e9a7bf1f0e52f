"""The one way to an arm: nobody waits for it for ever, and what it says is checked.

Every call is made on the arm's own thread and has a deadline.  A call that is overdue, Ctrl-C and
STOP make the caller go on at once, and the arm is told to stop from another thread.
"""

import threading
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from jshape.errors import JShapeError, one_line, quoted
from jshape.robot.arms.base import Arm, ArmError, ArmLost, Doing, EffortLimit, Moved
from jshape.robot.rigid import Pose, check_rigid
from jshape.robot.signals import uninterrupted
from jshape.robot.worker import Call, Worker

SLACK = 4.0
"""A motion is given so many times its way over its speed, besides.  The smoothest one takes 1.875
times that (least jerk), and people run controllers at half speed."""
AGAIN = 0.25
"""Seconds after which `stop` is repeated while a command that nobody waits for is under way: it may
have reached the arm after `stop` did."""
STUCK = 0.02
"""Metres that the tool was to go, from which on a pose that stays the same is not its."""
ASTRAY = 0.25
"""Metres that the tool may be farther from where it was to go than where it set out."""


class GuardedArm:
    """An arm behind deadlines and checks; implements `Arm`."""

    floor = 20.0
    """Seconds that every call is given: a controller that releases its brakes, reconnects or solves
    the inverse kinematics of a line takes some, and a person notices a robot that stands longer."""
    homing = 4.0
    """Metres that the way home is taken for: up, and over the reach of a large arm."""
    stopping = 2.0
    """Seconds that anybody waits for an arm's `stop`: stop category 1 (IEC 60204-1) takes less than
    one."""
    closing = 5.0
    """Seconds that anybody waits for an arm's `close`."""

    def __init__(self, arm: Any):
        """Guard an arm, which nobody else may call from now on.

        An arm that has a `slowness` is given so many times as long: simulations compile, and are
        slower than the clock.

        Raises:
          ArmError: it lacks a method.
        """
        missing = [
            name
            for name, stub in vars(Arm).items()
            if not name.startswith("_")
            and (not callable(getattr(arm, name, None)) or getattr(type(arm), name, None) is stub)
        ]
        if missing:
            raise ArmError(f"{type(arm).__name__}: an arm has {', '.join(missing)}; this has none")
        self.arm: Arm = arm
        self.name = one_line(getattr(arm, "name", type(arm).__name__))
        self._slowness = float(getattr(arm, "slowness", 1.0))
        self._worker = Worker(self.name, ArmError, ArmLost)
        self._lock = threading.Lock()
        self._call: Call | None = None  # the last command
        self._stop: Call | None = None  # the last `stop`
        self._stopper: threading.Thread | None = None
        self._stopped_at = 0.0
        self._interrupted = False
        self._fastest = 0.25  # m/s, until `limit` says
        self._at: np.ndarray | None = None  # (3,) of the tool, as it said last

    def interrupt(self) -> None:
        """STOP: the arm is told to stop, and every command is refused until `allow`.

        From any thread, as often as one likes, before, during, between and after motions.  Returns
        within milliseconds, whatever the arm does: `trouble` says later what went wrong.
        """
        with self._lock:
            self._interrupted = True
            call = self._call
        self._begin_stop()
        if call is not None:
            call.settle(problem=self._refusal())  # whoever waits for the motion goes on

    def allow(self) -> None:
        """Take commands again: a new run begins."""
        with self._lock:
            self._interrupted = False

    @property
    def _wait(self) -> float:
        return self.stopping * self._slowness

    @property
    def trouble(self) -> str | None:
        """What went wrong with the last `stop`, in one line; None: nothing so far."""
        call, waited = self._stop, time.monotonic() - self._stopped_at
        if call is None:
            return None
        if not call.wait(0.0):
            why = f"no answer for {waited:.0f} s: use its own switch"
            return f"{self.name}: did not stop: {why}" if waited >= self._wait else None
        if (problem := call.exception(0)) is None:
            return None
        return f"{self.name}: did not stop: {type(problem).__name__}: {one_line(problem)}"

    def limit(self, *, effort: float, speed: float) -> None:
        """As the arm's."""
        self._fastest = speed
        self._made("limit", 0.0, effort=effort, speed=speed)

    def check(self, poses: Sequence[Pose], postures: Sequence[str], tool: Pose) -> None:
        """As the arm's."""
        self._made("check", 0.0, poses, postures, tool)

    def begin(self, doing: Doing, tool: Pose) -> None:
        """As the arm's."""
        self._made("begin", 0.0, doing, tool)

    def move(self, pose: Pose, *, speed: float, threshold: float) -> Moved:
        """As the arm's, within `floor` and `SLACK` times the way over the speed."""
        start, target = self._at, pose[:3, 3].copy()
        way = self.homing if start is None else float(np.linalg.norm(target - start))
        moved = self._moved("move", way / speed, pose, speed=speed, threshold=threshold)
        if start is not None:
            self._check_way(start, target, moved)
        return moved

    def posture(self, name: str, *, seconds: float, threshold: float) -> Moved:
        """As the arm's, within `floor` and `SLACK` times the seconds that it takes."""
        return self._moved("posture", seconds, name, seconds=seconds, threshold=threshold)

    def home(self) -> Moved:
        """As the arm's, within `floor` and `SLACK` times `homing` over the fastest speed."""
        return self._moved("home", self.homing / self._fastest)

    def pose(self) -> Pose:
        """As the arm's."""
        return self._pose("pose", self._made("pose", 0.0))

    def stop(self) -> None:
        """Tell the arm to stop, and wait for at most `stopping` seconds, Ctrl-C or not.

        Raises:
          ArmError: it did not, or has not answered by then.
        """
        with uninterrupted():
            call = self._begin_stop()
            call.wait(max(self._stopped_at + self._wait - time.monotonic(), 0.0))
        if self.trouble is not None:
            raise ArmError(self.trouble)

    def close(self) -> None:
        """Let go of the arm; ArmLost if that takes longer than `closing`, ArmError if it raises."""
        self._worker.close(self.closing, self.arm.close)

    def _made(self, what: str, seconds: float, /, *given: Any, **named: Any) -> Any:
        """What a method of the arm returned; `seconds` that a motion takes at full speed.

        Raises:
          ArmLost: it is overdue; the arm was told to stop.
          ArmError: it was stopped by a person, or raised something.
        """
        function = partial(getattr(self.arm, what), *given, **named)
        with self._lock:
            if self._interrupted:
                raise self._refusal()
            self._call = call = self._worker.begin(what, function)
        deadline = self._slowness * (self.floor + SLACK * seconds)
        try:
            if not call.wait(deadline):
                overdue = ArmLost(
                    f"{self.name}: {self._worker.busy or what} has not ended after {deadline:.3g} s"
                    f" ({self.floor:g} s and {SLACK:g} times the {seconds:.3g} s that it should "
                    f"take{f', times {self._slowness:g}' if self._slowness != 1 else ''}); "
                    "it was told to stop"
                )
                if call.settle(problem=overdue):
                    self._begin_stop()
        except BaseException:  # Ctrl-C
            call.settle(problem=self._refusal())
            self._begin_stop()
            raise
        return self._worker.value(call)

    def _refusal(self) -> ArmError:
        return ArmError(f"{self.name}: stopped by a person")

    def _begin_stop(self) -> Call:
        """The arm's `stop`, which is under way; one that has not ended is not begun again."""
        with self._lock:
            if self._stop is None or self._stopper is None or not self._stopper.is_alive():
                self._stop, self._stopped_at = Call("stop", self.arm.stop), time.monotonic()
                self._stopper = threading.Thread(
                    target=self._stand_still, args=(self._stop,), name="stop", daemon=True
                )
                self._stopper.start()
            return self._stop

    def _stand_still(self, call: Call) -> None:
        call.run()
        until = time.monotonic() + self._wait
        while self._worker.busy is not None and time.monotonic() < until:
            time.sleep(min(AGAIN, self._wait))
            if self._worker.busy is not None:
                Call("stop", self.arm.stop).run()

    def _moved(self, what: str, seconds: float, /, *given: Any, **named: Any) -> Moved:
        """How a motion ended; ArmError, EffortLimit: it cannot have ended so.  See `_made`."""
        value = self._made(what, seconds, *given, **named)
        if not isinstance(value, tuple) or len(value) != 3:
            expected = "expected Moved(contact, effort, pose)"
            raise ArmError(f"{self.name}: {what} returned {quoted(value)}; {expected}")
        contact, effort, pose = value
        if not isinstance(contact, bool | np.bool_):
            said = f"contact is {quoted(contact)}; it is True or False"
            raise ArmError(f"{self.name}: {what}: {said}")
        number = np.ndim(effort) == 0 and np.asarray(effort).dtype.kind in "iuf"
        if not number or not 0 <= float(effort) < np.inf:  # no limit would hold
            came = f"{float(effort):g}" if number else quoted(effort)
            raise EffortLimit(
                f"{self.name}: {what}: effort {came} Nm; it is a magnitude, |joint torque - what "
                "gravity needs|: a finite number from 0"
            )
        return Moved(bool(contact), float(effort), self._pose(what, pose))

    def _pose(self, what: str, value: Any) -> Pose:
        """A pose of the tool, metres; ArmError: it is none."""
        try:
            pose = check_rigid(value, f"{self.name}: {what}: the tool's pose")
        except JShapeError as problem:
            raise ArmError(str(problem)) from None
        self._at = pose[:3, 3].copy()
        return pose

    def _check_way(self, start: np.ndarray, target: np.ndarray, moved: Moved) -> None:
        """ArmError where the arm says the same pose as before a motion, or one far off the way."""
        way, at = float(np.linalg.norm(target - start)), moved.pose[:3, 3]
        if not moved.contact and way > STUCK and np.abs(at - start).max() < 1e-5:
            raise ArmError(
                f"{self.name}: move: the tool's pose is the same to 0.01 mm after a way of "
                f"{1000 * way:.0f} mm without contact: the reading is frozen, or the arm stood"
            )
        off = float(np.linalg.norm(at - target))
        if off > way + ASTRAY:
            raise ArmError(
                f"{self.name}: move: the tool is said to be {1000 * off:.0f} mm from where it was "
                f"to go, after a way of {1000 * way:.0f} mm; at most {1000 * ASTRAY:.0f} mm more "
                "than that: is it in metres, in the base frame?"
            )
