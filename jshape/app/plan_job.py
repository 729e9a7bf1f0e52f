"""A plan that is being made: since when, whether it compiles, and a way to cancel it."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import suppress
from functools import partial

from jshape import compiling
from jshape.errors import JShapeError
from jshape.planning.plan import Plan


class PlanJob:
    """One call of `jshape.plan`, in a thread of its own.

    XLA cannot be stopped while it compiles.  Who cancels is free at once; what is being compiled
    then is finished out of sight, and kept for the next plan.
    """

    def __init__(self, make: Callable[[], Plan]):
        """Start it; `make` makes the plan."""
        compiling.listen()
        self._began = time.monotonic()
        self._found: Future[Plan] = Future()
        threading.Thread(target=self._run, args=[make], name="planning").start()

    def _run(self, make: Callable[[], Plan]) -> None:
        try:
            end = partial(self._found.set_result, make())
        except Exception as problem:  # told to whoever waits
            end = partial(self._found.set_exception, problem)
        with suppress(InvalidStateError):  # it was cancelled
            end()

    def cancel(self) -> None:
        """Whoever waits for the plan gets none."""
        self._found.cancel()

    @property
    def said(self) -> str:
        """What it does and since when, in words."""
        compiled = compiling.seconds()
        if compiled is not None:
            return f"compiling, first time only: {compiled:.0f} s"
        return f"planning: {time.monotonic() - self._began:.0f} s"

    def result(self) -> Plan:
        """The plan, once there is one.

        Raises:
          JShapeError: as for `jshape.plan`, or it was cancelled.
        """
        try:
            return self._found.result()
        except CancelledError:
            raise JShapeError("no plan: you cancelled it") from None
