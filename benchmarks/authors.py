"""Plans beside the reference twin, and beside the way the authors compute them."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jshape
from benchmarks import growth
from benchmarks.growth import in_rounds
from benchmarks.plan_as_authors import FULL_IMAGE_PASSES, AuthorsPlan, authors_way
from benchmarks.planning import network_bank, smooth_bank
from benchmarks.problems import Problem, half_size, made_problem
from benchmarks.report import Report
from jshape.actions import PAPER_ROIS
from jshape.data.simulate import ROIS
from jshape.planning.candidates import dense_positions
from jshape.planning.evaluate import candidates_at, sweep
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.plan import Plan
from jshape.planning.state import search_state

SPREAD = (0.6, 1.4)
"""How deep the goals' actions are: no two gain alike, so that rounding decides nothing."""


def steps_of(problem: Problem, plan: Plan) -> list[tuple[int, int]]:
    """Numbers of (action, place) of a plan's steps; of places given twice the first."""
    actions = [problem.bank.actions.index(name) for name in plan.actions]
    return [
        (a, int(np.flatnonzero((problem.places[name] == spot).all(1))[0]))
        for a, name, spot in zip(actions, plan.actions, plan.positions, strict=True)
    ]


@dataclass
class Agreement:
    """How often two ways chose alike; stopping is a choice too."""

    decided: int = 0
    """Choices that 8-bit rounding cannot change."""
    decided_alike: int = 0
    choices: int = 0
    """All choices that were made on the same images up to rounding."""
    alike: int = 0

    def compare(self, problem: Problem, max_steps: int) -> None:
        """Plan a problem both ways, and compare choice by choice up to the first other one."""
        plan, theirs = problem.ours(max_steps), authors_way(problem, max_steps)
        ours = [*steps_of(problem, plan), None][:max_steps]
        for k, choice in enumerate(ours):
            other = theirs.steps[k] if k < len(theirs.steps) else None
            wrong = np.abs(theirs.images[k] - plan.images[k])
            decided = rounding_cannot_decide(problem, plan.images[k], wrong)
            self.decided += decided
            self.decided_alike += decided and choice == other
            self.choices += 1
            self.alike += choice == other
            if choice != other:
                return


def rounding_cannot_decide(problem: Problem, image: np.ndarray, wrong: np.ndarray) -> bool:
    """Whether the best choice stays the best in any image that is at most `wrong` (H, W) off.

    f_D moves every pixel by itself and clipping brings no two farther apart, so an action changes
    what is wrong inside its window by at most twice as much.  Outside the windows of two candidates
    both are as wrong.  So neither passes the other if their d differ by more than twice the sum of
    `wrong` over both windows, divided by the image's pixels.  One choice is to stop: no window.
    """
    state = search_state(problem.bank, jnp.asarray(image), jnp.asarray(problem.images[1]))
    candidates = candidates_at(state, problem.bank, problem.places)
    changes = [np.zeros(1), *(np.asarray(change).ravel() for change in sweep(state, candidates))]
    total = np.pad(wrong.cumsum(0, dtype=np.float64).cumsum(1), ((1, 0), (1, 0)))
    inside = [np.zeros(1)]
    for number, move in enumerate(state.moves):
        first = candidates.of_move(number)
        (top, left), (bottom, right) = first.T, (first + move.shape).T
        sums = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
        inside.append(sums / wrong.size)
    change, doubt = np.concatenate(changes), 2 * np.concatenate(inside)
    best = change.argmin()
    needed = change[best] + doubt[best] + doubt + 1e-7  # which sums of float32 may be off
    return bool(np.delete(change > needed, best).all())


def run(report: Report, out: Path) -> None:
    _same_plans(report)
    _settings(report)
    growth.curves(report, out)


def _same_plans(report: Report, problems: int = 16) -> None:
    """Half-size beds with noise, and goals of six actions that are not quite as trained."""
    camera, rois = half_size()
    bank = smooth_bank(rois, camera)
    agreement = Agreement()
    for seed in range(problems):
        places = dict.fromkeys(rois, jshape.grid(camera, margin=bank.largest_roi))
        made = made_problem(bank, places, 6, strengths=(0.5, 1.5), noise=2.0, seed=seed)
        agreement.compare(made, 8)
    same = agreement.decided_alike / agreement.decided
    report.add("same choice as the authors' way where rounding cannot decide", same, "", goal=1,
               more=True, tolerance=1)  # fmt: skip
    report.add("such choices", agreement.decided, "", more=True, tolerance=1.05)
    report.add("same choice as the authors' way, all choices", agreement.alike / agreement.choices,
               "", more=True, tolerance=1.05)  # fmt: skip
    report.add("all choices", agreement.choices, "")


