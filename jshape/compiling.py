"""Whether JAX is compiling, and since when: what people wait for the first time, and only then.

JAX tells its listeners what it traced, lowered and compiled, each when that is done; between two
of these it is at the next.  Compiled code is kept (see `devices.remember_compiled`).
"""

import time
from collections.abc import Callable

import jax

GAP = 1.0
"""Seconds: what is compiled so soon after another is part of the same wait."""
MOST = 15.0
"""Seconds from a trace to what follows it, at most; after some traces nothing does."""


class _Wait:
    """What is known of the wait; of the whole process, as JAX's listeners are."""

    began = over = 0.0
    """When it began and, unless JAX says more, when it is over; on the monotonic clock."""

    def __init__(self) -> None:
        self.callbacks: list[Callable[[], None]] = []

    def note(self, event: str, duration_secs: float, **kwargs: object) -> None:
        """Take what JAX tells, in the thread that compiles."""
        if not event.startswith("/jax/core/compile/"):
            return
        now = time.monotonic()
        if now - duration_secs - self.over > GAP:
            self.began = now - duration_secs
        compiled = event.endswith("backend_compile_duration")
        traced = event.endswith("trace_duration")
        self.over = now if compiled else now + MOST if traced else float("inf")
        if compiled:
            for call in self.callbacks:
                call()


_wait: _Wait | None = None


def listen(callback: Callable[[], None] | None = None) -> None:
    """Begin to notice what is compiled.

    Args:
      callback: called each time that something was compiled, in the thread that did it.
    """
    global _wait
    if _wait is None:
        _wait = _Wait()
        jax.monitoring.register_event_duration_secs_listener(_wait.note)
    if callback is not None:
        _wait.callbacks.append(callback)


def seconds() -> float | None:
    """How long people have been waiting for the compiler; None while it does nothing.

    Any thread may ask, as often as it likes, once `listen` was called.
    """
    now = time.monotonic()
    return now - _wait.began if _wait is not None and now < _wait.over else None
