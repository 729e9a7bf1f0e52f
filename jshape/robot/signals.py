"""Signals that end a program, and what they must not cut short."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
]
"""Ctrl-C, `kill`, a closed terminal, Ctrl-\\."""


@contextmanager
def interruptible() -> Iterator[None]:
    """`SIGNALS` raise KeyboardInterrupt in the block, but not while one that it raised is handled.

    Whatever handles the first (an arm to stop, a run to write down, a person to tell) must not be
    left half done because a second arrives between two of its lines.  All of it must be short.
    """
    handled = sys.exception()  # by whoever entered the block

    def interrupt(number: int, frame: Any) -> None:
        now = sys.exception()
        while now is not None and now is not handled:
            if isinstance(now, KeyboardInterrupt):
                return
            now = now.__context__
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore `SIGNALS` in the block, which ends something already.

    A second Ctrl-C must not keep an arm from being stopped, nor a run from being written down.
    The block must be short: nothing but SIGKILL ends it.
    """
    with _handled_by(lambda number, frame: None):
        yield


@contextmanager
def _handled_by(handler: Callable[[int, Any], None]) -> Iterator[None]:
    before: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():  # others are not interrupted
            for number in SIGNALS:
                if (kept := signal.getsignal(number)) is not None:  # None: not Python's
                    before[number] = kept
                    signal.signal(number, handler)
        yield
    finally:
        for number, kept in before.items():
            signal.signal(number, kept)
