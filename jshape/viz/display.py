"""A plan in a notebook, and a figure on the screen."""

import base64
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from jshape.errors import escaped
from jshape.viz.overlay import Plan
from jshape.viz.pictures import plan_figure
from jshape.viz.style import drawn

MAX_ROWS = 20
"""Actions listed in a notebook."""


def plan_html(plan: Plan) -> str:
    """A plan as HTML: its summary, its figure and its actions.

    Text from the plan is escaped, and the figure is inline: nothing is fetched or executed.
    """
    pictures = drawn({"plan": partial(plan_figure, plan)}, dpi=60) if plan.goal is not None else {}
    figures = (base64.b64encode(data).decode() for data in pictures.values())
    columns = plan.columns()
    numbers = range(1, len(plan) + 1)
    rows = list(zip(numbers, *columns.values(), strict=True))[:MAX_ROWS]
    more = len(plan) - len(rows)
    return "".join(
        (
            f"<div><code>{escaped(repr(plan))}</code></div>",
            *(f'<img alt="plan" src="data:image/png;base64,{data}">' for data in figures),
            "<table>",
            _row("th", ("", *columns)),
            *(_row("td", row) for row in rows),
            "</table>",
            f"<div>and {more} more</div>" if more > 0 else "",
        )
    )


def _row(cell: str, values: tuple[object, ...]) -> str:
    return f"<tr>{''.join(f'<{cell}>{escaped(value)}</{cell}>' for value in values)}</tr>"


def shown(figure: Figure) -> Figure | None:
    """Show a figure in a notebook or a window; the figure itself where there is neither."""
    from matplotlib import pyplot
    from matplotlib.backends.registry import BackendFilter, backend_registry

    if pyplot.get_backend() in backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE):
        return figure
    adopted: Any = lambda **_: figure  # noqa: E731
    try:
        pyplot.figure(FigureClass=adopted)
    except ImportError:  # a window system that is set but not there
        return figure
    pyplot.show()
    return None
