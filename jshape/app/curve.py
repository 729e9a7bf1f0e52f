"""The distance to the goal, or another number, over the steps, with a mark at one."""

from collections.abc import Mapping, Sequence

import numpy as np
from nicegui import ui

COLOURS = {"predicted": "#1f77b4", "obtained": "#d62728", "effort": "#2ca02c"}
"""Of lines by their name."""


class Curve:
    """One chart with a line per name."""

    def __init__(self, label: str, names: Sequence[str], *, height: int = 230):
        self._names, many = tuple(names), len(names) > 1
        axis = {"nameLocation": "middle", "nameTextStyle": {"fontSize": 12}, "type": "value"}
        line = {"type": "line", "connectNulls": True, "symbolSize": 8}
        mark = {"type": "scatter", "symbol": "emptyCircle", "symbolSize": 18, "color": "#000000"}
        options = {
            "animation": False,
            "legend": {"show": many, "data": list(names), "top": 0},
            "grid": {"left": 55, "right": 15, "top": 30 if many else 15, "bottom": 40},
            "xAxis": axis | {"name": "actions done", "nameGap": 24, "minInterval": 1},
            "yAxis": axis | {"name": label, "nameGap": 38, "min": 0},
            "series": [line | {"name": name, "color": COLOURS[name]} for name in names],
        }
        options["series"].append(mark | {"z": 5})
        self._chart = ui.echart(options).classes("w-full").style(f"height: {height}px")

    def show(self, values: Mapping[str, Sequence[float]], step: int) -> None:
        """Draw numbers per step, NaN where one is not known; the last name known is marked."""
        marked = None
        *lines, mark = self._chart.options["series"]
        for name, line in zip(self._names, lines, strict=True):
            known = [(k, float(x)) for k, x in enumerate(values.get(name, ())) if np.isfinite(x)]
            line["data"] = [[k, round(x, 4)] for k, x in known]
            marked = dict(known).get(step, marked)
        mark["data"] = [] if marked is None else [[step, marked]]
        self._chart.update()