def _settings(report: Report) -> None:
    """Whole plans at the sizes of the paper, all ways in turns."""
    box = jshape.PAPER_BOX
    half, rois = half_size()
    three, five = smooth_bank(PAPER_ROIS), smooth_bank(ROIS)
    pressed = jshape.load_bank(DEFAULT_BANK)
    paper, more = jshape.grid(box), jshape.grid(box, 7, 3)
    small = smooth_bank(rois, half)
    middle = np.array([[half.width // 2, half.height // 2]])
    few = made_problem(small, dict.fromkeys(rois, middle), 1)
    usual = made_problem(three, dict.fromkeys(PAPER_ROIS, paper), 6, strengths=SPREAD)
    larger = made_problem(five, dict.fromkeys(ROIS, more), 6, strengths=SPREAD)
    dense = made_problem(five, dense_positions(five, 16), 4, strengths=SPREAD)
    ground = made_problem(pressed, dict.fromkeys(pressed.actions, more), 6, strengths=SPREAD)
    settings = [
        ("f_D, 3 candidates on 240x198", few, 1, True),
        ("f_D, 45 candidates", usual, 1, True),
        ("f_D, 45 candidates", usual, 4, True),
        ("f_D, 105 candidates", larger, 1, True),
        ("f_D, 105 candidates", larger, 3, True),
        ("f_D, every 16th pixel", dense, 1, False),
        ("f_P, 105 candidates", ground, 3, False),
    ]  # fmt: skip
    for kind, counts in (("C", (1, 3)), ("CR", (3,))):
        bank = network_bank(PAPER_ROIS, kind)
        made = made_problem(bank, dict.fromkeys(PAPER_ROIS, paper), 4, strengths=SPREAD)
        settings += [(f"f_{kind} (width 8), 45 candidates", made, k, False) for k in counts]
    rows, alike = [], []
    for name, problem, steps, twin in settings:
        plan = problem.ours(steps)
        theirs = authors_way(problem, steps)
        drawn = problem.bank.kind == "D"
        alike.append(theirs.steps == steps_of(problem, plan))
        calls = {
            "ours": lambda p=problem, n=steps: p.ours(n),
            "theirs": lambda p=problem, n=steps: authors_way(p, n),
        }
        if problem.count <= 105 and problem.bank.kind in "DP":
            calls["files"] = lambda p=problem, n=steps: authors_way(p, n, files=True)
        if drawn:
            calls["tuned"] = lambda p=problem, n=steps: authors_way(p, n, tuned=True)
        if twin:
            calls["twin"] = lambda p=problem, n=steps: p.twin(n)
        took = in_rounds(calls, most=0.4)
        times = [f"{1e3 * took[c]:.3g}" if c in took else ""
                 for c in ("ours", "theirs", "tuned", "files", "twin")]  # fmt: skip
        ratio = took["theirs"] / took["ours"]
        rows.append((f"{name}, {_actions(len(plan))}", *times, f"{ratio:.2g}"))
        if problem is larger and steps == 3:
            report.add("authors' way / jshape.plan, 105 candidates, 3 steps", ratio, "times",
                       more=True, tolerance=3)  # fmt: skip
            _work(report, problem, plan, theirs)
        if problem is few:
            report.add("authors' way / jshape.plan, 3 candidates on 240x198", ratio, "times",
                       more=True, tolerance=3)  # fmt: skip
    report.add(f"the same plan both ways, of {len(rows)} settings", sum(alike), "", more=True,
               tolerance=1)  # fmt: skip
    report.table(
        "Whole plans, ms: images in, steps and predicted images out.",
        ("setting", "jshape.plan", "the authors' way", "tuned: float32, cv2.norm",
         "with a PNG per candidate", "reference twin", "authors' way / jshape"),
        rows,
    )  # fmt: skip


def _work(report: Report, problem: Problem, plan: Plan, theirs: AuthorsPlan) -> None:
    """Pixels and bytes that the two ways need for the same plan."""
    evaluated, pixels = problem.evaluated(plan)
    if evaluated != plan.evaluations:
        raise AssertionError(f"counted {evaluated} evaluations, the search {plan.evaluations}")
    times = len(theirs.steps) * problem.count
    rois = sum(
        len(at) * w * h
        for at, (w, h) in zip(problem.places.values(), problem.bank.rois.values(), strict=True)
    )
    whole = 2 * times * problem.pixels  # the image and the goal
    name = f"{problem.count} candidates, {len(plan)} steps"
    report.add(f"candidates evaluated, {name}: jshape", evaluated, "", tolerance=1)
    report.add(f"candidates evaluated, {name}: the authors' way", times, "")
    report.add(f"pixels of image and goal compared, {name}: jshape", 2 * pixels, "",
               tolerance=1.001)  # fmt: skip
    report.add("the authors' way / jshape, pixels compared", whole / (2 * pixels), "times",
               more=True, tolerance=1.01)  # fmt: skip
    # Ours: image and goal, effects stay in cache. Theirs: the ROI is read, changed and put back.
    mine = 4 * 2 * pixels
    other = 8 * (FULL_IMAGE_PASSES * times * problem.pixels + 4 * len(theirs.steps) * rois)
    report.add(
        f"bytes of the search by counting passes, {name}: jshape", mine / 1e6, "MB", tolerance=1.001
    )
    report.add("the authors' way / jshape, bytes by counting passes", other / mine, "times",
               more=True, tolerance=1.01)  # fmt: skip


def _actions(count: int) -> str:
    return f"{count} step" if count == 1 else f"{count} steps"
