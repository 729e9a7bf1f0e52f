"""A plan in the making: since when, whether it compiles, and a way to give it up."""

import threading
import time
from collections.abc import Callable
from typing import Any

from jshape import compiling
from jshape.errors import JShapeError
from jshape.planning.plan import Plan


class GivenUp(JShapeError):
    """A person did not want to wait for the plan."""


class Search:
    """One call of `jshape.plan`, in a thread of its own.

    XLA cannot be stopped while it compiles.  Who gives a search up is free at once; what is being
    compiled then is finished out of sight, and kept for the next plan.
    """

    def __init__(self, make: Callable[[], Plan]):
        """Start it; `make` makes the plan."""
        compiling.listen()
        self._make = make
        self._began = time.monotonic()
        self._found: Plan | Exception | None = None
        self._ended = threading.Event()  # found, or given up
        self._given_up = False
        threading.Thread(target=self._run, name="planning").start()

    def _run(self) -> None:
        found: Any = None
        try:
            found = self._make()
        except Exception as problem:  # told to whoever waits
            found = problem
        self._found = found
        self._ended.set()

    def give_up(self) -> None:
        """Whoever waits for the plan gets none."""
        self._given_up = True
        self._ended.set()

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
          GivenUp: a person gave it up.
          JShapeError: as for `jshape.plan`.
        """
        self._ended.wait()
        if self._given_up:
            raise GivenUp("no plan: you gave it up")
        if isinstance(self._found, Exception):
            raise self._found
        assert self._found is not None
        return self._found
