"""What commands print for people: colours, tables, and progress on long work."""

import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")

CODES = {"error": "1;31", "warning": "33", "good": "32", "head": "1", "quiet": "2"}
"""What is coloured, and how a terminal is told (ANSI)."""


def coloured(text: str, what: str, stream: Any = None) -> str:
    """A text as one of `CODES`, if whoever reads the stream (None: stdout) sees colours."""
    return f"\033[{CODES[what]}m{text}\033[0m" if shows_colours(stream or sys.stdout) else text


def shows_colours(stream: Any) -> bool:
    """Whether a stream is a terminal that shows colours, and nobody said no (no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    try:
        return stream.isatty()
    except (AttributeError, ValueError):  # closed, or not even a stream
        return False


def print_table(head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> None:
    """Print columns under a head, as wide as they need."""
    lines = [head, *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for number, line in enumerate(lines):
        text = "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        print(text if number else coloured(text, "head"))


def warn(line: str) -> None:
    """Print what to be careful with, beside the results."""
    print(f"{coloured('warning:', 'warning')} {line}")


@contextmanager
def bar(what: str, total: int | None = None, done: int = 0) -> Iterator[Callable[..., None]]:
    """A progress bar on stderr; nothing where that is no terminal.

    Yields:
      What it is told by: `completed`, `total`, `said` (behind it).
    """
    from rich.console import Console  # not above: the extra may be missing, which `main` says
    from rich.progress import Progress, TextColumn

    columns = (*Progress.get_default_columns(), TextColumn("{task.fields[said]}"))
    console = Console(stderr=True)
    quiet = not sys.stderr.isatty()
    # Drawn when it is told of something: `waiting` speaks in between.
    off: dict[str, Any] = dict.fromkeys(
        ("auto_refresh", "redirect_stdout", "redirect_stderr"), False
    )
    with Progress(*columns, console=console, transient=True, disable=quiet, **off) as shown:
        task = shown.add_task(what, total=total, completed=done, said="")
        yield partial(shown.update, task, refresh=True)


def progress(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """The items, with a progress bar for those that come."""
    with bar(what, total or None) as tell:
        for done, item in enumerate(items, 1):
            yield item
            tell(completed=done)


def write_pictures(folder: Path, pictures: Any) -> list[str]:
    """Write what `viz.style.drawn` can draw of pictures into a folder; returns their names."""
    from jshape.io.files import write_atomic
    from jshape.viz.style import drawn

    made = drawn(pictures)
    for name, content in made.items():
        write_atomic(folder / name, content)
    return list(made)


say: Callable[[str], None] = partial(print, flush=True)
"""Print a line of what goes on."""

COMPILING = 1.0
"""Seconds of compiling after which it is said."""


@contextmanager
def waiting(*, at_once: bool = False) -> Iterator[None]:
    """Say on stderr that JAX compiles and for how long; nothing where that is no terminal.

    While it compiles Python does not hear of a Ctrl-C, but this does: `at_once` ends the process
    then and there, if it holds no device and nothing half written.
    """
    if not sys.stderr.isatty() or threading.current_thread() is not threading.main_thread():
        yield
        return
    from jshape import compiling

    heard, rung = socket.socketpair()
    heard.setblocking(False)
    rung.setblocking(False)
    lock, over, width = threading.Lock(), threading.Event(), 0

    def show(text: str) -> None:
        nonlocal width
        with lock:
            if text or width:
                sys.stderr.write(f"\r{text.ljust(width)}" if text else f"\r{' ' * width}\r")
                sys.stderr.flush()
            width = len(text)

    def watch() -> None:
        while not over.is_set():
            rang = select.select([heard], [], [], 0.2)[0] and heard.recv(64)
            since = compiling.seconds()
            if since is None:
                continue
            if rang and signal.SIGINT in rang:
                show("")
                if at_once:
                    print("jshape: interrupted", file=sys.stderr, flush=True)
                    os._exit(130)
                print("interrupted: it ends when this is compiled", file=sys.stderr, flush=True)
            elif since > COMPILING:
                show(f"compiling, first time only: {since:.0f} s")

    compiling.listen(lambda: show(""))
    before = signal.set_wakeup_fd(rung.fileno(), warn_on_full_buffer=False)
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        show("")
        signal.set_wakeup_fd(before)
        heard.close()
        rung.close()
