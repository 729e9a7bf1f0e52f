"""Figures of plans and runs.  They are drawn off screen and returned as PNG bytes."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from jshape import metric
from jshape._typing import ArrayLike
from jshape.camera import Camera
from jshape.errors import JShapeError
from jshape.planned import Plan

COLOURS = {
    "grasp": "tab:red",
    "knock": "tab:blue",
    "press": "tab:green",
    "pinch": "tab:purple",
    "poke": "tab:orange",
}
"""Box colour of each action; others are grey."""


def png(figure: Figure, dpi: int = 100) -> bytes:
    """A figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(stream, format="png", dpi=dpi)
    return stream.getvalue()


def height_mm(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Height in mm above the far end of the camera's range, of a weighed image I."""
    depth = np.asarray(camera.depth(metric.unweigh(image, camera)))
    return 1e3 * (float(camera.z_max) - depth)


def plan_figure(
    plan: Plan,
    *,
    obtained: np.ndarray | None = None,
    obtained_mm: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """The whole story of a plan on one page.

    I0 with the numbered actions, the goal, the predicted (and obtained) image, their differences
    to the goal, and the distance over the actions.

    Args:
      plan: with its images and its goal.
      obtained: (H, W) the image that really came out.
      obtained_mm: measured distances at the start and after each action.
      title: above all.

    Raises:
      JShapeError: the plan was stored without its images.
    """
    camera, goal = plan.camera, plan.goal
    if goal is None:
        raise JShapeError("this plan was stored without its images")
    shown = [("now, with the plan", plan.images[0]), ("goal", goal)]
    shown.append((f"predicted: {plan.distances_mm[-1]:.2f} mm", plan.images[-1]))
    if obtained is not None:
        d_mm = float(metric.to_mm(metric.distance(obtained, goal), camera))
        shown.append((f"obtained: {d_mm:.2f} mm", obtained))
    heights = [height_mm(image, camera) for _, image in shown]
    low, high = (float(q) for q in np.percentile(np.stack(heights[:2]), (0.5, 99.5)))
    wanted = heights[1]
    gaps = [h - wanted for k, h in enumerate(heights) if k != 1]
    reach = max(float(np.percentile(np.abs(gaps[0]), 99.5)), 1.0)

    columns = len(shown)
    figure = Figure(figsize=(4.0 * columns, 6.6), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False)
    for ax, (name, _), height in zip(axes[0], shown, heights, strict=True):
        drawn = ax.imshow(height, cmap="gray", vmin=low, vmax=max(high, low + 1))
        _bare(ax, name)
    figure.colorbar(
        drawn, ax=list(axes[0]), label="above the far end of the range (mm)", shrink=0.85
    )
    draw_actions(axes[0][0], plan)
    names = ["now - goal", "predicted - goal", "obtained - goal"]
    bottom = [axes[1][0], *axes[1][2:]]
    for ax, name, gap in zip(bottom, names, gaps, strict=False):
        drawn = ax.imshow(gap, cmap="RdBu_r", vmin=-reach, vmax=reach)
        _bare(ax, name)
    figure.colorbar(drawn, ax=list(axes[1]), label="too high (mm)", shrink=0.85)
    draw_curve(axes[1][1], plan.distances_mm, obtained_mm)
    if title:
        figure.suptitle(title)
    return figure


def overlay_figure(plan: Plan) -> Figure:
    """I0 alone, with the actions as numbered boxes: what to do where, in which order."""
    camera = plan.camera
    tall = camera.height / 60 + 0.6 + 0.17 * len(plan)
    figure = Figure(figsize=(camera.width / 60, tall), layout="constrained")
    ax = figure.subplots()
    height = height_mm(plan.images[0], camera)
    low, high = (float(q) for q in np.percentile(height, (0.5, 99.5)))
    drawn = ax.imshow(height, cmap="gray", vmin=low, vmax=max(high, low + 1))
    figure.colorbar(drawn, ax=ax, label="above the far end of the range (mm)", shrink=0.85)
    draw_actions(ax, plan)
    own = plan.view is None or plan.view.window == (0, 0)
    whose = "" if own else ", bank's image"
    ax.set(xlabel=f"u (pixels{whose})", ylabel=f"v (pixels{whose})")
    steps = [
        f"{k + 1}  {name} at ({u}, {v})"
        for k, (name, (u, v)) in enumerate(zip(plan.actions, plan.camera_positions, strict=True))
    ]
    where = "" if own else " in the camera's own pixels"
    many = "1 action" if len(plan) == 1 else f"{len(plan)} actions"
    ax.set_title(f"{many}{where}:\n" + ("\n".join(steps) or "nothing helps"), fontsize=10)
    return figure


def steps_figure(plan: Plan) -> Figure:
    """The predicted images of a plan side by side, and the goal."""
    names = ["now", *(f"{k + 1} {name}" for k, name in enumerate(plan.actions))]
    images = list(plan.images)
    if plan.goal is not None:
        images, names = [*images, plan.goal], [*names, "goal"]
    return strip_figure(images, names, plan.camera)


def strip_figure(
    images: Sequence[np.ndarray], names: Sequence[str], camera: Camera, *, columns: int = 5
) -> Figure:
    """Images side by side with a name over each, all on one grey scale."""
    heights = [height_mm(image, camera) for image in images]
    low, high = (float(q) for q in np.percentile(np.stack(heights), (0.5, 99.5)))
    rows = -(-len(images) // columns)
    columns = -(-len(images) // rows)  # no lone picture in the last row
    figure = Figure(figsize=(3.0 * columns, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    for ax, name, height in zip(axes, names, heights, strict=False):
        drawn = ax.imshow(height, cmap="gray", vmin=low, vmax=max(high, low + 1))
        _bare(ax, name)
    for ax in axes[len(images) :]:
        ax.set_axis_off()
    figure.colorbar(drawn, ax=list(axes), label="above the far end of the range (mm)", shrink=0.7)
    return figure


def draw_actions(ax: Axes, plan: Plan) -> None:
    """The plan's ROIs as boxes with their number above and a cross at the place to act on."""
    taken: dict[tuple[int, int], int] = {}
    for k, name in enumerate(plan.actions):
        (u, v), (w, h) = plan.positions[k], plan.rois[k]
        colour = COLOURS.get(name, "0.5")
        left, top = int(u - w // 2), int(v - h // 2)
        ax.add_patch(
            Rectangle((left - 0.5, top - 0.5), w, h, fill=False, edgecolor=colour, linewidth=1.8)
        )
        ax.plot(u, v, "+", color=colour, markersize=9, markeredgewidth=1.8)
        beside = taken.get((left, top), 0)  # the same action twice in one place
        taken[left, top] = beside + 1
        ax.text(
            left + 2 + 26 * beside, max(top - 4, 12), str(k + 1), color="white", ha="left",
            va="bottom", fontsize=9, fontweight="bold",
            bbox={"facecolor": colour, "edgecolor": "none", "pad": 1.5},
        )  # fmt: skip


def draw_curve(ax: Axes, predicted_mm: ArrayLike, obtained_mm: ArrayLike | None = None) -> None:
    """Distance to the goal over the actions."""
    ax.plot(range(np.size(predicted_mm)), predicted_mm, "o--", color="tab:blue", label="predicted")
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
