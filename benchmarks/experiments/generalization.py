"""What the paper tried on kinetic sand: five actions, uneven beds, overlapping and deep actions.

A human's hand makes the goals and carries out the plans; predictors that have learned from the
human's flour or sand plan with all five actions at the paper's 21 places.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.experiments import open_loop, pages
from benchmarks.experiments.generalization_figures import examples_figure, left_figure
from benchmarks.experiments.open_loop import Method, Outcome
from benchmarks.experiments.problems import Applied
from benchmarks.experiments.samples import Asked
from jshape import actions, sim
from jshape.camera import PAPER_BOX
from jshape.robot.simulated import SimulatedWorld

FIGURES = ("left.png", "examples.png")
AGENT = "human"
"""Whose hand makes the goals and carries out the plans."""
COUNT = {True: 1, False: 6}
"""Problems of each situation: if quick, and if not."""
PAIRS = {True: 3, False: 20}
"""Simulated pairs per action that each f_D is fitted to."""
DEEPER = (2.0, 2.9)
"""How many times as deep as usual: in the paper 19.6 for 6.8 mm and 17.05 for 7.05 mm."""
STRENGTHS = (0.5, 1.0, 1.6, 2.3)
"""What "any depth" tries."""
HILLS = {"level": 0.001, "irregular": 0.008, "curved": 0.001}
"""Standard deviation of the bed's height about its shape, metres."""
RADII = (0.15, -0.15)
"""Of the dome and the bowl in turn, metres; the paper's was about 0.15."""


class Situation(NamedTuple):
    """What is new about a problem."""

    name: str
    material: str
    bed: str
    """One of `HILLS`."""
    overlapping: bool = False
    """Two actions at neighbouring places."""
    deeper: bool = False
    """Two of the actions go deeper than any that was learned from at strength 1."""


SITUATIONS = (
    Situation("level flour", "flour", "level"),
    Situation("level sand", "sand", "level"),
    Situation("curved sand", "sand", "curved"),
    Situation("irregular sand", "sand", "irregular"),
    Situation("overlapping", "sand", "irregular", overlapping=True),
    Situation("deeper", "sand", "irregular", deeper=True),
)
"""The paper's five experiments are the last four kinds; the first two are where they start from."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Plan problems of each situation with each predictor and carry the plans out.

    Args:
      out: folder of the result.
      asked: quick: one problem of each situation, three predictors, few pairs for f_D.

    Returns:
      What `results.json` holds: a row per situation, problem and predictor.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    pages.check(out, asked.overwrite, FIGURES)
    known, count = methods(asked.quick, asked.seed), COUNT[asked.quick]
    cells = [(situation, k) for situation in SITUATIONS for k in range(count)]
    rows, examples = [], {}
    for situation, k in asked.progress(cells, len(cells), "generalization"):
        told = outcomes(asked.seed, k, situation, known)
        rows += [
            {"situation": situation.name, "problem": k + 1, "name": outcome.method.where}
            | outcome.row
            for outcome in told
        ]
        if k == 0:
            examples[situation.name] = told
            asked.say(f"{situation.name}: {told[0].row['applied']}")
    names = [method.where for method in known]
    bed = sim.irregular_bed(jax.random.key(asked.seed), HILLS["irregular"])
    result = pages.Result(
        title="Five actions, other material, uneven beds, overlapping and deeper actions",
        paragraphs=words(rows, names),
        rows=rows,
        tables=[table("Applied actions that the plan has", rows, names, "retrieved"),
                table("Left of d when carried out", rows, names, "obtained_left"),
                table("Left of d as predicted", rows, names, "predicted_left"),
                table("Plans with what was applied and nothing else", rows, names, "exact"),
                each(rows)],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(left_figure, rows, [s.name for s in SITUATIONS], names),
                "Means over the problems of each situation. Top: plans with all that was applied "
                "and nothing else. Bottom: what is left of the distance to the goal after the plan "
                "was carried out; the mark is what was predicted.",
            ),
            pages.Picture(
                FIGURES[1], partial(examples_figure, examples, ("f_D sand", "f_P sand")),
                "The first problem of each situation; lighter is higher, counted from the end of "
                "the camera's range. Right: d as predicted (dashed) and as obtained each time.",
            ),
        ],
        settings={"problems of each situation": count, "seed": asked.seed, "hand": AGENT,
                  "places": 21, "pairs per action of f_D": PAIRS[asked.quick],
                  "strengths of 'any depth'": list(STRENGTHS), "deeper": list(DEEPER)},
        notes=[
            "A planned action counts as retrieved if one of the same type was applied within 10 mm "
            "of its place; order and depth do not count. "
            + open_loop.noise_in_words(bed),
            "f_P has learned from 200 pairs per action of several depths on uneven beds, f_D from "
            f"{PAIRS[asked.quick]} of the usual depth on the same kinds of bed. "
            "Unlike the paper, plans are carried out: by the hand that made the goal.",
        ],
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def methods(quick: bool, seed: int) -> list[Method]:
    """f_D and f_P of flour and of sand, at the paper's 21 places, and f_P of sand at any depth."""
    places = {"positions": actions.grid(PAPER_BOX, 7, 3)}
    found = []
    for material in ("sand",) if quick else ("flour", "sand"):
        bank = open_loop.mean_bank(material, AGENT, PAIRS[quick], seed)
        found.append(Method("f_D", bank, f"{AGENT}, {material}", f"f_D {material}", places, 0.0))
    for material in ("flour", "sand"):
        bank = open_loop.pressed_bank(material, AGENT)
        found.append(Method("f_P", bank, f"{AGENT}, {material}", f"f_P {material}", places, 0.0))
    if not quick:
        tried = places | {"strengths": STRENGTHS}
        found.append(replace(found[-1], where="f_P sand, any depth", tried=tried,
                             least_mm=open_loop.MIN_GAIN_MM))  # fmt: skip
    return found


