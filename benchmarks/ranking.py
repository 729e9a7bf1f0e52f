"""Whether a distance falls as the goal nears, and whether greedy on it finds what was applied."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jshape
from benchmarks import metric_pictures
from benchmarks.experiments.metric import seen
from benchmarks.experiments.ranking import CAMERA, HILLS, Distance, distances, rank
from benchmarks.experiments.samples import silent
from benchmarks.metric_words import ratio
from benchmarks.report import Report
from jshape import metric, sim
from jshape.actions import first_pixels, grid
from jshape.data.view import image_of_depth
from jshape.models.bank import Bank
from jshape.planning.apply import after_action
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.simulated import SimulatedWorld

SEED = 0
SEQUENCES, ACTIONS = 8, 6
"""Sequences that are ranked, and how long they are."""
PROBLEMS, APPLIED = 6, 3
"""Goals for greedy, and the actions that made each."""
PLACES = (3, 2)
"""Columns and rows of places where each of the bank's five actions is tried: 30 candidates."""
BED = 0.45
"""Depth of the bed, metres."""


class Problem(NamedTuple):
    """A bed, and what some of the candidates made of it."""

    before: sim.Bed
    after: sim.Bed
    start: np.ndarray
    """I of the bed before, (H, W), with the camera's noise."""
    goal: np.ndarray
    """I of the bed after, too."""
    applied: tuple[tuple[str, int], ...]
    """(action, number of the place), in order."""
    key: Any
    """Of another hand's doing."""


class Greedy(NamedTuple):
    """What greedy on one distance chose."""

    chosen: tuple[tuple[str, int], ...]
    seconds: list[float]
    """Per step, of comparing all candidates' images with the goal."""
    predicting: list[float]
    """Per step, of making those images."""


def run(report: Report, out: Path) -> None:
    ranked, curves = rank(SEED, SEQUENCES, ACTIONS, silent)
    report.table(
        f"Along {SEQUENCES} sequences of {ACTIONS} actions",
        ("distance", "Kendall's tau", "least tau", "actions that lower it", "left at the goal"),
        [
            (row["method"], f"{row['kendall']:.3f}", f"{row['kendall_least']:.2f}",
             f"{100 * row['falls']:.0f} %", f"{100 * row['left_at_goal']:.0f} %")
            for row in ranked
        ],
    )  # fmt: skip
    report.add("Kendall's tau of d with the actions left", ranked[0]["kendall"], "", more=True,
               tolerance=1.02)  # fmt: skip

    bank = jshape.load_bank(DEFAULT_BANK).seen_by(CAMERA, BED)
    places = grid(CAMERA, *PLACES, margin=bank.largest_roi)
    problems = [problem(bank, places, SEED, k) for k in range(PROBLEMS)]
    rows = [score(name, distance, problems, bank, places) for name, distance in compared().items()]
    report.table(
        f"Greedy on each distance, {PROBLEMS} goals of {APPLIED} actions, "
        f"{len(bank.actions) * len(places)} candidates",
        ("distance", "actions found", "goals found whole", "d left when carried out",
         "comparing, per step (ms)", "times d"),
        [
            (row["method"], f"{row['found']} of {PROBLEMS * APPLIED}",
             f"{row['whole']} of {PROBLEMS}", f"{100 * row['left']:.0f} %",
             f"{1e3 * row['seconds']:.3g}", ratio(row["seconds"] / rows[0]["seconds"]))
            for row in rows
        ],
    )  # fmt: skip
    ours = rows[0]
    report.add("greedy on d: actions found", 100 * ours["retrieved"], "%", more=True, tolerance=1.1)
    report.add("greedy on d: left when carried out", 100 * ours["left"], "%", tolerance=1.2)
    report.add("predicting a step's candidates, whole images", 1e3 * ours["predicting"], "ms")
    by_jshape = planned(problems, bank, places)
    report.add("jshape.plan, the same candidates: actions found", 100 * by_jshape["retrieved"],
               "%", more=True, tolerance=1.1)  # fmt: skip
    report.add("jshape.plan: per step, predicting included", 1e3 * by_jshape["seconds"], "ms")
    chance = APPLIED / (len(bank.actions) * len(places))
    figure = metric_pictures.ranking(curves, rows, chance)
    figure.savefig(out / "ranking.png", dpi=110)


def compared() -> Mapping[str, Distance]:
    """The ranked distances; those of images with their factors computed once, without clouds.

    Turning one d into mm with JAX takes ten times as long as d of so small an image.
    """
    weight = np.asarray(metric.r_matrix(CAMERA))
    level_mm = 1e3 * float(CAMERA.z_max - CAMERA.z_min) / CAMERA.top
    whole_mm = float(metric.to_mm(1.0, CAMERA))

    def plain(_: np.random.Generator, a: np.ndarray, b: np.ndarray) -> float:
        return level_mm * float((np.abs(a - b) / weight).mean())

    def d(_: np.random.Generator, a: np.ndarray, b: np.ndarray) -> float:
        return whole_mm * float(metric.distance(a, b))

    return {**distances(), "d": d, "depth difference": plain}


