"""The curves beside the 3-D view: distance and effort over the steps, with a ring at one."""

from typing import Any

import numpy as np

from jshape.app.view.story import Story

CURVES = {
    # Predicted is drawn wider and first: where both agree, it frames the other.
    "predicted": ("predicted_mm", "#1f77b4", 5, 11),
    "obtained": ("seen_mm", "#d62728", 2, 6),
    "effort": ("effort_nm", "#2ca02c", 2, 6),
}
"""Of each: the field of a moment, the colour, and the width of its line and its points."""
PLOTS = {"distance to the goal (mm)": ("predicted", "obtained"), "effort (Nm)": ("effort",)}
"""Which curves are drawn together."""


def add_curves(viser: Any, gui: Any, story: Story) -> list[tuple[Any, np.ndarray]]:
    """Plots of what the story knows.

    Returns:
      Of each: its handle, and its rows of numbers (the steps first) for `with_mark`.
    """
    made = []
    for title, wanted in PLOTS.items():
        rows = {name: values for name in wanted if (values := _values(story, CURVES[name][0]))}
        if not rows:
            continue
        series = np.array([np.arange(len(story) + 1.0), *rows.values()])
        top = 1.1 * float(np.nanmax(series[1:])) or 1.0
        lines = [_line(viser, name) for name in rows]
        mark = viser.uplot.Series(
            label="shown", stroke="#000000", width=0,
            points={"show": True, "size": 14, "stroke": "#000000", "width": 2},
        )  # fmt: skip
        plot = gui.add_uplot(
            with_mark(series, 0),
            (viser.uplot.Series(label="step"), *lines, mark),
            title=title,
            scales={"x": {"time": False}, "y": {"range": (0.0, top)}},
            height=160,
        )
        made.append((plot, series))
    return made


def with_mark(series: np.ndarray, step: int) -> tuple[np.ndarray, ...]:
    """Rows of numbers with one more: the last number that is known at a step."""
    mark = np.full(series.shape[1], np.nan)
    here = series[1:, step]
    if np.isfinite(here).any():
        mark[step] = here[np.isfinite(here)][-1]
    return (*series, mark)


def _line(viser: Any, name: str) -> Any:
    _, colour, width, size = CURVES[name]
    points = {"show": True, "size": size, "fill": colour, "stroke": colour}
    return viser.uplot.Series(label=name, stroke=colour, width=width, spanGaps=True, points=points)


def _values(story: Story, name: str) -> list[float]:
    """A number of each moment, NaN where it is not known; nothing if it is known nowhere."""
    values = [getattr(moment, name) for moment in story.moments]
    known = [np.nan if value is None else float(value) for value in values]
    return known if np.isfinite(known).any() else []
