"""The paper's six shaping problems: planned with f_D and f_P, carried out without looking again.

Four goals are made by the robot's hand and two by a human's; the robot of the simulator carries
the plans out.  For the human's goals the predictors have learned from the human, as in the paper;
what the robot's own make of them is beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.experiments import open_loop, pages
from benchmarks.experiments.open_loop import Method, Outcome
from benchmarks.experiments.problems import Applied
from benchmarks.experiments.robot import ACTIONS, AGENTS, problem
from benchmarks.experiments.samples import Asked, pairs_of
from benchmarks.experiments.shaping_figures import Candidate, Tree, outcomes_figure, tree_figure
from jshape import metric, sim
from jshape.io import banks
from jshape.learn.fit import fit
from jshape.planning import candidates as places
from jshape.planning.evaluate import candidates_at, sweep
from jshape.planning.state import search_state
from jshape.robot.simulated import SimulatedWorld

FIGURES = ("shaping.png", "tree.png")
GRID, DENSE = "15 places", "dense"
TRIED: dict[str, dict[str, Any]] = {
    GRID: {"positions": "paper"},
    DENSE: {"stride": 8, "strengths": [0.5, 1.0, 1.6]},
}
"""Where actions are tried: at the paper's places at the depth they were trained with, or not."""
LEAST_MM = {GRID: 0.0, DENSE: open_loop.MIN_GAIN_MM}
"""What an action must gain: in the paper anything."""
PROBLEMS = {True: (0, 4), False: tuple(range(len(AGENTS)))}
"""If quick: one goal of each hand; if not: all six."""
PAIRS = {True: 4, False: 25}
"""Simulated pairs per action that the human's f_D is fitted to."""
SHOWN = 4
"""Candidates of each step in the picture of the search tree."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Plan the six goals with each predictor and carry the plans out.

    Args:
      out: folder of the result.
      asked: quick: two problems on the paper's places only, and few pairs for the human's f_D.

    Returns:
      What `results.json` holds: a row per problem and method.

    Raises:
      BadFile: the folder holds something else, or cannot be written.
    """
    pages.check(out, asked.overwrite, FIGURES)
    numbers = PROBLEMS[asked.quick]
    tried = {where: TRIED[where] for where in ((GRID,) if asked.quick else TRIED)}
    known = methods({AGENTS[n] for n in numbers}, PAIRS[asked.quick], asked.seed, tried)
    rows, mine, names, trees = [], [], [], []
    for number in asked.progress(numbers, len(numbers), "shaping"):
        agent = AGENTS[number]
        told = outcomes(
            asked.seed, number, [e for e in known if agent == "human" or _who(e) == agent]
        )
        name = f"{number + 1}, by a {agent}"
        rows += [{"problem": number + 1, "goal_by": agent} | outcome.row for outcome in told]
        own = [outcome for outcome in told if _who(outcome.method) == agent]
        shown = next(s for s in own if (s.method.predictor, s.method.where) == ("f_P", GRID))
        names.append(name)
        mine.append((shown, own))
        trees.append(tree(shown))
        asked.say(f"problem {name}: {shown.row['applied']}; f_P planned {shown.row['planned']}, "
            f"{shown.row['before_mm']:.2f} -> {shown.row['obtained_mm']:.2f} mm")  # fmt: skip
    starts = [float(shown.plan.distances_mm[0]) for shown, _ in mine]
    result = pages.Result(
        title="Six shaping problems: planned, predicted, obtained",
        paragraphs=words(rows),
        rows=rows,
        tables=[means(rows), each(rows)],
        pictures=[
            pages.Picture(
                FIGURES[0],
                partial(outcomes_figure, names, *([one[k] for one in mine] for k in (0, 1))),
                "Each problem with f_P on the paper's 15 places, learned from the hand that made "
                "the goal; lighter is higher, counted from the end of the camera's "
                "range. Right: d as each plan predicts it (dashed) and as the camera then saw it.",
            ),
            pages.Picture(
                FIGURES[1], partial(tree_figure, names, starts, trees),
                f"What the greedy search chose among (f_P, 15 places): the {SHOWN} best actions of "
                "each step with their places (u, v) in pixels and the predicted d. The path taken "
                "is bold; it ends where no action lowers d.",
            ),
        ],
        settings={"problems": [n + 1 for n in numbers], "seed": asked.seed,
                  "actions": list(ACTIONS), "places": tried, "least gain (mm)": LEAST_MM,
                  "pairs per action of the human's f_D": PAIRS[asked.quick]},
        notes=[
            "A planned action counts as retrieved if one of the same type was applied within 10 mm "
            "of its place; order and depth do not count. "
            + open_loop.noise_in_words(problem(asked.seed, 0, AGENTS[0])[0]),
            "The robot is the simulator's hand. `python -m benchmarks.experiments robot` does the "
            "same in the physics twin, looking after each action.",
        ],
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def _who(method: Method) -> str:
    """Whose actions a method has learned from."""
    return method.trained_on.split(",")[0]


def methods(
    agents: set[str], pairs: int, seed: int, tried: Mapping[str, dict[str, Any]] = TRIED
) -> list[Method]:
    """F_D and f_P on the grid and densely, learned from the robot, and from the human if asked."""
    found = []
    for agent in ("robot", *sorted(agents - {"robot"})):
        plain = (
            banks.load_bank("flour-robot")
            if agent == "robot"
            else fit(pairs_of(None, seed=seed, count=pairs, actions=ACTIONS, agents=(agent,)), "D")
        )
        for predictor, bank in (("f_D", plain), ("f_P", open_loop.pressed_bank("flour", agent))):
            few = open_loop.with_actions(bank, ACTIONS)
            found += [
                Method(predictor, few, f"{agent}, flour", where, options, LEAST_MM[where])
                for where, options in tried.items()
            ]
    return found


def outcomes(seed: int, number: int, known: Sequence[Method]) -> list[Outcome]:
    """One problem, planned by each method and carried out by the robot's hand, always the same."""
    bed, wanted, applied = problem(seed, number, AGENTS[number])
    return shaped(seed + number, bed, wanted, applied, known)


def shaped(
    seed: int, bed: sim.Bed, wanted: sim.Bed, applied: Sequence[Applied], known: Sequence[Method]
) -> list[Outcome]:
    """What each method makes of a bed that is to become another one."""
    start, goal = open_loop.looked_at(2 * seed, bed), open_loop.looked_at(2 * seed + 1, wanted)
    return [
        open_loop.told(method, start, goal, applied, SimulatedWorld(jax.random.key(seed), bed))
        for method in known
    ]


def tree(outcome: Outcome, count: int = SHOWN) -> Tree:
    """The best candidates at each step of a plan on given places, and after its last one."""
    plan, bank, camera = outcome.plan, outcome.method.bank, outcome.plan.camera
    where = places.placed_positions(bank, outcome.method.tried["positions"])
    state = _state(bank, plan.initial, plan.goal)
    candidates = candidates_at(state, bank, where)
    layers = []
    for step in range(len(plan) + 1):
        found = []
        for number, changes in enumerate(sweep(state, candidates)):
            first = candidates.of_move(number)
            at = candidates.of_move(number, candidates.pixels)
            after = plan.distances_mm[step] + np.asarray(metric.to_mm(changes[:, 0], camera))
            name = bank.actions[state.moves[number].action]
            for node, (u, v), d in zip(first, at.tolist(), after.tolist(), strict=True):
                taken = step < len(plan) and (plan.actions[step], *plan.positions[step].tolist())
                found.append((Candidate(name, (u, v), d, taken == (name, u, v)), number, node))
        # The chosen one first, should rounding have put its equal before it.
        found.sort(key=lambda one: (not one[0].chosen, one[0].distance_mm))
        layers.append(tuple(candidate for candidate, *_ in found[:count]))
        best, number, node = found[0]
        if best.chosen:  # on the search's own map: images made from it are rounded
            now = state.act(number, state.now, jnp.asarray(node), jnp.float32(1))
            state = replace(state, now=now)
    return layers


_state = jax.jit(search_state)


def means(rows: Sequence[dict[str, Any]]) -> pages.Table:
    """Means over the problems, per method."""
    lines = []
    for goal_by, trained_on, predictor, where in dict.fromkeys(map(_group, rows)):
        mine = [row for row in rows if _group(row) == (goal_by, trained_on, predictor, where)]
        lines.append((
            goal_by, trained_on, predictor, where, f"{_mean(mine, 'before_mm'):.2f}",
            f"{_mean(mine, 'predicted_mm'):.2f}", f"{_mean(mine, 'obtained_mm'):.2f}",
            f"{100 * _mean(mine, 'retrieved'):.0f} %",
            f"{sum(row['exact'] for row in mine)} of {len(mine)}",
            f"{sum(row['falls'] for row in mine)} of {len(mine)}",
        ))  # fmt: skip
    head = ("goal by", "learned from", "predictor", "tried", "d before", "predicted", "obtained",
            "retrieved", "nothing else planned", "d falls at each step")  # fmt: skip
    return pages.Table("Means over the problems (mm)", head, lines)


def each(rows: Sequence[dict[str, Any]]) -> pages.Table:
    """Every problem and method."""
    head = ("problem", "applied", "learned from", "predictor", "tried", "planned", "d before",
            "predicted", "obtained", "retrieved")  # fmt: skip
    lines = [
        (str(row["problem"]), row["applied"], row["trained_on"], row["predictor"], row["places"],
         row["planned"], f"{row['before_mm']:.2f}", f"{row['predicted_mm']:.2f}",
         f"{row['obtained_mm']:.2f}", f"{100 * row['retrieved']:.0f} %")
        for row in rows
    ]  # fmt: skip
    return pages.Table("Each problem (d in mm)", head, lines)


def words(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        "Grasp, knock and poke were each applied once to a levelled bed of flour. From the images "
        "before and after, Algorithm 1 plans which actions lead from one to the other, and the "
        "robot carries the plan out without looking again. In the paper all applied actions were "
        "found in all six problems, and the distance fell at each step.",
    ]
    own = [row for row in rows if row["trained_on"].startswith(row["goal_by"])]
    for where in dict.fromkeys(row["places"] for row in own):
        said = []
        for predictor in ("f_D", "f_P"):
            mine = [r for r in own if (r["predictor"], r["places"]) == (predictor, where)]
            said.append(
                f"{predictor} retrieves {100 * _mean(mine, 'retrieved'):.0f} % of the actions "
                f"({sum(r['exact'] for r in mine)} of {len(mine)} plans have nothing else) and "
                f"leaves {_mean(mine, 'obtained_mm'):.2f} of {_mean(mine, 'before_mm'):.2f} mm "
                f"({_mean(mine, 'predicted_mm'):.2f} predicted); d falls at each step in "
                f"{sum(r['falls'] for r in mine)}"
            )
        text.append(f"Tried: {where}. {'. '.join(said)}.")
    left = {
        agent: _mean([r for r in own if r["goal_by"] == agent], "obtained_left")
        for agent in dict.fromkeys(row["goal_by"] for row in rows)
    }
    listed = ", ".join(f"{100 * share:.0f} % for goals of the {a}" for a, share in left.items())
    text.append(f"Of the distance is left, over all of these: {listed}.")
    others = [row for row in rows if row not in own]
    for where in dict.fromkeys(row["places"] for row in others):
        mine, theirs = (
            100 * _mean([r for r in found if (r["places"], r["goal_by"]) == (where, "human")],
                        "obtained_left")
            for found in (others, own)
        )  # fmt: skip
        text.append(
            f"The same goals of the human, tried {where}, with predictors that learned from the "
            f"robot, which carries the plan out: {mine:.0f} % is left, instead of {theirs:.0f} %."
        )
    return text


def _group(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return row["goal_by"], row["trained_on"], row["predictor"], row["places"]


def _mean(rows: Sequence[dict[str, Any]], name: str) -> float:
    return float(np.mean([row[name] for row in rows])) if rows else float("nan")
