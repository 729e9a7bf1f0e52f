"""A thread that makes calls to a device, and a caller that need not wait until they end.

A driver's call cannot be ended from outside.  So it is made on a thread of its own, and the caller
gives up on it: after a deadline, at Ctrl-C, or when somebody presses STOP.  The threads are
daemons, since a program must be able to end while a driver hangs.
"""

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from jshape.errors import JShapeError, one_line

SLICE = 0.1
"""Seconds within which Ctrl-C is heard by whoever waits."""


class Call:
    """A call that somebody waits for."""

    def __init__(self, what: str, function: Callable[[], Any] = lambda: None):
        """Made by `Worker.begin`; `what` names it in errors."""
        self.what = what
        self._function = function
        self._lock = threading.Lock()
        self._settled = threading.Event()
        self._result: Any = None
        self._problem: BaseException | None = None

    def run(self) -> None:
        """Make it, unless whoever waited has given up by now: what nobody waits for never begins.

        A call that is given up meanwhile ends unheard.
        """
        if self._settled.is_set():
            return
        try:
            result = self._function()
        except BaseException as problem:  # the caller's: it is raised there
            self.settle(problem=problem)
        else:
            self.settle(result)

    def settle(self, result: Any = None, problem: BaseException | None = None) -> bool:
        """Say how it ended, the first time only; whether this was the first time."""
        with self._lock:
            if self._settled.is_set():
                return False
            self._result, self._problem = result, problem
            self._settled.set()
            return True

    def wait(self, seconds: float) -> bool:
        """Wait at most so long; whether it has ended.

        In slices: on Windows Ctrl-C does not end a wait, nor anywhere a signal that another thread
        was given.
        """
        until = time.monotonic() + seconds
        while not self._settled.wait(min(max(until - time.monotonic(), 0.0), SLICE)):
            if time.monotonic() >= until:
                return False
        return True

    @property
    def problem(self) -> BaseException | None:
        """What it raised, if it has ended so."""
        return self._problem

    def result(self, name: str, error: type[JShapeError]) -> Any:
        """What it returned, once it has ended.

        Args:
          name: of the device, for its errors.
          error: what a driver raises becomes one of these.

        Raises:
          JShapeError: what the call raised.
        """
        problem = self._problem
        if isinstance(problem, Exception) and not isinstance(problem, JShapeError):
            said = f"{name}: {self.what}: {type(problem).__name__}: {one_line(problem)}"
            raise error(said) from problem
        if problem is not None:
            raise problem
        return self._result


class Worker:
    """One thread, from the first call on: drivers and renderers may belong to one."""

    def __init__(self, name: str):
        """A thread of that name; it starts with the first call."""
        self._name = name
        self._calls: SimpleQueue[Call | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self.busy: str | None = None
        """What it is doing, which may be a call that nobody waits for any more."""

    def begin(self, what: str, function: Callable[[], Any]) -> Call:
        """Make a call once those before it have ended."""
        call = Call(what, function)
        self._calls.put(call)
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        return call

    def end(self) -> None:
        """Let the thread end after the calls so far; one more begins another thread."""
        if self._thread is not None:
            self._calls.put(None)
            self._thread = None

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            self.busy = call.what
            call.run()
            self.busy = None
            del call  # or it would keep what it returned until the next
