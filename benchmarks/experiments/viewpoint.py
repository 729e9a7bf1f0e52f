"""Does the distance between two surfaces depend on where the camera is?  R against no R.

The same two surfaces are seen by a camera that turns about its centre, moves sideways, or does
both so that it keeps looking at the same place.  Only pixels that show one square patch of the
bed count, so that all views measure the same material.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import map_coordinates

from benchmarks.experiments import pages
from benchmarks.experiments.samples import Asked
from jshape import metric, sim
from jshape._typing import Float
from jshape.camera import D435_BAZAR

FIGURES = ("viewpoint.png", "views.png")
CAMERA = replace(D435_BAZAR, z_min=0.25, z_max=0.85)
"""The camera that looks: a depth range wide enough for every view."""
WIDE = replace(CAMERA, width=1100, height=900, u0=549.5, v0=449.5)
"""Sees all that a turned `CAMERA` sees: turning about the centre hides and shows nothing."""
BEYOND = 0.4
"""Metres that beds go on beyond their walls, so that `WIDE` sees no end of them."""
PATCH = 0.06
"""Half a side of the patch, metres."""
APART = 0.01
"""Between the two level planes, metres."""
TURNS = (-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0)
"""Degrees, about the image's vertical axis; two thirds of them about the horizontal one."""
SHIFTS = (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
"""Of the camera, metres."""
MOVES = ("pan", "tilt", "sideways", "sideways and back")
"""What the camera does: "sideways and back" turns it so that it looks at the patch again."""


class View(NamedTuple):
    """Where the camera is and looks."""

    move: str
    amount: float
    """Degrees, or metres for what moves sideways."""
    pan: float
    """Degrees."""
    tilt: float
    """Degrees."""
    shift: float
    """Along x, metres."""


def views(move: str, every: int = 1) -> list[View]:
    """The views of one of `MOVES`; every second, third, ... with `every`."""
    if move == "pan":
        return [View(move, a, a, 0.0, 0.0) for a in TURNS[::every]]
    if move == "tilt":
        return [View(move, a * 2 / 3, 0.0, a * 2 / 3, 0.0) for a in TURNS[::every]]
    back = move == "sideways and back"
    angle = [float(np.degrees(np.arctan2(-x, sim.SURFACE))) * back for x in SHIFTS]
    return [View(move, x, a, 0.0, x) for x, a in zip(SHIFTS, angle, strict=True)][::every]


def turn(view: View) -> Float[np.ndarray, "3 3"]:
    """The turned camera's axes in the frame of one that looks straight down."""
    a, b = np.radians(view.pan), np.radians(view.tilt)
    pan = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    return pan @ tilt


def seen_from(
    depth: Float[np.ndarray, "H W"], view: View
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w 3"]]:
    """What `CAMERA` sees after it was turned: depth, and the points in the frame before, metres.

    Args:
      depth: seen by `WIDE`, which looks straight down from the same centre.
      view: how it is turned.
    """
    x, y = np.broadcast_arrays(*(np.asarray(ray, np.float64) for ray in CAMERA.rays()))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ turn(view).T
    column = WIDE.fx * rays[..., 0] / rays[..., 2] + WIDE.u0
    row = WIDE.fy * rays[..., 1] / rays[..., 2] + WIDE.v0
    below = map_coordinates(depth.astype(np.float64), [row, column], order=1, cval=np.nan)
    along = below / rays[..., 2]
    return along, along[..., None] * rays


def below(pair: tuple[sim.Bed, sim.Bed], shift: float) -> list[np.ndarray]:
    """Both beds as `WIDE` sees them, moved along x by `shift` metres: (H, W) depths in metres."""
    return [np.asarray(sim.render(_moved(bed, shift), WIDE)) for bed in pair]


def measure(rendered: list[np.ndarray], view: View) -> dict[str, Any]:
    """Weighed and plain mean difference over the patch, mm, from one view.

    `even_mm` is the weighed one with each pixel counted as the solid angle that it sees.

    Args:
      rendered: from straight above, as `below` gives it for the view's shift.
      view: where the camera is and looks.
    """
    (first, points), (second, _) = (seen_from(depth, view) for depth in rendered)
    patch = (np.abs(points[..., 0] + view.shift) < PATCH) & (np.abs(points[..., 1]) < PATCH)
    levels = [np.asarray(CAMERA.luminance(depth, quantize=False)) for depth in (first, second)]
    images = [np.asarray(metric.weigh(level, CAMERA)) for level in levels]
    gap = np.abs(images[0] - images[1])[patch]
    angle = 1 / np.asarray(metric.ray_lengths(CAMERA))[patch] ** 3
    to_mm = float(metric.to_mm(1.0, CAMERA))
    span_mm = 1e3 * float(CAMERA.z_max - CAMERA.z_min)
    plain = np.abs(levels[0] - levels[1])[patch].mean() / CAMERA.top
    return {
        "move": view.move, "amount": view.amount, "pixels": int(patch.sum()),
        "weighted_mm": float(gap.mean() * to_mm), "unweighted_mm": float(plain * span_mm),
        "even_mm": float((gap * angle).sum() / angle.sum() * to_mm),
    }  # fmt: skip


def _moved(bed: sim.Bed, shift: float) -> sim.Bed:
    """The bed below a camera that was moved along x by whole cells; it goes on as at its wall."""
    cells, beyond = round(shift / bed.cell), round(BEYOND / bed.cell)
    height = np.asarray(bed.height)
    rows, columns = (np.arange(-beyond, count + beyond) for count in height.shape)
    at = np.clip(rows, 0, height.shape[0] - 1), np.clip(columns + cells, 0, height.shape[1] - 1)
    return sim.loose_bed(height[np.ix_(*at)], bed.cell)


def surfaces(seed: int) -> dict[str, tuple[sim.Bed, sim.Bed]]:
    """Pairs of beds by name."""
    for_bed, for_act = jax.random.split(jax.random.key(seed))
    hills, level = sim.irregular_bed(for_bed, 0.004), sim.flat_bed()
    return {
        "a grasp in irregular flour": (
            hills, sim.apply_action(for_act, hills, "flour", ("grasp", "robot"), (0.0, 0.0))
        ),
        "two level planes": (level, sim.loose_bed(np.asarray(level.height) - APART)),
    }  # fmt: skip


def spreads(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per surface and move: how far apart the views' values are, as a share of their mean."""
    found = []
    for surface, move in dict.fromkeys((row["surface"], row["move"]) for row in rows):
        mine = [row for row in rows if (row["surface"], row["move"]) == (surface, move)]
        line = {"surface": surface, "move": move, "views": len(mine)}
        for name in ("weighted", "unweighted", "even"):
            values = np.array([row[f"{name}_mm"] for row in mine])
            line |= {f"{name}_spread": float(np.ptp(values) / values.mean())}
        found.append(line)
    return found


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Measure two pairs of surfaces from every view.

    Args:
      out: folder of the result.
      asked: quick: every third view.

    Returns:
      What `results.json` holds: a row per surface and view.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    pages.check(out, asked.overwrite, FIGURES)
    pairs = surfaces(asked.seed)
    todo = [
        (name, view)
        for name in pairs
        for move in MOVES
        for view in views(move, 3 if asked.quick else 1)
    ]
    rendered: dict[tuple[str, float], list[np.ndarray]] = {}
    rows = []
    for name, view in asked.progress(todo, len(todo), "views"):
        if (name, view.shift) not in rendered:
            rendered[name, view.shift] = below(pairs[name], view.shift)
        rows.append({"surface": name} | measure(rendered[name, view.shift], view))
    found = spreads(rows)
    for line in found:
        asked.say(
            f"{line['surface']}, {line['move']}: spread {100 * line['weighted_spread']:.1f} % "
            f"weighted, {100 * line['unweighted_spread']:.1f} % not"
        )
    result = pages.Result(
        title="The same surfaces from other viewpoints, with and without R",
        paragraphs=_words(found),
        rows=rows,
        tables=[_table(found)],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(_figure, rows),
                "Distance over the patch, as a share of its value from straight above. Full "
                "lines: weighted with R, the distance along each pixel's ray. Broken lines: "
                "plain depth difference.",
            ),
            pages.Picture(
                FIGURES[1], partial(_pictures, pairs["a grasp in irregular flour"]),
                "Depth after the grasp from three of the views; the red line is the edge of the "
                "patch that is measured. White: farther out than was rendered, and not used.",
            ),
        ],
        settings={"seed": asked.seed, "patch_mm": 2e3 * PATCH, "planes_apart_mm": 1e3 * APART},
        notes=[
            "Seen without noise; points between pixels of the render are interpolated.",
            "The views of a camera that turns are resampled from one render of each bed, so that "
            "the distance along a ray stays is built in, and no finding: 0.0 % with R between two "
            "level planes is an identity. What these rows measure is how far the plain difference "
            "changes, and what the uneven sampling of a tilted image adds.",
        ],
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def _words(found: list[dict[str, Any]]) -> list[str]:
    def worst(moves: tuple[str, ...], name: str) -> str:
        most = max(line[f"{name}_spread"] for line in found if line["move"] in moves)
        return f"{100 * most:.1f} %"

    turns, planes = ("pan", "tilt"), [x for x in found if x["surface"] == "two level planes"]
    side = next(line for line in planes if line["move"] == "sideways")
    return [
        "A depth is measured along the camera's axis, a distance between two points is not. R "
        "makes the first into the second: the distance of the two points that one pixel sees, "
        "along its ray.",
        "A camera that turns about its centre sees the same points along the same rays. The "
        f"weighted distance then stays within {worst(turns, 'weighted')} ("
        f"{worst(turns, 'even')} if each pixel counts as much as the solid angle that it sees: the "
        "rest is that a tilted image has more pixels for some parts of the patch); the plain "
        f"difference of the depths changes by up to {worst(turns, 'unweighted')}.",
        "A camera that moves sees other points along other rays, and no weight can undo that. "
        "Between two level planes the ray is longer from the side: the weighted distance "
        f"changes by {100 * side['weighted_spread']:.1f} % over the shifts, while the plain "
        f"difference, which is the planes' own, changes by {100 * side['unweighted_spread']:.1f} "
        "% as long as the camera looks straight down. d compares images of a camera that "
        "stays where it is, as the paper's does; what R buys is that the whole image counts in "
        "one unit, however the camera is mounted.",
    ]


def _table(found: list[dict[str, Any]]) -> pages.Table:
    lines = [
        (line["surface"], line["move"], str(line["views"]),
         f"{100 * line['weighted_spread']:.2f} %", f"{100 * line['unweighted_spread']:.2f} %",
         f"{100 * line['even_spread']:.2f} %")
        for line in found
    ]  # fmt: skip
    head = ("surfaces", "the camera's move", "views", "spread with R", "without R",
            "with R, by solid angle")  # fmt: skip
    return pages.Table("Spread over the views: (largest - smallest) / mean", head, lines)


def _figure(rows: list[dict[str, Any]]) -> Figure:
    figure = Figure(figsize=(9.2, 3.8), layout="constrained")
    axes = figure.subplots(1, len(MOVES), sharey=True)
    colours = dict(zip(dict.fromkeys(row["surface"] for row in rows), ("tab:blue", "tab:orange"),
                       strict=True))  # fmt: skip
    for ax, move in zip(axes, MOVES, strict=True):
        turned = move in ("pan", "tilt")
        for surface, colour in colours.items():
            mine = [row for row in rows if (row["surface"], row["move"]) == (surface, move)]
            at = np.array([row["amount"] for row in mine]) * (1 if turned else 1e3)
            middle = int(np.argmin(np.abs(at)))
            for name, style in (("weighted", "o-"), ("unweighted", "s--")):
                values = np.array([row[f"{name}_mm"] for row in mine])
                said = f"{surface}, {'with' if name == 'weighted' else 'without'} R"
                ax.plot(at, values / values[middle], style, color=colour, label=said, markersize=4)
        ax.set_title(move, fontsize=10)
        ax.set_xlabel("degrees" if turned else "mm")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("distance / from straight above")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2,
                  fontsize=9)  # fmt: skip
    return figure


def _pictures(pair: tuple[sim.Bed, sim.Bed]) -> Figure:
    shown = {
        "straight above": View("pan", 0.0, 0.0, 0.0, 0.0),
        "pan 30 degrees": View("pan", 30.0, 30.0, 0.0, 0.0),
        "tilt 20 degrees": View("tilt", 20.0, 0.0, 20.0, 0.0),
    }
    figure = Figure(figsize=(9.2, 2.5), layout="constrained")
    axes = figure.subplots(1, len(shown))
    for ax, (title, view) in zip(axes, shown.items(), strict=True):
        depth, points = seen_from(np.asarray(sim.render(_moved(pair[1], 0.0), WIDE)), view)
        ax.imshow(1e3 * depth, cmap="gray_r", vmin=340, vmax=620)
        inside = (np.abs(points[..., :2]) < PATCH).all(-1)
        ax.contour(inside, [0.5], colors="tab:red", linewidths=1.5)
        ax.set_title(title, fontsize=10)
        ax.set_xticks([])
        ax.set_yticks([])
    figure.colorbar(axes[0].images[0], ax=axes, label="depth (mm)")
    return figure
