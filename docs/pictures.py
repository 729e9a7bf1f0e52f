"""The pictures of docs/concepts.md and docs/figures.md: `python docs/pictures.py [NAME ...]`.

They are made in the simulator, with fixed keys, into docs/images; two minutes on two cores.
"""

import io
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from jshape import PAPER_BOX, load_bank, metric, plan, sim
from jshape.cli.demo import DemoOptions, demo
from jshape.data.simulate import random_bed, simulate_pairs, together
from jshape.goals import bed_map
from jshape.learn import report as scores
from jshape.learn.evaluate import cross_validate
from jshape.planning.options import options
from jshape.viz import pictures, sheets
from jshape.viz.style import png

IMAGES = Path(__file__).parent / "images"
LARGEST = 150_000
"""Bytes of a picture."""


def image() -> Figure:
    """Depth, luminance, R and I of one bed."""
    depth = _depth(_acted(("grasp", (130, 130)), ("knock", (350, 260))))
    L = np.asarray(PAPER_BOX.luminance(depth, quantize=False))
    shown = [
        ("Z: depth (mm)", 1e3 * depth, "gray_r"),
        ("L: luminance (near is 255)", L, "gray"),
        ("R: length of the ray per depth", np.asarray(metric.ray_lengths(PAPER_BOX)), "viridis"),
        ("I = R∘L, scaled to [0, 1]", np.asarray(metric.weigh(L, PAPER_BOX)), "gray"),
    ]
    figure = Figure(figsize=(9.6, 2.7), layout="constrained")
    for ax, (name, values, colours) in zip(figure.subplots(1, 4), shown, strict=True):
        figure.colorbar(ax.imshow(values, cmap=colours), ax=ax, shrink=0.8, location="bottom")
        _bare(ax, name)
    return figure


def effect() -> Figure:
    """A pair and its change; the same action on another bed, as it is and as it is predicted."""
    (pair,) = simulate_pairs(jax.random.key(3), 1, actions=("knock",), beds=("flat",), frames=5)
    u, v = pair.position
    box = (u, v, *pair.roi)
    frames = [np.where(k > 0, 450 - 0.1 * k, np.nan) for k in (pair.prior, pair.posterior)]
    before, after = (_cut(k, box) for k in frames)
    bed, at = random_bed(jax.random.key(5), "irregular"), (240, 190)
    seen = _image(_depth(bed))
    done = _image(_depth(_act(bed, "knock", at)))
    banks = {"f_D": load_bank("flour-robot"), "f_P": load_bank("pressed-flour-robot")}
    window = (*at, *banks["f_P"].roi("knock"))
    roi = _cut(seen, window)
    per = float(metric.to_mm(1.0, PAPER_BOX))
    true = _cut(done, window)
    shown = [
        ("a pair: before", before, None), ("after", after, None), ("its change", after - before, 1),
        ("another bed", _cut(pictures.height_mm(seen, PAPER_BOX), window) - 20, None),
        ("the change there", per * (true - roi), 1),
    ]  # fmt: skip
    for name, bank in banks.items():
        w, h = bank.roi("knock")
        mine = (*at, w, h)
        guess = np.asarray(bank.predict("knock", _cut(seen, mine), position=at))
        error = per * np.abs(guess - _cut(done, mine)).mean()
        title = f"as {name} predicts it\n{error:.2f} mm off"
        shown.append((title, per * (guess - _cut(seen, mine)), 1))
    figure = Figure(figsize=(8.8, 4.8), layout="constrained")
    axes = figure.subplot_mosaic([list("ABC."), list("DEFG")])
    for ax, (name, values, change) in zip(axes.values(), shown, strict=True):
        drawn = ax.imshow(values, cmap="RdBu_r" if change else "gray", vmin=-18, vmax=18)
        _bare(ax, name)
    figure.colorbar(drawn, ax=list(axes.values()), label="height, change (mm)", shrink=0.8)
    return figure


def ground() -> Figure:
    """The same knock in the middle and near a corner: cuts through the image and the ground."""
    places = {"in the middle": (240, 197), "at the border": (410, 197)}
    figure = Figure(figsize=(9.2, 4.8), layout="constrained")
    first, second = places
    axes = figure.subplot_mosaic([[first, "image"], [second, "ground"]], width_ratios=(1, 1.7))
    level, flat = _depth(sim.flat_bed()), sim.flat_bed()
    for k, (name, (u, v)) in enumerate(places.items()):
        bed = _act(flat, "knock", (u, v), spread=0.0)
        depth = _depth(bed)
        change = 1e3 * (level - depth)
        axes[name].imshow(_cut(change, (u, v, 130, 104)), cmap="RdBu_r", vmin=-18, vmax=18)
        _bare(axes[name], f"{name}, in the image")
        columns = np.arange(-65, 65)
        axes["image"].plot(columns, change[v, u + columns], label=name)
        seen = bed_map(depth, PAPER_BOX)
        (x, y), (x0, y0) = seen.axes(), seen.point((u, v))
        row = int(np.argmin(np.abs(y - y0)))
        near = np.abs(x - x0) < 0.07
        style = {"linestyle": ("-", "--")[k]}
        axes["ground"].plot(1e3 * (x - x0)[near], 1e3 * seen.height[row, near], **style)
    cuts = {
        "image": ("cuts through the images", "pixels from the place"),
        "ground": ("the same cuts on the ground, seen from above", "mm from the place"),
    }
    for name, (title, along) in cuts.items():
        axes[name].set_title(title, fontsize=10)
        axes[name].set(xlabel=along, ylabel="change (mm)")
        axes[name].grid(alpha=0.3)
    axes["image"].legend(fontsize=8, loc="upper center")
    return figure


