"""A plan's actions on an image and in words: what to do where, in which order."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jshape.height_map import places_on

COLOURS = {
    "grasp": "tab:red",
    "knock": "tab:blue",
    "press": "tab:green",
    "pinch": "tab:purple",
    "poke": "tab:orange",
    "sweep": "tab:cyan",
    "scoop": "tab:brown",
    "pour": "tab:pink",
}
"""Box colour of each action; others are grey."""

Rois = Mapping[str, tuple[int, int]]
"""(w, h) of the ROI that each action was trained with, pixels."""


Plan = Any
"""A `jshape.Plan`, by structure: figures import no records, so that records can draw themselves."""


def is_own(plan: Plan) -> bool:
    """The plan's pixels are those of the camera that took the frames."""
    return np.array_equal(plan.camera_positions, plan.positions)


def in_words(plan: Plan, most: int) -> list[str]:
    """A heading, and what to do, line by line; many in two columns if `most` letters hold them."""
    where = "" if is_own(plan) else " in the camera's own pixels"
    places = [f"({u}, {v})" for u, v in plan.camera_positions]
    if plan.camera.orthographic:  # as the axes are
        where = " at (x, y) in mm"
        on_map = np.rint(1e3 * places_on(plan.camera, plan.exact_positions)).astype(int)
        pixels, places = places, [f"({x}, {y})" for x, y in on_map]
        if plan.view is not None:
            where += ", and in the camera's own pixels"
            places = [f"{p}, pixel {q}" for p, q in zip(places, pixels, strict=True)]
    many = "1 action" if len(plan) == 1 else f"{len(plan)} actions"
    told = (act.words(plan.camera, place) for act, place in zip(plan, places, strict=True))
    steps = [f"{k:2d} {words}" for k, words in enumerate(told, 1)]
    half = -(-len(steps) // 2)
    wide = max(map(len, steps), default=0) + 3
    if len(steps) > 8 and 2 * wide - 3 <= most:
        steps = [
            left.ljust(wide) + right
            for left, right in zip(steps[:half], [*steps[half:], ""], strict=False)
        ]
    return [f"{many}{where}:", *(steps or ["nothing helps"])]


def draw_actions(ax: Axes, plan: Plan, rois: Rois | None = None, *, strengths: bool = True) -> None:
    """The plan's ROIs as boxes, and a numbered cross at each place to act on.

    A path is an arrow from its start to its end; a dashed one leads from where material is taken to
    where it is brought.

    Call it last: numbers are laid beside each other where the axes are by then.

    Args:
      ax: shows I0.
      plan: what to draw.
      rois: trained ROIs: a turned hand's box is its own, turned; else its square.
      strengths: beside the numbers, where they are not 1.
    """
    many = len(plan) > 6
    size, width = (7.5, 1.1) if many else (9.0, 1.8)
    if isinstance(ax.figure, Figure):
        ax.figure.draw_without_rendering()  # lays out the axes
    room = _Room(ax, size)
    for act in plan:
        (u, v), (w, h) = map(float, act.position), act.roi
        yaw, colour = np.degrees(act.yaw), COLOURS.get(act.action, "0.5")
        left, top = u - w // 2 - 0.5, v - h // 2 - 0.5
        if yaw:
            if rois and act.action in rois:
                w, h = rois[act.action]
                if not act.carries:  # what a longer path adds
                    w += np.hypot(*act.stroke) * (1 - 1 / act.length)
            left, top = u - w / 2, v - h / 2
        box = Rectangle(
            (left, top), w, h, angle=yaw, rotation_point=(u, v), fill=False, edgecolor=colour,
            linewidth=width,
        )  # fmt: skip
        ax.add_patch(box)
        ax.plot(u, v, "+", color=colour, markersize=size, markeredgewidth=width)
        room.take(u, v)
        if any(act.stroke):
            start, end = act.ends
            look = dict(color=colour, linewidth=1.4 * width, linestyle="--" if act.carries else "-")
            look |= dict(arrowstyle="-|>", mutation_scale=1.6 * size, shrinkA=0, shrinkB=0)
            ax.annotate("", end, start, arrowprops=look, annotation_clip=False)
            room.take(*end)
    for k, act in enumerate(plan, 1):
        (u, v), colour = map(float, act.position), COLOURS.get(act.action, "0.5")
        text = f"{k}" + (act.deep if strengths else "")
        x, y = room.beside(u, v, text)
        ax.plot([u, x], [v, y], color=colour, linewidth=width)
        ax.text(
            x, y, text, color="white", ha="center", va="center", fontsize=size, zorder=5,
            fontweight="bold", in_layout=False,
            bbox={"facecolor": colour, "edgecolor": "white", "linewidth": 0.5, "pad": 1.5},
        )  # fmt: skip


class _Room:
    """Where labels are on an image, so that the next one lies beside them."""

    def __init__(self, ax: Axes, size: float):
        """For text of `size` points."""
        (x0, _), (x1, _) = ax.transData.transform([(0, 0), (1, 0)])
        self._point = ax.figure.dpi / 72 / (x1 - x0)  # in pixels of the image
        self._size = size
        (left, right), (bottom, top) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
        self._inside = left, bottom, right, top
        self._taken: list[tuple[float, ...]] = []

    def take(self, u: float, v: float) -> None:
        """Keep the mark at (u, v) free."""
        reach = 0.3 * self._size * self._point
        self._taken.append((u - reach, v - reach, u + reach, v + reach))

    def beside(self, u: float, v: float, text: str) -> tuple[float, float]:
        """The middle of the free place for a text that is nearest to (u, v)."""
        w = (0.72 * self._size * len(text) + 5) * self._point
        h = (1.1 * self._size + 5) * self._point
        best, least = (u, v), np.inf
        for far in range(1, 9):  # rings around the mark, ever wider
            for turn in np.arange(0, 2 * np.pi, np.pi / (4 * far)):
                x = u + far * (w / 2 + self._size * self._point / 2) * np.cos(turn - np.pi / 2)
                y = v + far * h * np.sin(turn - np.pi / 2)
                box = x - w / 2, y - h / 2, x + w / 2, y + h / 2
                hidden = sum(_overlap(box, other) for other in self._taken)
                hidden += w * h - _overlap(box, self._inside)
                if hidden < least - 1e-6:
                    best, least = (x, y), hidden
            if least <= 1e-6:
                break
        x, y = best
        self._taken.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2))
        return x, y


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Area that two boxes (left, top, right, bottom) share."""
    across = min(one[2], other[2]) - max(one[0], other[0])
    down = min(one[3], other[3]) - max(one[1], other[1])
    return max(across, 0.0) * max(down, 0.0)