def outcomes(seed: int, k: int, situation: Situation, known: Sequence[Method]) -> list[Outcome]:
    """One problem planned by each method and carried out by the human's hand, always the same."""
    bed, wanted, applied = problem(seed, k, situation)
    number = 1000 * seed + 10 * k
    start = open_loop.looked_at(number, bed, situation.material)
    goal = open_loop.looked_at(number + 1, wanted, situation.material)
    return [
        open_loop.told(
            method, start, goal, applied,
            SimulatedWorld(
                jax.random.key(number + 2), bed, material=situation.material, agent=AGENT
            ),
        )
        for method in known
    ]  # fmt: skip


def problem(seed: int, k: int, situation: Situation) -> tuple[sim.Bed, sim.Bed, list[Applied]]:
    """A bed, the bed that is wanted, and the three actions that made it from a copy."""
    rng = np.random.default_rng([seed, SITUATIONS.index(situation), k])
    for_bed, for_hand = jax.random.split(jax.random.key(int(rng.integers(2**31))))
    bed = sim.irregular_bed(for_bed, std=HILLS[situation.bed])
    if situation.bed == "curved":  # low enough for the camera's range
        curved = sim.curved_bed(RADII[k % 2], crown=0.008, drop=0.014)
        bed = sim.loose_bed(bed.height + curved.height - sim.DEPTH)
    applied = drawn(rng, situation)
    other = SimulatedWorld(for_hand, bed, material=situation.material, agent=AGENT)
    for action in applied:
        other.act(*action)
    return bed, other.bed, applied


def drawn(rng: np.random.Generator, situation: Situation) -> list[Applied]:
    """Three different actions at the paper's 21 places: apart, or the first two side by side."""
    names = [str(name) for name in rng.permutation(list(sim.ACTIONS))]
    strengths = [1.0, 1.0, 1.0]
    if situation.deeper:
        others = [name for name in names if name not in ("knock", "poke")]
        names = ["knock", "poke", others[0]]
        strengths[:2] = rng.uniform(*DEEPER, size=2).tolist()
    columns, rows = rng.permutation([0, 3, 6]), rng.integers(3, size=3)
    if situation.overlapping:
        columns[1] = columns[0] + (1 if columns[0] < 3 else -1)
        rows[1] = rows[0]
    places = actions.grid(PAPER_BOX, 7, 3)
    found = []
    for name, column, row, strength in zip(names, columns, rows, strengths, strict=False):
        u, v = places[7 * row + column].tolist()
        found.append(Applied(name, (u, v), strength, 0.0))
    return found


def table(
    title: str, rows: Sequence[dict[str, Any]], names: Sequence[str], what: str
) -> pages.Table:
    """Means of one column, a line per situation and a column per predictor."""
    lines = []
    for situation in dict.fromkeys(row["situation"] for row in rows):
        cells = [mean(rows, what, situation=situation, name=name) for name in names]
        lines.append((situation, *(f"{100 * cell:.0f} %" for cell in cells)))
    means = [mean(rows, what, name=name) for name in names]
    lines.append(("all", *(f"{100 * cell:.0f} %" for cell in means)))
    return pages.Table(title, ("situation", *names), lines)


def each(rows: Sequence[dict[str, Any]]) -> pages.Table:
    """Every problem and predictor."""
    head = ("situation", "applied", "predictor", "planned", "d before", "predicted", "obtained")
    lines = [
        (f"{row['situation']} {row['problem']}", row["applied"], row["name"], row["planned"],
         f"{row['before_mm']:.2f}", f"{row['predicted_mm']:.2f}", f"{row['obtained_mm']:.2f}")
        for row in rows
    ]  # fmt: skip
    return pages.Table("Each problem (d in mm)", head, lines)


def words(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> list[str]:
    """What is seen, from the numbers."""

    def said(name: str, **where: str) -> str:
        return (
            f"{name} has {100 * mean(rows, 'retrieved', name=name, **where):.0f} % of them in its "
            f"plan (nothing else in {100 * mean(rows, 'exact', name=name, **where):.0f} % of the "
            f"plans) and leaves {100 * mean(rows, 'obtained_left', name=name, **where):.0f} % of d"
        )

    text = [
        "A human's hand applied three of five actions. From the images before and after, each "
        "predictor plans with all five at 21 places, and the same hand carries the plan out. In "
        "the paper networks found type, place and number in four of five such experiments, f_D in "
        "none; where the human had gone deeper, two actions on top of each other were planned.",
        "Over all situations: " + "; ".join(said(name) for name in names) + ".",
    ]
    for situation in SITUATIONS[-2:]:
        listed = "; ".join(said(name, situation=situation.name) for name in names)
        text.append(f"{situation.name.capitalize()} actions: {listed}.")
    return text


def mean(rows: Sequence[dict[str, Any]], what: str, **where: str) -> float:
    """Mean of a column over the rows with some values; NaN if there are none."""
    found = [row[what] for row in rows if all(row[key] == value for key, value in where.items())]
    return float(np.mean(found)) if found else float("nan")
