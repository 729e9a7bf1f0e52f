"""What pictures of height maps have that others do not: axes in mm, and places that nobody saw."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jshape.camera import Camera
from jshape.height_map import places_on

UNSEEN: dict[str, Any] = {
    "facecolor": "mistyrose", "edgecolor": "tab:red", "hatch": "////", "linewidth": 0.0
}  # fmt: skip
"""How what no camera saw looks: no height has this colour."""


def mark_unseen(ax: Axes, seen: np.ndarray | None) -> bool:
    """Show what lies behind an image where it is NaN; whether there is any (`seen` None: no)."""
    if seen is None or seen.all():
        return False
    ax.patch.set(**UNSEEN)
    return True


def in_mm(ax: Axes, camera: Camera) -> None:
    """X and y of a height map in mm along an image of its camera, y up."""
    ends = 1e3 * places_on(camera, [(0, 0), (camera.width - 1, camera.height - 1)])
    u0, v0, per_mm = float(camera.u0), float(camera.v0), float(camera.fx) / 1e3
    for axis, (first, last), of in (
        (ax.xaxis, sorted(ends[:, 0]), lambda x: u0 + per_mm * x),
        (ax.yaxis, sorted(ends[:, 1]), lambda y: v0 - per_mm * y),
    ):
        at = MaxNLocator(8, steps=(1, 2, 5, 10)).tick_values(first, last)
        at = at[(at >= first) & (at <= last)]
        axis.set_ticks(of(at), [f"{mm:g}" for mm in at])
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