def problem(bank: Bank, places: np.ndarray, seed: int, number: int) -> Problem:
    """Actions of the bank at different places of the grid, by the simulator's varying hand."""
    rng = np.random.default_rng([seed, 8, number])
    for_bed, for_world, key = jax.random.split(jax.random.key(int(rng.integers(2**31))), 3)
    before = sim.irregular_bed(for_bed, HILLS)
    world = SimulatedWorld(for_world, before, camera=CAMERA)

    def look() -> np.ndarray:
        return np.asarray(image_of_depth(world.look(), CAMERA, where="look").image)

    start = look()
    applied = tuple(
        (str(rng.choice(bank.actions)), int(place))
        for place in rng.permutation(len(places))[:APPLIED]
    )
    for name, place in applied:
        u, v = (float(x) for x in places[place])
        world.act(name, (u, v))
    return Problem(before, world.bed, start, look(), applied, key)


def search(task: Problem, distance: Distance, bank: Bank, places: np.ndarray) -> Greedy:
    """Algorithm 1 on any distance: the candidate whose image is nearest to the goal, again.

    It ends after as many steps as were applied, or where no candidate's image is nearer.
    """
    rng = np.random.default_rng(SEED)
    image, now = task.start, distance(rng, task.start, task.goal)
    chosen, comparing, predicting = [], [], []
    for _ in range(APPLIED):
        start = time.perf_counter()
        images = after_each(bank, image, places)
        made = time.perf_counter()
        values = {name: distance(rng, after, task.goal) for name, after in images.items()}
        comparing.append(time.perf_counter() - made)
        predicting.append(made - start)
        best = min(values, key=values.__getitem__)
        if values[best] >= now:
            break
        chosen.append(best)
        image, now = images[best], values[best]
    return Greedy(tuple(chosen), comparing, predicting)


def after_each(
    bank: Bank, image: np.ndarray, places: np.ndarray
) -> dict[tuple[str, int], np.ndarray]:
    """The predicted image of every candidate."""
    found = {}
    for action, name in enumerate(bank.actions):
        w, h = bank.roi(name)
        for place, (left, top) in enumerate(first_pixels(places, (w, h))):
            corner = np.array([left, top], np.int32)
            patch, _ = after_action(bank.predictors[action], image, corner)
            after = image.copy()
            after[top : top + h, left : left + w] = patch
            found[name, place] = after
    return found


def retrieved(chosen: tuple[tuple[str, int], ...], applied: tuple[tuple[str, int], ...]) -> int:
    """How many of the applied actions were chosen, at their places, in any order."""
    return len(set(chosen) & set(applied))  # places differ, so that no action is applied twice


def left(task: Problem, chosen: tuple[tuple[str, int], ...], places: np.ndarray) -> float:
    """Share of d that is left when the chosen actions are carried out, without noise."""
    world = SimulatedWorld(task.key, task.before, camera=CAMERA)
    for name, place in chosen:
        u, v = (float(x) for x in places[place])
        world.act(name, (u, v))
    ended, began = (seen(bed, task.after, CAMERA).d_mm for bed in (world.bed, task.before))
    return ended / began


def score(
    name: str, distance: Distance, problems: list[Problem], bank: Bank, places: np.ndarray
) -> dict[str, Any]:
    """Greedy on one distance over all problems."""
    distance(np.random.default_rng(SEED), problems[0].start, problems[0].goal)  # loads, compiles
    found = [search(task, distance, bank, places) for task in problems]
    return {"method": name} | summary(problems, [one.chosen for one in found], places) | {
        "seconds": float(np.median([t for one in found for t in one.seconds])),
        "predicting": float(np.median([t for one in found for t in one.predicting])),
    }  # fmt: skip


def summary(
    problems: list[Problem], chosen: list[tuple[tuple[str, int], ...]], places: np.ndarray
) -> dict[str, Any]:
    """Actions and whole goals that were found, and what is left, mean of the shares."""
    counts = [retrieved(c, task.applied) for c, task in zip(chosen, problems, strict=True)]
    return {
        "found": sum(counts),
        "whole": counts.count(APPLIED),
        "retrieved": sum(counts) / (APPLIED * len(problems)),
        "left": float(np.mean([left(t, c, places) for t, c in zip(problems, chosen, strict=True)])),
    }


def planned(problems: list[Problem], bank: Bank, places: np.ndarray) -> dict[str, Any]:
    """What `jshape.plan` finds among the same candidates."""

    def plan(task: Problem) -> jshape.Plan:
        return jshape.plan(
            task.start,
            task.goal,
            **jshape.options(jshape.PAPER, bank=bank, positions=places, max_steps=APPLIED),
        )

    for task in problems:  # compiles; an action when it is first in a plan
        plan(task)
    numbers = {tuple(at): k for k, at in enumerate(places.tolist())}
    chosen, took = [], []
    for task in problems:
        start = time.perf_counter()
        found = plan(task)
        took.append((time.perf_counter() - start) / max(len(found), 1))
        where = (numbers[tuple(at)] for at in found.positions.tolist())
        chosen.append(tuple(zip(found.actions, where, strict=True)))
    return summary(problems, chosen, places) | {"seconds": float(np.median(took))}
