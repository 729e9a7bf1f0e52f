"""The main job: an image and a goal in, a plan out.

Thin host wrappers: they check what came, turn names into arrays, call one compiled search and
read its answer.  Nothing is compiled anew for another image, goal, place, least gain or tolerance;
another `max_steps`, or another number of places, is another shape.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape._typing import Array, ArrayLike
from jshape.camera import Camera, unmasked
from jshape.data.depth import check_unit, to_metres
from jshape.data.view import View, image_of_depth, view_beside, view_of
from jshape.errors import BadBank, BadCamera, BadImage, JShapeError, UnknownName, quoted
from jshape.models.bank import Bank
from jshape.planning import candidates as places
from jshape.planning import problem as tasks
from jshape.planning.evaluate import ONE_BY_ONE, How, candidates_at
from jshape.planning.plan import Plan
from jshape.planning.rollout import Act, check_acts, predict_acts
from jshape.planning.search import PLANNERS
from jshape.planning.search.base import Found, Status, Task
from jshape.planning.state import Terrain, terrain_of

DEFAULT_BANK = "pressed-flour-robot"
MAX_STEPS = 1000
"""Most actions of a plan: the predicted ROI of each has its place in memory from the start."""


def plan(
    I0: ArrayLike,
    Istar: ArrayLike,
    *,
    bank: Bank | str | Path | None = None,
    planner: str = "greedy",
    positions: ArrayLike | Mapping[str, ArrayLike] | str | None = None,
    stride: int | None = None,
    strengths: Sequence[float | int] = (1.0,),
    yaws: int | Mapping[str, int] = 1,
    max_steps: int = 16,
    min_gain: float = 0.0,
    tolerance: float = 0.0,
    caution: float = 0.0,
    clip: str = "refuse",
    reach: ArrayLike | None = None,
    clearance_mm: float = 0.0,
    most: Mapping[str, int] | None = None,
    seconds: float | None = None,
    evaluations: int | None = None,
    seed: int = 0,
    start: Plan | None = None,
    how: How = ONE_BY_ONE,
) -> Plan:
    """The sequence of actions that molds image I0 into Istar, as the bank predicts it.

    Args:
      I0: (H, W) weighed image I of the bed now (see `jshape.weigh`), floats in [0, 1].
      Istar: (H, W) the image wanted.
      bank: a `Bank`, the name of a bundled one or a folder; None is the bundled default.
      planner: which search (docs/planning.md says which when).
      positions: (N, 2) of (u, v) ROI centres for all actions, a mapping of action to such, or a
        grid "21x15" (columns x rows) that spans the image for each action; None is the paper's
        grid of 15, the same for all actions.
      stride: instead of positions, every so many pixels along u and v; the best of them are then
        moved, and their strengths changed, in smaller and smaller steps.
      strengths: how many times as deep as trained each action is tried.
      yaws: directions of the hand over half a turn, for all actions or each; 1 is the trained one
        alone.
      max_steps: most actions in the plan.
      min_gain: an action must lower d by more than this.
      tolerance: stop when d is at most this.
      caution: an action must also gain more than this many times its own usual error.
      clip: what to do with given positions whose ROI leaves the image: "refuse", "shift", "drop".
      reach: (H, W), not 0 where the hand may be placed; None is everywhere.
      clearance_mm: least distance of places to the image's edge and to what `reach` leaves out.
      most: how often each action may be used.
      seconds: the search stops about then with the best it has; compiling is not counted.
      evaluations: the search stops after so many predictions with the best it has.
      seed: for `mcts`, which draws.
      start: an earlier plan for about the same images, which `refine` and `improve` begin with if
        it is better than greedy's.
      how: chunks and devices to evaluate candidates with; changes no result.

    Raises:
      BadImage: wrong shape, type, range, or pixels without a reading.
      BadPosition: a ROI leaves the image.
      BadBank: several yaws for a bank whose predictors cannot be turned; caution with one that
        does not know its errors.
      UnknownName: no such planner, bank or action.
      JShapeError: a number that makes no sense.
    """
    bank = _as_bank(bank)
    first = check_image(I0, bank.camera, "I0")
    goal = check_image(Istar, bank.camera, "Istar")
    if planner not in tuple(PLANNERS):
        raise UnknownName("planner", planner, PLANNERS)
    if not isinstance(max_steps, int | np.integer) or not 0 <= max_steps <= MAX_STEPS:
        raise JShapeError(
            f"max_steps is {quoted(max_steps)}; it must be a whole number to {MAX_STEPS}"
        )
    numbers = {"min_gain": min_gain, "tolerance": tolerance, "caution": caution}
    for name, value in numbers.items():
        if not isinstance(value, int | float | np.number) or not 0 <= value < np.inf:
            raise JShapeError(f"{name} is {quoted(value)}; it must be a number from 0")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**32:
        raise JShapeError(
            f"seed is {quoted(seed)}; it must be a whole number from 0 to {2**32 - 1}"
        )
    if start is not None and not isinstance(start, Plan):
        raise JShapeError(f"start is a {type(start).__name__}; it must be a Plan")
    if positions is not None and stride is not None:
        raise JShapeError("positions and stride are both given; one says where actions are tried")
    free = places.reachable(bank.camera, reach, clearance_mm)
    turned = tasks.directions(bank, yaws)
    terrain = _terrain(bank, first, goal, np.array([yaw for _, yaw in turned], np.float32),
                       moves=tuple((a, yaw != 0) for a, yaw in turned))  # fmt: skip
    if stride is None:
        where = places.placed_positions(bank, positions, clip)
    else:
        where = tasks.at_nodes(terrain, bank, places.dense_positions(bank, stride))
    where = places.within(where, free)
    task = Task(
        terrain=terrain,
        candidates=candidates_at(terrain, bank, where, tasks.strengths(strengths), free),
        limits=tasks.limits(bank, min_gain, tolerance, caution, most),
        max_steps=int(max_steps),
        budget=tasks.budget(seconds, evaluations),
        fine=tasks.rounds(terrain, stride),
        key=jax.random.key(seed),
        start=None if start is None else tasks.as_found(start, terrain, bank, int(max_steps)),
        how=how,
    )
    found = jax.device_get(PLANNERS[planner](task))
    spent = task.budget.elapsed
    # The search's own distances are sums of changes, which drift by rounding, and on the ground.
    planned = predict_acts(
        bank, first, goal, _acts(found, task), Status(int(found.status)), float(tolerance),
        int(found.evaluations),
    )  # fmt: skip
    return replace(planned, seconds=spent)


def _acts(found: Found, task: Task) -> list[Act]:
    """The moves that a search found, at their exact places."""
    acts = []
    for k in range(int(found.steps)):
        number = int(found.move[k])
        move = task.terrain.moves[number]
        exact = task.terrain.pixel(found.node[k])[::-1]
        known = np.asarray(task.candidates.first[number]) + move.middle
        same = np.flatnonzero((known == found.node[k]).all(1))
        if same.size:  # a given place, not the node beside it
            exact = np.asarray(task.candidates.pixels[number])[same[0]]
        acts.append(Act(move.action, np.asarray(exact), found.strength[k], float(move.yaw)))
    return acts


def rollout(
    I0: ArrayLike,
    Istar: ArrayLike,
    actions: Sequence[str],
    positions: ArrayLike,
    *,
    strengths: ArrayLike | None = None,
    yaws: ArrayLike | None = None,
    bank: Bank | str | Path | None = None,
) -> Plan:
    """What a given sequence of actions brings, as the bank predicts it.  Eq. predStep1 to 3.

    Args:
      I0: (H, W) weighed image I of the bed now, floats in [0, 1].
      Istar: (H, W) the image wanted.
      actions: K names, in their order.
      positions: (K, 2) of (u, v), pixels, fractions allowed; a ROI that leaves the image is moved
        inwards, the place stays.
      strengths: (K,) how many times as deep as trained; None is 1.
      yaws: (K,) turns of the hand from u towards v, radians; None is 0.
      bank: as for `plan`.

    Raises:
      BadImage, UnknownName, BadPosition, BadBank, JShapeError: as for `plan`.
    """
    bank = _as_bank(bank)
    first = check_image(I0, bank.camera, "I0")
    goal = check_image(Istar, bank.camera, "Istar")
    acts = check_acts(bank, actions, positions, strengths, yaws)
    return predict_acts(bank, first, goal, acts, Status.PLAN_ENDED)


@partial(jax.jit, static_argnames=["moves"])
def _terrain(
    bank: Bank, image: Array, goal: Array, yaws: Array, *, moves: tuple[tuple[int, bool], ...]
) -> Terrain:
    turned = [(a, yaws[k] if turn else None) for k, (a, turn) in enumerate(moves)]
    return terrain_of(bank, image, goal, turned)


def plan_depth(
    z0: ArrayLike,
    zstar: ArrayLike,
    *,
    bank: Bank | str | Path | None = None,
    camera: Camera | tuple[Camera, Camera] | None = None,
    reproject: bool = False,
    depth_unit: float = 0.001,
    max_missing: float = 0.1,
    names: tuple[str, str] = ("z0", "zstar"),
    **options: Any,
) -> Plan:
    """`plan` from raw depth images: metres as floats, or uint16 counts of `depth_unit` metres.

    Depth 0, NaN or infinity is "no reading": such pixels are filled from their surroundings, and
    the plan's `filled` says how many.  The luminance keeps fractions of a level, so that a bed
    seen in 16 bits is not rounded to the 256 levels of the paper's camera.

    Args:
      z0: (H, W) depth of the bed now.
      zstar: (H, W) the depth wanted.
      bank: as for `plan`.
      camera: that took the frames, or (that of z0, that of zstar); None is the bank's own.  If the
        bank's image is a window of this camera's, it is cut out.
      reproject: see the frames of another camera, or from another distance, as the bank's camera
        would.  `plan.camera_positions` are the places in the camera's own pixels.  Of two cameras
        the middles of both beds are taken to be equally high.
      depth_unit: metres per count of integer images.
      max_missing: largest share of pixels without a reading that may be filled.
      names: what to call the two images in errors.
      **options: passed on to `plan`.

    Raises:
      MissingDepth: too many pixels without a reading.
      BadCamera: the bank is for another camera.
      BadImage: wrong shape or type, or too much of it beyond the camera's depth range.
    """
    bank = _as_bank(bank)
    views: tuple[View | None, View | None] = (None, None)
    if camera is not None:
        pair = camera if isinstance(camera, tuple) else (camera, camera)
        for one in pair:
            if not isinstance(one, Camera):
                raise BadCamera(f"camera is {quoted(one)}; expected a Camera or two of them")
        first, last = (
            check_unit(to_metres(depth, depth_unit, name), one, name)
            for depth, one, name in zip((z0, zstar), pair, names, strict=True)
        )
        view = view_of(pair[0], bank.camera, first, reproject=reproject, where=names[0])
        seen = view.depth(first, names[0])
        beside = view_beside(view, seen, pair[1], last, reproject=reproject, where=names[1])
        views = view, beside
    now, wanted = (
        image_of_depth(
            depth,
            bank.camera,
            view=view,
            depth_unit=depth_unit,
            max_missing=max_missing,
            where=name,
        )
        for name, depth, view in zip(names, (z0, zstar), views, strict=True)
    )
    return replace(
        plan(now.image, wanted.image, bank=bank, **options),
        filled=(now.filled, wanted.filled),
        clamped=(now.clamped, wanted.clamped),
        view=views[0],
    )


def check_image(image: ArrayLike, camera: Camera, where: str) -> np.ndarray:
    """`image` as (H, W) float32 if it is a weighed image of the camera (a host check).

    Raises:
      BadImage: naming what came and what is allowed.
    """
    array = np.asarray(unmasked(image))
    if array.dtype.kind != "f":
        raise BadImage(
            f"{where} has type {array.dtype}; a weighed image I has floats in [0, 1] "
            "(see jshape.weigh; for raw depth call jshape.plan_depth)"
        )
    if array.shape != camera.shape:
        raise BadImage(
            f"{where} has shape {array.shape}; the bank's camera makes {camera.shape} "
            "(rows, columns)"
        )
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        raise BadImage(
            f"{where} has {bad} pixels that are NaN or infinite; fill them first "
            "(jshape.plan_depth does)"
        )
    low, high = float(array.min()), float(array.max())
    if low < 0 or high > 1 + 1e-5:
        raise BadImage(f"{where} has values from {low:g} to {high:g}; a weighed image is in [0, 1]")
    return np.ascontiguousarray(array, np.float32)


def _as_bank(bank: Bank | str | Path | None) -> Bank:
    if isinstance(bank, Bank):
        if not bank.actions or len(bank.actions) != len(bank.predictors):
            raise BadBank(
                f"the bank has {len(bank.actions)} actions and {len(bank.predictors)} predictors; "
                "it must have one per action"
            )
        return bank
    from jshape.io.banks import load_bank

    return load_bank(DEFAULT_BANK if bank is None else bank)
