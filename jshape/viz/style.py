"""How every picture is drawn: with matplotlib's own defaults, off screen, after the results.

What a user's matplotlibrc says (LaTeX, another origin of images, a window system) does not reach
our pictures, and one that cannot be drawn costs a warning, not what was computed.
"""

import io
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from jshape.errors import one_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawing = Callable[[], Any]
"""Draws a figure when it is called."""

_LOCK = threading.RLock()  # matplotlib's settings are the process's


@contextmanager
def own_style() -> Iterator[None]:
    """Draw with our own settings; a context, or `@own_style()` before a function."""
    import matplotlib  # not above: where it is broken, there are results without pictures

    ours: Any = {
        name: value
        for name, value in matplotlib.rcParamsDefault.items()
        if not name.startswith(("backend", "interactive", "toolbar"))  # of windows
    }
    with _LOCK, matplotlib.rc_context(ours):
        yield


def png(figure: "Figure | Drawing", dpi: int = 100) -> bytes:
    """A figure, or what draws it, as the bytes of a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with own_style():
        stream = io.BytesIO()
        drawn = figure() if callable(figure) else figure
        FigureCanvasAgg(drawn).print_figure(stream, format="png", dpi=dpi)
    return stream.getvalue()


def drawn(pictures: Mapping[str, Drawing], dpi: int = 100) -> dict[str, bytes]:
    """PNGs by their names: those that can be drawn; of each of the others, a warning on stderr."""
    made: dict[str, bytes] = {}
    for name, draw in pictures.items():
        try:
            made[name] = png(draw, dpi)
        except Exception as problem:  # whatever fonts, settings or numbers come up with
            said = f"warning: {name} could not be drawn: {type(problem).__name__}: {problem}"
            print(one_line(said, 300), file=sys.stderr)
    return made
