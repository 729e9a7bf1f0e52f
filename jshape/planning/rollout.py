"""What a sequence of actions brings, predicted: a plan that somebody else made (host)."""

from collections.abc import Iterable, Sequence

import jax
import numpy as np

from jshape import actions as rectangles
from jshape import metric
from jshape._typing import ArrayLike
from jshape.actions import PlacedAction
from jshape.errors import BadBank, BadPosition, JShapeError, UnknownName, quoted
from jshape.models.bank import Bank
from jshape.planning.apply import after_action
from jshape.planning.plan import Plan, successive
from jshape.planning.problem import DEEPEST
from jshape.planning.search.base import Status


def predict_sequence(
    bank: Bank,
    image: np.ndarray,
    goal: np.ndarray,
    acts: Sequence[PlacedAction],
    status: Status,
    tolerance: float = 0.0,
    evaluations: int = 0,
    seen: np.ndarray | None = None,
    carries: Sequence[tuple[int, int]] = (),
) -> Plan:
    """The plan of a sequence: each action predicted on what the ones before it left.

    ROIs are moved inwards where they would leave the image, the exact places stay.

    Args:
      bank: predicts.
      image: (H, W) weighed image I before.
      goal: (H, W) the image wanted.
      acts: in their order.
      status: why the sequence ends, unless the distance left is at most `tolerance`.
      tolerance: see `status`.
      evaluations: of the search that found it.
      seen: (H, W) pixels that distances count; None: all.
      carries: actions that are pairs: what the first takes out the second brings.
    """
    first, image = image, image.copy()
    centres, rois, offsets, patches, clipped = [], [], [], [], []
    for act in acts:
        hand = bank.placed(bank.actions.index(act.action), act.yaw or None, act.length)
        roi = w, h = hand.roi
        low = np.array([w // 2, h // 2])
        room = np.array([bank.camera.width - w, bank.camera.height - h])
        centre = np.clip(np.rint(act.position).astype(np.int32), low, low + room)
        offset = (act.position - centre).astype(np.float32)
        offset[np.abs(offset) < 1e-3] = 0
        left, top = corner = (centre - low).astype(np.int32)
        moved = offset if offset.any() else None
        patch, share = jax.device_get(after_action(hand, image, corner, act.strength, moved))
        image[top : top + h, left : left + w] = patch
        centres.append(centre)
        rois.append(roi)
        offsets.append(offset)
        patches.append(patch)
        clipped.append(float(share))
    positions = np.array(centres, np.int32).reshape(-1, 2)
    sizes = np.array(rois, np.int32).reshape(-1, 2)
    images = successive(first, tuple(patches), rectangles.first_pixels(positions, sizes))
    distances = np.array([metric.distance(image, goal, seen) for image in images], np.float32)
    return Plan(
        camera=bank.camera,
        actions=tuple(act.action for act in acts),
        positions=positions,
        rois=sizes,
        distances=distances,
        status=Status.CONVERGED if distances[-1] <= tolerance else status,
        evaluations=evaluations,
        strengths=np.array([act.strength for act in acts], np.float32),
        yaws=np.array([act.yaw for act in acts], np.float32),
        lengths=np.array([act.length for act in acts], np.float32),
        strokes=_strokes(bank, acts, carries),
        offsets=np.array(offsets, np.float32).reshape(-1, 2),
        clipped=np.array(clipped, np.float32),
        spreads=_spreads(bank, acts),
        initial=first,
        goal=goal,
        patches=tuple(patches),
        seen=seen,
    )


def _spreads(bank: Bank, acts: Sequence[PlacedAction]) -> np.ndarray:
    """(K, 2) laws of their intervals, as `Plan.spreads`."""
    if bank.intervals is None:
        return np.full((len(acts), 2), np.nan, np.float32)
    rows = [bank.actions.index(act.action) for act in acts]
    return np.asarray(bank.intervals)[np.array(rows, int)]


def _strokes(
    bank: Bank, acts: Sequence[PlacedAction], carries: Sequence[tuple[int, int]]
) -> np.ndarray:
    """(K, 2) displacements as `Plan.strokes`."""
    camera, found = bank.camera, np.zeros((len(acts), 2), np.float32)
    named = [(bank.actions[take], bank.actions[bring]) for take, bring in carries]
    depth = (float(camera.z_min) + float(camera.z_max)) / 2
    scale = np.array([float(f) for f in camera.scale(depth)])
    for k, act in enumerate(acts):
        path = 1e-3 * bank.predictor(act.action).path_mm * act.length
        found[k] = path * scale * (np.cos(act.yaw), np.sin(act.yaw))
        if k + 1 < len(acts) and (act.action, acts[k + 1].action) in named:
            found[k] = np.subtract(acts[k + 1].position, act.position)
    return found


def placed_actions(
    bank: Bank,
    actions: Iterable[str] | Iterable[PlacedAction],
    positions: ArrayLike | None = None,
    strengths: ArrayLike | None = None,
    yaws: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
) -> list[PlacedAction]:
    """A sequence as people give it, by `rollout`'s arguments, checked.

    Raises:
      UnknownName: an action that the bank does not have.
      BadPosition: a place outside the image, or not as many as actions.
      BadBank: a turned hand for a bank whose predictors cannot be turned.
      JShapeError: strengths, yaws or lengths that make no sense.
    """
    given = list(actions)
    if placed := [act for act in given if isinstance(act, PlacedAction)]:
        if any(more is not None for more in (positions, strengths, yaws, lengths)):
            raise JShapeError("positions, strengths, yaws and lengths go with names of actions")
        positions, strengths = [act.position for act in placed], [act.strength for act in placed]
        yaws, lengths = [act.yaw for act in placed], [act.length for act in placed]
    names = [act.action if isinstance(act, PlacedAction) else act for act in given]
    for name in names:
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
    count = len(names)
    where = np.asarray([] if positions is None else positions, np.float64).reshape(-1, 2)
    if len(where) != count:
        raise BadPosition(f"{len(where)} positions for {count} actions; one (u, v) each is needed")
    height, width = bank.camera.shape
    for u, v in where.tolist():
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            raise BadPosition(f"position ({u:g}, {v:g}) is outside the {width}x{height} image")
    deep, turns, long = (
        np.full(count, usual) if each is None else np.asarray(each, np.float64).ravel()
        for each, usual in ((strengths, 1.0), (yaws, 0.0), (lengths, 1.0))
    )
    for what, values in (("lengths", long), ("strengths", deep)):
        if values.size != count or not ((values > 0) & (values <= DEEPEST)).all():
            raise JShapeError(
                f"{what} are {values.tolist()}; {count} numbers above 0, at most {DEEPEST}, are "
                "needed"
            )
    if turns.size != count or not np.isfinite(turns).all():
        raise JShapeError(f"yaws are {turns.tolist()}; {count} numbers in radians are needed")
    if turns.any() and not bank.turns:
        raise BadBank(f"a bank of kind {quoted(bank.kind)} cannot turn the hand; yaws must be 0")
    placed = [
        PlacedAction(name, (u, v), *how)
        for name, (u, v), *how in zip(
            names, *(of.tolist() for of in (where, deep, turns, long)), strict=True
        )
    ]
    for act in placed:
        w, h = bank.placed(bank.actions.index(act.action), act.yaw or None, act.length).roi
        if w > width or h > height:
            raise BadPosition(
                f"{act.action}: ROI {w}x{h} is larger than the {width}x{height} image"
            )
    return placed
