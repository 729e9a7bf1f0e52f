"""What a plan or a limit is asked for: the bank, the images and the search, checked (host)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jshape._typing import ArrayLike, Bool
from jshape.camera import Camera, unmasked
from jshape.data.view import Seen, View, image_of_depth, known_in_both
from jshape.errors import BadBank, BadImage, JShapeError
from jshape.height_map import HeightMap
from jshape.models.bank import Bank
from jshape.planning import candidates as places
from jshape.planning import problem as tasks
from jshape.planning.evaluate import Candidates, candidates_at
from jshape.planning.kernels import prepared
from jshape.planning.maps import on_maps
from jshape.planning.options import DEFAULT_BANK, GROUPS, Constraints, SearchSpace, StopCriteria
from jshape.planning.search.base import SearchLimits
from jshape.planning.state import SearchState, on_images


def as_bank(bank: Bank | str | Path | None) -> Bank:
    """A bank, checked; of a name or folder the one there, of None the default.

    Raises:
      BadBank: not a predictor per action.
    """
    if isinstance(bank, Bank):
        if not bank.actions or len(bank.actions) != len(bank.predictors):
            raise BadBank(
                f"the bank has {len(bank.actions)} actions and {len(bank.predictors)} predictors; "
                "it must have one per action"
            )
        return bank
    from jshape.io.banks import load_bank

    return load_bank(DEFAULT_BANK if bank is None else bank)


def images_of(
    bank: Bank, now: Any, wanted: Any, names: tuple[str, str]
) -> tuple[Bank, np.ndarray, np.ndarray, Bool[np.ndarray, "H W"] | None]:
    """Two weighed images or height maps, checked: (bank, now, wanted, pixels that count)."""
    if isinstance(now, HeightMap) or isinstance(wanted, HeightMap):
        return on_maps(now, wanted, bank)
    first, goal = (
        check_image(i, bank.camera, n) for i, n in zip((now, wanted), names, strict=True)
    )
    return bank, first, goal, None


def check_records(*records: Any) -> None:
    """Refuse what is not the option record of its place: space, constraints, stop, budget."""
    for (name, kind), record in zip(GROUPS.items(), records, strict=False):
        if not isinstance(record, kind):
            raise JShapeError(f"{name} is a {type(record).__name__}; it must be {kind.__name__}")


def check_image(image: ArrayLike, camera: Camera, where: str) -> np.ndarray:
    """`image` as (H, W) float32 if it is a weighed image of the camera (a host check).

    Raises:
      BadImage: naming what came and what is allowed.
    """
    array = np.asarray(unmasked(image))
    if array.shape != camera.shape and array.dtype.kind in "buif":
        raise BadImage(
            f"{where} has shape {array.shape}; the bank's camera makes {camera.shape} "
            "(rows, columns)"
        )
    if array.dtype.kind != "f":
        raise BadImage(
            f"{where} has type {array.dtype}; a weighed image I has floats in [0, 1] "
            "(see jshape.weigh; for raw depth call jshape.plan_depth)"
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


def weighed(
    bank: Bank,
    frames: Sequence[ArrayLike],
    views: Sequence[View | None],
    names: Sequence[str],
    depth_unit: float,
    max_missing: float,
) -> tuple[Seen, Seen, Bool[np.ndarray, "H W"] | None]:
    """The images of two frames, and which pixels count; where they do not, the goal is the bed."""
    now, wanted = (
        image_of_depth(
            depth,
            bank.camera,
            view=view,
            depth_unit=depth_unit,
            max_missing=max_missing,
            where=name,
        )
        for name, depth, view in zip(names, frames, views, strict=True)
    )
    if views[0] is None or not views[0].above:
        return now, wanted, None
    seen = known_in_both(now.known, wanted.known, *names)
    return now, wanted._replace(image=np.where(seen, wanted.image, now.image)), seen


def search_inputs(
    bank: Bank,
    first: np.ndarray,
    goal: np.ndarray,
    seen: np.ndarray | None,
    planner: str,
    space: SearchSpace,
    constraints: Constraints,
    stop: StopCriteria,
    like: tuple[SearchState, Candidates] | None = None,
) -> tuple[SearchState, Candidates, SearchLimits, tuple[tuple[int, int], ...]]:
    """Where a planner works, what it may try and must keep to, and the actions tried in pairs.

    `like` is the state and the candidates of other images, with the same bank and options.
    """
    constraints.refuse(["max_missing"], "plan takes weighed images; plan_depth reads depth")
    pairs = tasks.carries(bank, space.carries)
    feigned = tasks.feigned(bank, first, goal, seen) if stop.min_gain_mm is None else 0.0
    limits = tasks.limits(bank, stop, constraints.max_uses, pairs, feigned)
    if like is not None:
        moves = like[0].moves, like[0].kernels
    else:
        turned = tasks.directions(bank, space.yaws, space.lengths, pairs)
        moves = prepared(
            bank, [(a, np.float32(y) if y else None, length) for a, y, length in turned]
        )
    state = on_images(bank, first, goal, *moves, seen)
    stocked = constraints.stock_cm3 is not None
    if planner != "greedy" and stocked:
        raise JShapeError(f"stock_cm3: only greedy uses a stock, and the planner is {planner}")
    worth = tasks.price(state) if pairs and not stocked else None
    state = replace(state, carries=pairs, price=worth)
    limits = replace(limits, stock=tasks.stock(state, constraints))
    if like is not None:
        return state, like[1], limits, pairs
    free = places.reachable(bank.camera, constraints.reachable, constraints.clearance_mm)
    if space.positions is None:
        stride = places.usual_stride(bank) if space.stride is None else space.stride
        where = tasks.at_nodes(state, bank, places.dense_positions(bank, stride))
    else:
        where = places.placed_positions(bank, space.positions, space.out_of_bounds)
    strengths = tasks.strengths(space.strengths)
    return state, candidates_at(state, bank, where, strengths, free), limits, pairs
