"""A thread that makes calls to a device, and a caller that need not wait until they end.

A driver's call cannot be ended from outside.  So it is made on a thread of its own, and the caller
gives up on it: after a deadline, at Ctrl-C, or when somebody presses STOP.  The threads are
daemons, since a program must be able to end while a driver hangs.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, wait
from queue import SimpleQueue
from typing import Any

from jshape.errors import JShapeError, one_line

SLICE = 0.1
"""Seconds within which Ctrl-C is heard by whoever waits."""


class Call(Future):
    """A call that somebody waits for."""

    def __init__(self, what: str, function: Callable[[], Any]):
        """Made by `Worker.begin`; `what` names it in errors."""
        super().__init__()
        self.what, self._function = what, function

    def run(self) -> None:
        """Make it, unless whoever waited has given up by now: what nobody waits for never begins.

        A call that is given up meanwhile ends unheard.
        """
        if self.done():
            return
        try:
            result = self._function()
        except BaseException as problem:  # the caller's: it is raised there
            self.settle(problem=problem)
        else:
            self.settle(result)

    def settle(self, result: Any = None, problem: BaseException | None = None) -> bool:
        """Say how it ended, the first time only; whether this was the first time."""
        try:
            self.set_result(result) if problem is None else self.set_exception(problem)
        except InvalidStateError:
            return False
        return True

    def wait(self, seconds: float) -> bool:
        """Wait at most so long; whether it has ended.

        In slices: on Windows Ctrl-C does not end a wait, nor anywhere a signal that another thread
        was given.
        """
        until = time.monotonic() + seconds
        while not self.done() and (left := until - time.monotonic()) > 0:
            wait([self], min(left, SLICE))
        return self.done()


class Worker:
    """One thread, from the first call on: drivers and renderers may belong to one."""

    def __init__(self, name: str, error: type[JShapeError], lost: type[JShapeError]):
        """A thread for the driver of a name; it starts with the first call.

        `error` is what the driver's own errors become, `lost` that a call has not ended in time.
        """
        self._name, self._error, self._lost = name, error, lost
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

    def value(self, call: Call) -> Any:
        """What a call returned that has ended; raises what it raised, a driver's own as `error`."""
        problem = call.exception(0)
        if isinstance(problem, Exception) and not isinstance(problem, JShapeError):
            said = f"{self._name}: {call.what}: {type(problem).__name__}: {one_line(problem)}"
            raise self._error(said) from problem
        return call.result(0)

    def within(self, seconds: float, what: str, function: Callable[[], Any]) -> Any:
        """What a call returned; `lost`: it has not ended by then.  See `value`."""
        call = self.begin(what, function)
        try:
            call.wait(seconds)
        finally:  # Ctrl-C too: nobody waits for it any more
            overdue = f"{self._name}: {what} has not ended after {seconds:g} s"
            call.settle(problem=self._lost(overdue))
        return self.value(call)

    def close(self, seconds: float, function: Callable[[], Any]) -> None:
        """Make the last call, beside one that hangs, and let the threads end.  See `within`."""
        idle = self.busy is None
        worker = self if idle else Worker(self._name, self._error, self._lost)
        try:
            worker.within(seconds, "close", function)
        finally:
            for one in {worker, self}:
                if one._thread is not None:
                    one._calls.put(None)
                    one._thread = None

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            self.busy = call.what
            call.run()
            self.busy = None
            del call  # or it would keep what it returned until the next
