"""How things end: what has to be let go of, and what must not be cut short."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, TypeVar

_Self = TypeVar("_Self", bound="Closing")


class Closing:
    """A context manager by its `close`."""

    def close(self) -> None:
        """Let go of what it holds; a second time does nothing."""
        raise NotImplementedError

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
]
"""What ends a program: Ctrl-C, `kill`, a closed terminal, Ctrl-\\."""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """What ends a program is not heard in the block: it ends something already.

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
