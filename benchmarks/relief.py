"""Beds with more relief than the paper's: a heap, a dome, a hole and a mound, and goals on them.

Each goal is what another hand, a person's, makes of the bed with three actions.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.problems import Applied, Problem
from jshape import metric, sim
from jshape.camera import PAPER_BOX
from jshape.height_map import ABOVE
from jshape.robot.loop import Molding
from jshape.robot.simulated import SimulatedWorld
from jshape.viz.maps import in_mm, mark_unseen
from jshape.viz.style import own_style

DEEP = replace(PAPER_BOX, z_min=0.30, z_max=0.56, bits=16)
"""Straight above, of a range that holds all of them."""
APPLIED = (
    Applied("knock", (240, 140), 1.5, 0.0),
    Applied("press", (330, 230), 1.5, 0.4),
    Applied("knock", (130, 240), 1.5, 0.0),
)
"""On the top or in the middle, on a flank, and beside it."""


def _heap(r: np.ndarray) -> np.ndarray:
    return 0.09 * np.exp(-((r / 0.09) ** 2))


def _dome(r: np.ndarray) -> np.ndarray:
    """As `sim.curved_bed`: a sphere of 150 mm, which ends 60 mm below its top."""
    return 0.06 - np.minimum(0.15 - np.sqrt(np.maximum(0.15**2 - r**2, 0.0)), 0.06)


def _hole(r: np.ndarray) -> np.ndarray:
    return -0.06 * np.exp(-((r / 0.07) ** 4))


def _mound(r: np.ndarray) -> np.ndarray:
    return 0.04 * np.exp(-((r / 0.05) ** 2))


BEDS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str, tuple[str, ...]]] = {
    "heap, 90 mm high": (_heap, "flour", ("from above", "30 degrees")),
    "dome, radius 150 mm": (_dome, "flour", ("from above", "30 degrees")),
    "hole, 60 mm deep": (_hole, "sand", ("from above", "30 degrees")),
    "mound, 40 mm high": (_mound, "flour", ("from above", "30 degrees", "two at 30 degrees")),
}
"""Heights (metres) by distance from the middle, the material, and the views to compare."""


def relief_problems() -> list[Problem]:
    """The beds, and what they become under another hand."""
    return [_problem(name, rise, material) for name, (rise, material, _) in BEDS.items()]


def _problem(name: str, rise: Callable[[np.ndarray], np.ndarray], material: str) -> Problem:
    level = sim.flat_bed()
    x, y = (np.asarray(axis) for axis in level.axes())
    height = level.height + rise(np.hypot(x[None], y[:, None])).astype(np.float32)
    bed = sim.loose_bed(height)
    other = SimulatedWorld(jax.random.key(7), bed, material=material, agent="human", camera=DEEP)
    for action in APPLIED:
        other.act(*action)
    start, goal = (
        np.asarray(metric.weigh(DEEP.luminance(sim.render(b, DEEP), quantize=False), DEEP))
        for b in (bed, other.bed)
    )
    return Problem(name, "applied", bed, start, goal, APPLIED, DEEP, material, "human", truth=goal)


@own_style()
def picture(name: str, runs: dict[str, tuple[Molding, float]]) -> Figure:
    """A row for each view: the bed at first, the goal, what came out, and how the two differ.

    All seen from above; numbers are the places of the actions, in their order.
    """
    columns = ("seen at first", "wanted", "seen at last", "last - wanted")
    figure = Figure(figsize=(13.0, 2.6 * len(runs) + 0.5), layout="constrained")
    axes = figure.subplots(len(runs), len(columns), squeeze=False)
    for row, (view, (run, left)) in zip(axes, runs.items(), strict=True):
        camera = run.first_plan.camera
        goal = np.asarray(camera.depth(metric.unweigh(run.goal, camera)))
        shown = [1e3 * (ABOVE - depth) for depth in (run.depths[0], goal, run.depths[-1])]
        low, high = np.nanpercentile(np.stack(shown), (0.2, 99.8))
        for ax, title, heights in zip(row, columns, [*shown, shown[2] - shown[1]], strict=True):
            least, most, colours = low, high, "gray"
            if title == columns[-1]:
                least, most, colours = -8, 8, "coolwarm"
            drawn = ax.imshow(heights, cmap=colours, vmin=least, vmax=most, interpolation="nearest")
            mark_unseen(ax, np.isfinite(heights))
            if camera.orthographic:
                in_mm(ax, camera)
                ax.tick_params(labelsize=7)
            else:
                ax.set(xticks=[], yticks=[])
            ax.set(title=title, xlabel="", ylabel="")
            if title in columns[2:]:
                figure.colorbar(drawn, ax=ax, shrink=0.8, label="mm", extend="both")
        row[0].set_ylabel(f"{view}: {left:.0f} % left")
        for number, step in enumerate(run.steps, 1):
            row[0].annotate(str(number), step.position, color="tab:orange", ha="center")
    figure.suptitle(name)
    return figure
