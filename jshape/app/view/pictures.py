"""The bed as a picture with numbered boxes, for the side of the 3-D view."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jshape.app.view.story import Story
from jshape.app.view.surfaces import DIFFERENCES
from jshape.planning.plan import Plan
from jshape.planning.search.base import Status
from jshape.viz.pictures import draw_actions
from jshape.viz.style import own_style

WIDTH, DPI = 5.0, 120
"""Of a picture: inches, and pixels in one."""


@own_style()
def picture(
    story: Story, shown: np.ndarray, step: int, *, differences: bool, acts: bool = True
) -> np.ndarray:
    """A bed from above, with the actions done so far; at the start, with all of them.

    Args:
      story: whose actions are drawn.
      shown: (H, W) depth in metres, or differences in mm.
      step: actions up to this one are drawn, all of them at 0.
      differences: what `shown` is.
      acts: draw them.

    Returns:
      (h, w, 3) uint8.
    """
    height, width = shown.shape
    figure = Figure(figsize=(WIDTH, 0.85 * WIDTH * height / width), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    ax = figure.subplots()
    if differences:
        scale = {"cmap": DIFFERENCES, "vmin": -story.reach_mm, "vmax": story.reach_mm}
        drawn, label = ax.imshow(shown, **scale), "too high (mm)"
    else:
        near, far = story.range_m
        height_mm = 1000.0 * (story.level - shown)
        low, high = (1000.0 * (story.level - x) for x in (far, near))
        drawn = ax.imshow(height_mm, cmap="gray", vmin=low, vmax=high)
        label = "above the level of the bed (mm)"
    figure.colorbar(drawn, ax=ax, label=label, shrink=0.9)
    ax.tick_params(labelsize=7)
    if acts:
        draw_actions(ax, plan_of(story, step), strengths=False)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def plan_of(story: Story, step: int) -> Plan:
    """The actions up to a step, all of them at 0, as a plan to be drawn."""
    acts = story.acts[: step or None]
    places = np.array([act.position for act in acts], np.float32).reshape(-1, 2)
    whole = np.rint(places).astype(np.int32)
    return Plan(
        camera=story.camera,
        actions=tuple(act.name for act in acts),
        positions=whole,
        rois=np.array([act.roi or (1, 1) for act in acts], np.int32).reshape(-1, 2),
        distances=np.zeros(len(acts) + 1, np.float32),
        status=Status.PLAN_ENDED,
        strengths=np.array([act.strength for act in acts], np.float32),
        yaws=np.array([act.yaw for act in acts], np.float32),
        offsets=places - whole,
    )
