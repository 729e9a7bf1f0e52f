"""The robot's problems as Markdown and as the page of an experiment."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments import pages
from jshape.learn.report import markdown
from jshape.robot.loop import Molding
from jshape.viz import pictures
from jshape.viz.maps import span
from jshape.viz.style import Drawing

FIGURES = ("robot.png", "curves.png")


def table(problems: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows."""
    head = ("problem", "goal by", "applied", "carried out", "d before, then after each action (mm)",
            "first plan predicted", "retrieved")  # fmt: skip
    rows = [
        (
            str(row["problem"]), row["goal_by"], ", ".join(a["action"] for a in row["applied"]),
            ", ".join(row["actions"]), " → ".join(f"{d:.2f}" for d in row["obtained_mm"]),
            f"{row['predicted_mm'][-1]:.2f}", f"{100 * row['retrieved']:.0f} %",
        )
        for row in problems
    ]  # fmt: skip
    return head, rows


def report(content: dict[str, Any]) -> str:
    """The six problems as Markdown."""
    pictures_ = "![initial, wanted, predicted, obtained](robot.png)\n\n![d](curves.png)\n"
    rows = markdown(*table(content["rows"]))
    return f"# Six robot experiments ({content['arm']})\n\n{rows}\n{pictures_}"


def page_of(
    rows: Sequence[dict[str, Any]],
    arm: str,
    figures: tuple[Drawing, Drawing],
    settings: dict[str, Any],
    notes: Sequence[str],
) -> pages.Result:
    """The page: what is seen in words, the figures and the table."""
    captions = (
        "Each problem: the bed at first, the goal, what the first plan predicts with its distance "
        "to the goal, and what was obtained. Lighter is higher.",
        "The distance to the goal that the first plan predicts after each of its actions, and what "
        "the camera saw after each that was carried out; the robot looks and plans anew each time.",
    )
    return pages.Result(
        title="Robot problems: look, plan, act, look again",
        paragraphs=words(rows, arm),
        rows=[_flat(row) for row in rows],
        tables=[pages.Table("Each problem", *table(rows))],
        pictures=[pages.Picture(*one) for one in zip(FIGURES, figures, captions, strict=True)],
        settings=settings,
        notes=notes,
    )


def words(rows: Sequence[dict[str, Any]], arm: str) -> list[str]:
    """What is seen, from the numbers."""
    falls = sum(_falls(row["obtained_mm"]) for row in rows)
    as_there = ", as in the paper" if falls == len(rows) else ""
    found = float(np.mean([row["retrieved"] for row in rows]))
    text = [
        "Grasp, knock and poke were each applied once, apart from one another, to a levelled bed "
        "of flour. From images of the bed and of the goal the robot plans, acts, looks and plans "
        f"again. It is {arm}.",
        f"In {falls} of {len(rows)} problems the distance falls at each step{as_there}; "
        f"{100 * found:.0f} % of the applied actions are in the first plan.",
    ]
    for agent in dict.fromkeys(row["goal_by"] for row in rows):
        mine = [row["obtained_mm"] for row in rows if row["goal_by"] == agent]
        left = float(np.mean([d[-1] / d[0] for d in mine]))
        text.append(f"Goals of the {agent}'s hand: {100 * left:.0f} % of the distance is left.")
    return text


def _falls(obtained: Sequence[float]) -> bool:
    """Whether there was an action, and each lowered the distance."""
    return len(obtained) > 1 and bool((np.diff(obtained) < 0).all())


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    """A row of plain values."""
    applied = ", ".join(f"{a['action']} {tuple(a['position'])}" for a in row["applied"])
    lists = {name: " ".join(f"{d:.4f}" for d in row[name])
             for name in ("predicted_mm", "obtained_mm")}  # fmt: skip
    said = {name: ", ".join(row[name]) for name in ("planned", "actions")}
    return row | {"applied": applied} | lists | said


def strips(outcomes: Sequence[Molding], names: Sequence[str]) -> Figure:
    """Per problem I0, I*, the image predicted by the first plan, and the one obtained."""
    camera = outcomes[0].first_plan.camera
    figure = Figure(figsize=(9.4, 2.1 * len(outcomes)), layout="constrained")
    axes = figure.subplots(len(outcomes), 4, squeeze=False)
    every = [image for outcome in outcomes for image in (*outcome.images, outcome.goal)]
    low, high = span([pictures.height_mm(image, camera) for image in every])
    for number, (line, outcome) in enumerate(zip(axes, outcomes, strict=True)):
        line[0].set_ylabel(names[number], fontsize=9)
        first = outcome.first_plan
        images = {
            "initial": outcome.images[0],
            "wanted": outcome.goal,
            f"predicted, {first.distances_mm[-1]:.2f} mm": first.images[-1],
            f"obtained, {outcome.distances_mm[-1]:.2f} mm": outcome.images[-1],
        }
        for ax, (title, image) in zip(line, images.items(), strict=True):
            height = pictures.height_mm(image, camera)
            shown = ax.imshow(height, cmap="gray", vmin=low, vmax=high)
            ax.set_title(title, fontsize=9)
            ax.set_xticks([])
            ax.set_yticks([])
    label = (
        "height above the end of the camera's range (mm)" if len(outcomes) > 2 else "height (mm)"
    )
    figure.colorbar(shown, ax=axes, label=label, shrink=0.6)
    return figure


def curves(outcomes: Sequence[Molding], titles: Sequence[str]) -> Figure:
    """The distance to the goal after each action, predicted and obtained, per problem."""
    lines = -(-len(outcomes) // 3)
    figure = Figure(figsize=(9.4, 2.9 * lines), layout="constrained")
    axes = figure.subplots(lines, min(3, len(outcomes)), squeeze=False).ravel()
    for ax, outcome, title in zip(axes, outcomes, titles, strict=False):
        pictures.draw_curve(ax, outcome.first_plan.distances_mm, outcome.distances_mm)
        ax.set_title(title, fontsize=9)
    figure.supylabel("distance to the goal (mm)", fontsize=10)
    for ax in axes[len(outcomes) :]:
        ax.set_axis_off()
    return figure
