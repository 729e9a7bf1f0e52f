"""Figures of plans and runs.  They are drawn off screen and returned as PNG bytes."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jshape import metric
from jshape._typing import ArrayLike
from jshape.camera import Camera
from jshape.errors import JShapeError
from jshape.height_map import ABOVE
from jshape.viz.maps import extremes, in_mm, mark_unseen, span
from jshape.viz.overlay import Plan, Rois, draw_actions, in_words, is_own
from jshape.viz.style import drawn, own_style

LETTER = 9 * 0.602 / 72
"""Width of a letter of a title of `overlay_figure`, inches: DejaVu Sans Mono's at 9 points."""

BEYOND = "predicted - goal, beyond ±"
"""Title of what no usual error of the prediction explains."""


def height_mm(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Height in mm of a weighed image I above what `_above` says."""
    depth = np.asarray(camera.depth(metric.unweigh(image, camera)))
    return 1e3 * ((ABOVE if camera.orthographic else float(camera.z_max)) - depth)


def _above(camera: Camera) -> str:
    """What heights are above, for a scale: a map's are its own, a camera's end with its range."""
    return f"above the {'plane' if camera.orthographic else 'far end of the range'} (mm)"


def _shown(image: np.ndarray, camera: Camera, seen: np.ndarray | None) -> np.ndarray:
    """`height_mm`, NaN where nobody saw the bed: what was filled in there is no height."""
    height = height_mm(image, camera)
    return height if seen is None else np.where(seen, height, np.nan)


@own_style()
def plan_figure(
    plan: Plan,
    *,
    looks: Sequence[np.ndarray] = (),
    obtained_mm: ArrayLike | None = None,
    rois: Rois | None = None,
    title: str = "",
) -> Figure:
    """The whole story of a plan on one page.

    I0 with the numbered actions, the goal, the predicted (and obtained) image, their differences
    to the goal, and the distance over the actions; where the bank knows its intervals, their half
    widths, and what of the predicted difference is beyond them.

    Args:
      plan: with its images and its goal.
      looks: (H, W) each, images of a run: the first is shown as now, the last as obtained.
      obtained_mm: measured distances at the start and after each action.
      rois: trained ROIs, for the boxes of turned hands.
      title: above all.

    Raises:
      JShapeError: the plan was stored without its images.
    """
    camera, goal = plan.camera, plan.goal
    if goal is None:
        raise JShapeError("this plan was stored without its images")
    shown = [("now, with the plan", looks[0] if looks else plan.images[0]), ("goal", goal)]
    shown.append((f"predicted: {plan.distances_mm[-1]:.2f} mm", plan.images[-1]))
    if looks:
        d_mm = float(metric.to_mm(metric.distance(looks[-1], goal, plan.seen), camera))
        shown.append((f"obtained: {d_mm:.2f} mm", looks[-1]))
    heights = [_shown(image, camera, plan.seen) for _, image in shown]
    wanted = heights[1]
    gaps = [h - wanted for k, h in enumerate(heights) if k != 1]
    reach = max(np.abs(extremes(gaps)).max(), 1.0)

    half, columns = plan.half_widths_mm, len(shown)
    figure = Figure(figsize=(4.0 * (columns + (half is not None)), 6.6), layout="constrained")
    axes = figure.subplots(2, columns + (half is not None), squeeze=False)
    if half is not None:
        _draw_interval(axes[0][-1], half, plan.seen)
        # What is left of the difference when the truth lies at the near end of its interval.
        beyond = np.abs(gaps[1]) - np.nan_to_num(half)
        gaps.append(np.sign(gaps[1]) * np.maximum(beyond, 0.0))
    top = axes[0][:columns]
    names = [name for name, _ in shown]
    _draw_heights(top, heights, names, _above(camera), plan.seen, shrink=0.85)
    names = ["now - goal", "predicted - goal", *["obtained - goal"] * bool(looks), BEYOND]
    bottom = [axes[1][0], *axes[1][2:]]
    for ax, name, gap in zip(bottom, names, gaps, strict=False):
        drawn = ax.imshow(gap, cmap="RdBu_r", vmin=-reach, vmax=reach)
        mark_unseen(ax, plan.seen)
        _bare(ax, name)
    ends = "neither" if plan.seen is None else "both"
    label = "too high: red, + (mm)"
    figure.colorbar(drawn, ax=list(axes[1]), label=label, shrink=0.85, extend=ends)
    draw_curve(axes[1][1], plan.distances_mm, obtained_mm, plan.distance_half_widths_mm)
    if title:
        figure.suptitle(title)
    draw_actions(axes[0][0], plan, rois, strengths=False)
    return figure


@own_style()
def overlay_figure(plan: Plan, *, rois: Rois | None = None) -> Figure:
    """I0 alone, with the actions as numbered boxes: what to do where, in which order."""
    camera = plan.camera
    room = int((camera.width / 60 + 0.8) / LETTER)
    heading, *lines = in_words(plan, room)
    small = min(1.0, room / max(map(len, [heading, *lines])))
    size = camera.width / 60 + 1.6, camera.height / 60 + 0.8 + 0.16 * len(lines)
    figure = Figure(figsize=size, layout="constrained")
    ax = figure.subplots()
    height = _shown(plan.images[0], camera, plan.seen)
    low, high = span([height])
    drawn = ax.imshow(height, cmap="gray", vmin=low, vmax=high)
    mark_unseen(ax, plan.seen)
    ends = "neither" if plan.seen is None else "both"
    figure.colorbar(drawn, ax=ax, label=_above(camera), shrink=0.85, extend=ends)
    if camera.orthographic:
        in_mm(ax, camera)
    else:
        whose = "" if is_own(plan) else ", bank's image"
        ax.set(xlabel=f"u (pixels{whose})", ylabel=f"v (pixels{whose})")
    text = "\n".join([heading, *lines])
    ax.set_title(text, fontsize=9 * small, family="monospace", loc="left")
    draw_actions(ax, plan, rois)
    return figure


@own_style()
def steps_figure(plan: Plan) -> Figure:
    """The predicted images of a plan side by side, and the goal."""
    names = ["now", *(f"{k} {act.action}{act.deep}" for k, act in enumerate(plan, 1))]
    images = list(plan.images)
    if plan.goal is not None:
        images, names = [*images, plan.goal], [*names, "goal"]
    return strip_figure(images, names, plan.camera, seen=plan.seen)


@own_style()
def strip_figure(
    images: Sequence[np.ndarray],
    names: Sequence[str],
    camera: Camera,
    *,
    columns: int = 5,
    seen: np.ndarray | None = None,
) -> Figure:
    """Images side by side with a name over each, all on one grey scale; `seen` (H, W) of a map."""
    heights = [_shown(image, camera, seen) for image in images]
    rows = -(-len(images) // columns)
    columns = -(-len(images) // rows)  # no lone picture in the last row
    figure = Figure(figsize=(3.0 * columns, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    for ax in axes[len(images) :]:
        ax.set_axis_off()
    _draw_heights(axes, heights, names, _above(camera), seen, shrink=0.7)
    return figure


def _draw_heights(
    axes: Any,
    heights: Sequence[np.ndarray],
    names: Sequence[str],
    label: str,
    seen: np.ndarray | None,
    *,
    shrink: float,
) -> None:
    """Heights in mm on one grey scale, beside it."""
    low, high = span(heights)
    for ax, name, height in zip(axes, names, heights, strict=False):
        drawn = ax.imshow(height, cmap="gray", vmin=low, vmax=high)
        mark_unseen(ax, seen)
        _bare(ax, name)
    ends = "neither" if seen is None else "both"
    axes[0].figure.colorbar(drawn, ax=list(axes), label=label, shrink=shrink, extend=ends)


def _draw_interval(ax: Axes, half_mm: np.ndarray, seen: np.ndarray | None) -> None:
    """Half widths of pixels' intervals, with a scale of their own."""
    shown = half_mm if seen is None else np.where(seen, half_mm, np.nan)
    known = shown[np.isfinite(shown)]
    most = max(float(np.percentile(known, 99.8)) if known.size else 0.0, 1.0)
    drawn = ax.imshow(shown, cmap="magma", vmin=0.0, vmax=most)
    mark_unseen(ax, None if known.size == shown.size else np.isfinite(shown))
    _bare(ax, "four of five pixels are within ±")
    ax.figure.colorbar(drawn, ax=ax, label="± (mm)", shrink=0.85, extend="max")


def draw_curve(
    ax: Axes,
    predicted_mm: ArrayLike,
    obtained_mm: ArrayLike | None = None,
    half_widths_mm: np.ndarray | None = None,
) -> None:
    """Distance to the goal over the actions, with its intervals where they are known."""
    ax.plot(range(np.size(predicted_mm)), predicted_mm, "o--", color="tab:blue", label="predicted")
    if half_widths_mm is not None:
        low = np.maximum(np.asarray(predicted_mm) - half_widths_mm, 0.0)
        ax.fill_between(
            range(len(low)), low, np.asarray(predicted_mm) + half_widths_mm,
            color="tab:blue", alpha=0.2, linewidth=0, label="80 %",
        )  # fmt: skip
    if obtained_mm is not None:
        ax.plot(range(np.size(obtained_mm)), obtained_mm, "s-", color="tab:red", label="obtained")
    largest = max(float(np.max(y)) for y in (predicted_mm, obtained_mm) if y is not None)
    top = max(1.1 * largest, 1e-3)  # not 0, where goal and start are equal
    ax.set(xlabel="actions applied", ylim=(0, top))
    ax.set_title("distance to the goal (mm)", fontsize=10)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(alpha=0.3)
    ax.legend()


def _bare(ax: Axes, title: str) -> None:
    ax.set_title(title, fontsize=10)
    ax.set_xticks([])
    ax.set_yticks([])


def molding_pictures(rois: Rois) -> Callable[[Any], dict[str, bytes]]:
    """What draws the pictures of a run: a function of its `Molding`, with (w, h) per action."""

    def pictured(result: Any) -> dict[str, bytes]:
        first = result.first_plan
        names = ["at the start", *(f"after {k + 1} {s.action}" for k, s in enumerate(result.steps))]
        images = [*result.images, result.goal]
        made = {"steps.png": partial(strip_figure, images, [*names, "goal"], first.camera)}
        if first.initial is not None:
            made["result.png"] = partial(
                plan_figure, first, looks=result.images, obtained_mm=result.distances_mm,
                rois=dict(rois), title="the first plan, and what was obtained",
            )  # fmt: skip
        return drawn(made)

    return pictured
