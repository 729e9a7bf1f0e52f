"""The main job: an image and a goal in, a plan out.

Thin host wrappers: they check what came, turn names into arrays, call one compiled search and
read its answer.  Nothing is compiled anew for another image, goal, least gain or tolerance, nor for
other positions, strengths or reachable masks that fit into the same storage (`evaluate.PLACES`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape._typing import ArrayLike, Bool
from jshape.actions import PlacedAction
from jshape.camera import Camera
from jshape.data.depth import check_unit, to_metres
from jshape.data.view import View
from jshape.errors import BadCamera, JShapeError, UnknownName, quoted
from jshape.height_map import HeightMap
from jshape.models.bank import Bank
from jshape.planning import candidates as places
from jshape.planning import problem as tasks
from jshape.planning.devices import Execution
from jshape.planning.inputs import (
    as_bank,
    check_image,
    check_records,
    images_of,
    search_inputs,
    weighed,
)
from jshape.planning.maps import outside_domain, over_beds
from jshape.planning.options import (
    Constraints,
    SearchBudget,
    SearchSpace,
    StopCriteria,
    hinted,
)
from jshape.planning.plan import Plan
from jshape.planning.rollout import placed_actions, predict_sequence
from jshape.planning.search import PLANNERS
from jshape.planning.search.base import SearchProblem, SearchResult, Status


@hinted
def plan(
    I0: ArrayLike | HeightMap,
    Istar: ArrayLike | HeightMap,
    *,
    bank: Bank | str | Path | None = None,
    planner: str = "greedy",
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    budget: SearchBudget = SearchBudget(),
    start: Plan | None = None,
    execution: Execution = Execution(),
) -> Plan:
    """The sequence of actions that molds image I0 into Istar, as the bank predicts it.

    Single fields of the four records: `plan(I0, Istar, **jshape.options(max_steps=4, yaws=1))`;
    the paper's search: `plan(I0, Istar, **jshape.PAPER)`.

    Args:
      I0: (H, W) weighed image I of the bed now (see `jshape.weigh`), floats in [0, 1]; or its
        height map, with which no camera is needed.
      Istar: (H, W) the image wanted; or its height map, whose grid may be another one.
      bank: a `Bank`, the name of a bundled one or a folder; None is the bundled default.
      planner: which search (docs/planning.md says which when).
      space: what is tried.
      constraints: what is allowed; `max_missing` is for `plan_depth`.
      stop: when the sequence ends.
      budget: what the search may spend.
      start: an earlier plan for about the same images, which `careful` and `refine` begin with
        instead of a search of greedy's own.
      execution: chunks and devices to evaluate candidates with; changes no result.

    Raises:
      BadImage: wrong shape, type, range, or pixels without a reading.
      BadPosition: a ROI leaves the image.
      BadBank: several yaws for a bank whose predictors cannot be turned; an error margin with one
        that does not know its errors.
      UnknownName: no such planner, bank or action.
      BadOption: a keyword that there is not.
      JShapeError: a number that makes no sense.
    """
    bank, first, goal, seen = images_of(as_bank(bank), I0, Istar, ("I0", "Istar"))
    return plan_images(
        bank, first, goal, seen, planner=planner, space=space, constraints=constraints, stop=stop,
        budget=budget, start=start, execution=execution,
    )  # fmt: skip


def plan_images(
    bank: Bank,
    first: np.ndarray,
    goal: np.ndarray,
    seen: np.ndarray | None,
    *,
    planner: str = "greedy",
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    budget: SearchBudget = SearchBudget(),
    start: Plan | None = None,
    execution: Execution = Execution(),
) -> Plan:
    """`plan` of images (H, W) that are checked, of which only pixels that were `seen` count."""
    records = space, constraints, stop, budget
    problem, pairs = problem_of(
        bank, first, goal, seen, planner, *records, start=start, execution=execution
    )
    found = jax.device_get(PLANNERS[planner](problem))
    planned = plan_of(bank, first, goal, seen, problem, found, pairs)
    return replace(planned, seconds=problem.budget.elapsed)


def problem_of(
    bank: Bank,
    first: np.ndarray,
    goal: np.ndarray,
    seen: np.ndarray | None,
    planner: str,
    space: SearchSpace,
    constraints: Constraints,
    stop: StopCriteria,
    budget: SearchBudget,
    *,
    start: Plan | None = None,
    execution: Execution = Execution(),
    like: SearchProblem | None = None,
) -> tuple[SearchProblem, tuple[tuple[int, int], ...]]:
    """What a planner is asked, by `plan`'s options; and the actions that are tried in pairs.

    `like` is the problem of other images, with the same bank and options: they share a budget.
    """
    if planner not in tuple(PLANNERS):
        raise UnknownName("planner", planner, PLANNERS)
    if start is not None and not isinstance(start, Plan):
        raise JShapeError(f"start is a {type(start).__name__}; it must be a Plan")
    check_records(space, constraints, stop, budget)
    known = None if like is None else (like.state, like.candidates)
    records = space, constraints, stop
    state, candidates, limits, pairs = search_inputs(
        bank, first, goal, seen, planner, *records, known
    )
    max_steps = int(stop.max_steps)
    stride = places.usual_stride(bank) if space.stride is None else space.stride
    problem = SearchProblem(
        state=state,
        candidates=candidates,
        limits=limits,
        max_steps=max_steps,
        budget=tasks.budget(budget) if like is None else like.budget,
        fine=tasks.rounds(state, stride) if space.positions is None else 0,
        start=None if start is None else tasks.as_found(start, state, bank, max_steps),
        execution=execution,
    )
    return problem, pairs


def plan_of(
    bank: Bank,
    first: np.ndarray,
    goal: np.ndarray,
    seen: np.ndarray | None,
    problem: SearchProblem,
    found: SearchResult,
    pairs: tuple[tuple[int, int], ...],
) -> Plan:
    """The plan of what a search found.

    The search's own distances are sums of changes, which drift by rounding, and on the ground.
    """
    planned = predict_sequence(
        bank, first, goal, _acts(found, problem, bank), Status(int(found.status)),
        float(problem.limits.tolerance), int(found.evaluations), seen, pairs,
    )  # fmt: skip
    notes = () if seen is None else outside_domain(first, goal, bank.camera, seen)
    return replace(planned, notes=notes)


def _acts(found: SearchResult, problem: SearchProblem, bank: Bank) -> list[PlacedAction]:
    """The moves that a search found, at their exact places."""
    candidates, acts = problem.candidates, []
    first, pixels = np.asarray(candidates.first), np.asarray(candidates.pixels)
    usable, of = np.asarray(candidates.valid), np.asarray(candidates.move)
    mine = [usable & (of == number) for number in range(len(problem.state.moves))]
    for k in range(int(found.steps)):
        number = int(found.move[k])
        move = problem.state.moves[number]
        exact = problem.state.pixel(found.node[k])[::-1]
        known = first[mine[number]] + move.middle
        same = np.flatnonzero((known == found.node[k]).all(1))
        if same.size:  # a given place, not the node beside it
            exact = pixels[mine[number]][same[0]]
        u, v = np.asarray(exact).tolist()
        yaw = tasks.half_turn(float(move.yaw) + float(found.turn[k]))
        how = float(found.strength[k]), yaw, float(move.length) * float(found.stretch[k])
        acts.append(PlacedAction(bank.actions[move.action], (u, v), *how))
    return acts


def rollout(
    I0: ArrayLike,
    Istar: ArrayLike,
    actions: Iterable[str] | Iterable[PlacedAction],
    positions: ArrayLike | None = None,
    *,
    strengths: ArrayLike | None = None,
    yaws: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
    bank: Bank | str | Path | None = None,
    seen: Bool[np.ndarray, "H W"] | None = None,
) -> Plan:
    """What a given sequence of actions brings, as the bank predicts it.  Eq. predStep1 to 3.

    Args:
      I0: (H, W) weighed image I of the bed now, floats in [0, 1].
      Istar: (H, W) the image wanted.
      actions: K names, in their order; or K `PlacedAction`s, such as a plan, which say their
        positions, strengths, yaws and lengths themselves.
      positions: (K, 2) of (u, v), pixels, fractions allowed; a ROI that leaves the image is moved
        inwards, the place stays.
      strengths: (K,) how many times as deep as trained; None is 1.
      yaws: (K,) turns of the hand from u towards v, radians; None is 0.
      lengths: (K,) how many times as long as trained the hand's paths are; None is 1.
      bank: as for `plan`.
      seen: (H, W) pixels that distances count; None: all.

    Raises:
      BadImage, UnknownName, BadPosition, BadBank, JShapeError: as for `plan`.
    """
    bank = as_bank(bank)
    first = check_image(I0, bank.camera, "I0")
    goal = check_image(Istar, bank.camera, "Istar")
    acts = placed_actions(bank, actions, positions, strengths, yaws, lengths)
    pairs = tasks.carries(bank, None)
    return predict_sequence(bank, first, goal, acts, Status.PLAN_ENDED, seen=seen, carries=pairs)


@hinted
def plan_depth(
    z0: ArrayLike,
    zstar: ArrayLike,
    *,
    camera: Camera | tuple[Camera, Camera] | None = None,
    depth_unit: float = 0.001,
    bank: Bank | str | Path | None = None,
    planner: str = "greedy",
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    budget: SearchBudget = SearchBudget(),
) -> Plan:
    """`plan` from raw depth images: metres as floats, or uint16 counts of `depth_unit` metres.

    Depth 0, NaN or infinity is "no reading": such pixels are filled from their surroundings, and
    the plan's `filled` says how many.  The luminance keeps fractions of a level, so that a bed
    seen in 16 bits is not rounded to the 256 levels of the paper's camera.

    To plan on a part of the frames, as `--window` does, set both frames to NaN beyond it.

    Args:
      z0: (H, W) depth of the bed now.
      zstar: (H, W) the depth wanted.
      camera: that took the frames, or (that of z0, that of zstar); None is the bank's own.  If the
        bank's image is a window of this camera's, and the bed in its range, it is cut out.  A bed
        that any other camera sees is looked at from straight above: its plane and extent are found
        in z0, and what is hidden does not count.  Of two cameras without poses both planes are
        taken to be the same.  `plan.camera_positions` are the positions in the camera's own pixels.
      depth_unit: metres per count of integer images.
      bank: as for `plan`, like all below.
      planner: which search.
      space: what is tried.
      constraints: what is allowed, `max_missing` among it.
      stop: when the sequence ends.
      budget: what the search may spend.

    Raises:
      MissingDepth: too many pixels without a reading.
      BadCamera: the bank is for another camera.
      BadImage: wrong shape or type, or too much of it beyond the camera's depth range.
      JShapeError: as for `plan`.
    """
    bank, frames, views = as_bank(bank), [z0, zstar], (None, None)
    names = "z0", "zstar"
    if camera is not None:
        pair = camera if isinstance(camera, tuple) else (camera, camera)
        for one in pair:
            if not isinstance(one, Camera):
                raise BadCamera(f"camera is {quoted(one)}; expected a Camera or two of them")
        frames = [
            check_unit(
                to_metres(depth, depth_unit, name),
                one,
                name,
                None if np.asarray(depth).dtype.kind == "f" else depth_unit,
            )
            for depth, one, name in zip((z0, zstar), pair, names, strict=True)
        ]
        *views, bank = over_beds(bank, pair, frames, names)
    return plan_views(
        bank, frames, views, names, depth_unit=depth_unit, planner=planner, space=space,
        constraints=constraints, stop=stop, budget=budget,
    )  # fmt: skip


def plan_views(
    bank: Bank,
    frames: Sequence[ArrayLike],
    views: Sequence[View | None],
    names: Sequence[str],
    *,
    depth_unit: float = 0.001,
    constraints: Constraints = Constraints(),
    **more: Any,
) -> Plan:
    """`plan_depth` of two frames whose views (see `over_beds`) and names in errors are known."""
    now, wanted, seen = weighed(bank, frames, views, names, depth_unit, constraints.max_missing)
    found = plan_images(
        bank, now.image, wanted.image, seen, constraints=constraints.of_images(), **more
    )
    filled, clamped = (now.filled, wanted.filled), (now.clamped, wanted.clamped)
    return replace(found, filled=filled, clamped=clamped, view=views[0])