def loop() -> Figure:
    """A blind plan and the closed loop on one bed, whose hand the bank does not know."""
    figure = Figure(figsize=(8.4, 3.2), layout="constrained")
    for ax, (name, closed) in zip(
        figure.subplots(1, 2, sharey=True), (("the first plan, blindly", False),
                                             ("looking after every action", True)), strict=True,
    ):  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "run"
            done = demo(options=DemoOptions(out=out, seed=4, agent="human", open_loop=not closed))
            done = done["steps"]
        obtained = [done[0]["before_mm"], *(step["obtained_mm"] for step in done)]
        predicted = [done[0]["before_mm"], *(step["predicted_mm"] for step in done)]
        pictures.draw_curve(ax, predicted, obtained)
        ax.set_title(f"{name}: {obtained[-1]:.2f} mm", fontsize=10)
    figure.axes[0].set_ylabel("distance to the goal (mm)")
    return figure


def story() -> Figure:
    """A plan's figure, with letters."""
    bank = load_bank("pressed-flour-robot")
    bed = random_bed(jax.random.key(8), "irregular", std=0.003)
    goal = bed
    for name, at in (("grasp", (130, 120)), ("knock", (360, 260)), ("press", (120, 300))):
        goal = _act(goal, name, at)
    found = plan(
        _image(_depth(bed)),
        _image(_depth(goal)),
        **options(bank=bank, strengths=(0.5, 1.0), max_steps=4),
    )
    figure = pictures.plan_figure(found, rois=bank.rois)
    for letter, ax in zip("ABCGDEFH", figure.axes[:8], strict=True):
        ax.text(0.02, 0.97, letter, transform=ax.transAxes, va="top", fontsize=15, zorder=9,
                fontweight="bold", bbox={"facecolor": "white", "pad": 2})  # fmt: skip
    return figure


def errors() -> Figure:
    """Errors of two kinds of bank on simulated pairs."""
    who = {"actions": ("poke", "pinch"), "agents": ("robot", "human")}
    made = simulate_pairs(jax.random.key(1), 12, beds=("flat", "irregular"), frames=5, **who)
    return scores.scores_figure(cross_validate(together(made), ["D", "P"]))


def sheet() -> Figure:
    """Pairs with their boxes, the last one drawn by hand."""
    tiles = []
    for pair in simulate_pairs(jax.random.key(2), 1, actions=("grasp", "poke"), frames=5):
        before, after = (np.where(k > 0, 0.1 * k, np.nan) for k in (pair.prior, pair.posterior))
        (u, v), (w, h) = pair.position, pair.roi
        box = (u - w // 2, v - h // 2, w, h)
        title = f"{len(tiles):05d} {pair.action} {pair.agent}"
        change, last = after - before, len(tiles) == 1
        tiles.append(sheets.Tile(title, pair.action, before, change, box, last))
    return sheets.contact_sheet(tiles)


PICTURES = {
    "concept_image": (image, 90),
    "concept_effect": (effect, 90),
    "concept_ground": (ground, 90),
    "concept_loop": (loop, 90),
    "figure_plan": (story, 80),
    "figure_scores": (errors, 90),
    "figure_sheet": (sheet, 90),
}
"""By file, what draws it, and dots per inch."""


def _bare(ax: Axes, title: str) -> None:
    ax.set_title(title, fontsize=10)
    ax.set(xticks=[], yticks=[])


def _act(bed: sim.Bed, name: str, at: tuple[int, int], spread: float = 1.0) -> sim.Bed:
    xy = sim.position_to_xy(PAPER_BOX, np.array(at))
    return sim.apply_action(jax.random.key(at[0]), bed, "flour", (name, "robot"), xy, spread=spread)


def _acted(*actions: tuple[str, tuple[int, int]]) -> sim.Bed:
    bed = random_bed(jax.random.key(1), "irregular", std=0.004)
    for name, at in actions:
        bed = _act(bed, name, at)
    return bed


def _depth(bed: sim.Bed) -> np.ndarray:
    return np.asarray(sim.render(bed, PAPER_BOX))


def _image(depth: np.ndarray) -> np.ndarray:
    luminance = PAPER_BOX.luminance(depth, quantize=False)
    return np.asarray(metric.weigh(luminance, PAPER_BOX))


def _cut(values: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    u, v, w, h = box
    return values[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]


def main(names: list[str]) -> None:
    """Draw some pictures, or all."""
    for name in names or PICTURES:
        draw, dpi = PICTURES[name]
        drawn = Image.open(io.BytesIO(png(draw, dpi=dpi)))
        path = IMAGES / f"{name}.png"
        drawn.convert("RGB").save(path, optimize=True)
        size = path.stat().st_size
        print(f"{path.name}: {size // 1000} kB" + (" (too large)" if size > LARGEST else ""))


if __name__ == "__main__":
    main(sys.argv[1:])
