"""Actions that are carried out between two looks: none changes what another one changes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jshape import metric
from jshape._typing import Int
from jshape.actions import PlacedAction, first_pixels
from jshape.planning.plan import ROWS, Plan, successive


def batched(plan: Plan, most: int, *, reorder: bool = True) -> tuple[Plan, int]:
    """The plan with those of its actions first that can be done without a look in between.

    A prediction reads and changes its ROI alone.  So an action may be done before earlier ones
    whose ROIs it does not meet: what both bring, and its error, stay the same.  What takes material
    out and what brings it are done together, where they do not meet either.

    Args:
      plan: with its images, unless `most` is 1.
      most: actions in the batch, at most.
      reorder: False takes only the first actions of the plan, in their order.

    Returns:
      The plan, and how many actions the batch has: at least 1 where the plan has any.

    Raises:
      JShapeError: actions change places, and the plan was stored without its images.
    """
    if most == 1 or len(plan) < 2:
        return plan, min(most, len(plan))
    first = first_pixels(plan.positions, plan.rois)
    last = first + plan.rois
    meets: np.ndarray = np.all((first[:, None] < last) & (first < last[:, None]), axis=-1)
    chosen: list[int] = []
    waiting: list[int] = []
    k = 0
    while k < len(plan) and len(chosen) < most:
        unit = [k, k + 1] if plan[k].carries else [k]  # a carry is done whole
        k += len(unit)
        others = chosen + waiting
        apart = not (meets[np.ix_(unit, others)].any() or len(unit) > 1 and meets[k - 2, k - 1])
        if apart and len(chosen) + len(unit) <= most:
            chosen += unit
        elif not reorder:
            break
        else:
            waiting += unit
    if not chosen:  # a carry whose two places meet
        return plan, 1
    return _reordered(plan, chosen + sorted(set(range(len(plan))) - set(chosen))), len(chosen)


def _reordered(plan: Plan, order: list[int]) -> Plan:
    if order == list(range(len(plan))):
        return plan
    first_image, goal = plan.images[0], np.asarray(plan.goal)
    rows = {name: getattr(plan, name)[order] for name in ROWS}
    names = tuple(plan.actions[k] for k in order)
    patches = tuple(plan.patches[k] for k in order)
    firsts = first_pixels(rows["positions"], rows["rois"])
    images = successive(first_image, patches, firsts)
    d = np.array([metric.distance(image, goal, plan.seen) for image in images])
    return replace(plan, actions=names, patches=patches, distances=d, **rows)


def nearest(batch: Sequence[PlacedAction], shape: tuple[int, int]) -> Int[np.ndarray, "H W"]:
    """Which action of a batch each pixel's change is ascribed to: the one with the nearest ROI."""
    v, u = np.ogrid[: shape[0], : shape[1]]
    away = []
    for act in batch:
        assert act.roi is not None
        (x, y), (w, h) = first_pixels(np.rint(act.position).astype(int), act.roi), act.roi
        beside, above = (
            np.maximum(np.maximum(a - p, p - b), 0)
            for p, a, b in ((u, x, x + w - 1), (v, y, y + h - 1))
        )
        away.append(np.hypot(beside, above))
    return np.argmin(np.stack(away), 0)
