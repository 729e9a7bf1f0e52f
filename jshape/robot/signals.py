"""Signals that end a program, and what they must not cut short."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
]
"""Ctrl-C, `kill`, a closed terminal, Ctrl-\\."""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore `SIGNALS` in the block, which ends something already.

    A second Ctrl-C must not keep an arm from being stopped, nor a run from being written down.
    The block must be short: nothing but SIGKILL ends it.
    """
    before: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():  # others are not interrupted
            for number in SIGNALS:
                if (handler := signal.getsignal(number)) is not None:  # None: not Python's
                    before[number] = handler
                    signal.signal(number, lambda number, frame: None)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
