"""Many goals and beds at once (host)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape._typing import ArrayLike
from jshape.errors import JShapeError
from jshape.height_map import HeightMap
from jshape.models.bank import Bank
from jshape.planning.api import plan, plan_of, problem_of
from jshape.planning.devices import Execution
from jshape.planning.inputs import as_bank, images_of
from jshape.planning.options import Constraints, SearchBudget, SearchSpace, StopCriteria, hinted
from jshape.planning.plan import Plan
from jshape.planning.search.base import SearchProblem
from jshape.planning.search.greedy import search_each


@hinted
def plan_batch(
    I0s: ArrayLike | HeightMap | Sequence[ArrayLike | HeightMap],
    Istars: ArrayLike | HeightMap | Sequence[ArrayLike | HeightMap],
    *,
    bank: Bank | str | Path | None = None,
    planner: str = "greedy",
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    budget: SearchBudget = SearchBudget(),
    start: Sequence[Plan | None] | None = None,
    execution: Execution = Execution(),
) -> list[Plan]:
    """The plans that `jshape.plan` makes of many pairs of images, made at once.

    Greedy searches of images without a budget go side by side: on a CPU on all its cores, on an
    accelerator vmapped, as many as its memory holds.  What is compiled serves any number of goals.
    Other planners, searches with a budget, height maps and devices that share the places are
    planned one after the other, as by `jshape.plan`.

    Args:
      I0s: (B, H, W) weighed images I of the beds now, or a sequence of images or height maps; one
        (H, W) or one map is the bed of every goal.
      Istars: likewise the images wanted.
      bank: as for `jshape.plan`, like all below.
      planner: which search.
      space: what is tried.
      constraints: what is allowed.
      stop: when each sequence ends.
      budget: what each search may spend.
      start: B earlier plans, or None for some.
      execution: chunks and devices to evaluate candidates with; changes no result.

    Returns:
      B plans; the `seconds` of each are its share of the whole.

    Raises:
      JShapeError: not as many beds as goals; all else as for `jshape.plan`.
    """
    beds, goals = _listed(I0s), _listed(Istars)
    counts = {len(many) for many in (beds, goals, start) if many is not None}
    if len(counts) > 1:
        many = f"{_count(beds)} beds, {_count(goals)} goals"
        many += "" if start is None else f" and {len(start)} plans to start with"
        raise JShapeError(f"{many} were given; as many of each are needed, or one bed or goal")
    count = counts.pop() if counts else 1
    bank = as_bank(bank)
    pairs = [
        (I0s if beds is None else beds[k], Istars if goals is None else goals[k])
        for k in range(count)
    ]
    on_maps = any(isinstance(one, HeightMap) for pair in pairs for one in pair)
    whole = planner == "greedy" and budget == SearchBudget() and execution.mesh is None
    if on_maps or not whole:
        starts = start or [None] * count
        return [
            plan(
                *pair, bank=bank, planner=planner, space=space, constraints=constraints, stop=stop,
                budget=budget, start=one, execution=execution,
            )
            for pair, one in zip(pairs, starts, strict=True)
        ]  # fmt: skip
    images: list[tuple[np.ndarray, np.ndarray]] = []
    problems: list[SearchProblem] = []
    carries = ()
    for k, pair in enumerate(pairs):
        _, first, goal, _ = images_of(bank, *pair, (f"I0s[{k}]", f"Istars[{k}]"))
        problem, carries = problem_of(
            bank, first, goal, None, planner, space, constraints, stop, budget,
            execution=execution, like=problems[0] if problems else None,
        )  # fmt: skip
        images.append((first, goal))
        problems.append(problem)
    if not problems:
        return []
    found = jax.device_get(search_each(problems))
    share = problems[0].budget.elapsed / count
    plans = [
        plan_of(bank, *both, None, problem, one, carries)
        for both, problem, one in zip(images, problems, found, strict=True)
    ]
    return [replace(one, seconds=share) for one in plans]


def _listed(images: Any) -> list[Any] | None:
    """Many images; None of a single one."""
    if isinstance(images, HeightMap) or getattr(images, "ndim", 3) == 2:
        return None
    return list(images)


def _count(many: Sequence[Any] | None) -> int:
    return 1 if many is None else len(many)
