"""What one action did, as a predictor sees it: on the nodes of its grid, the hand as trained."""

from typing import NamedTuple

import jax
import numpy as np

from jshape._typing import Array, Float
from jshape.actions import PlacedAction, first_pixels
from jshape.camera import check_same_camera
from jshape.data.missing import fill_nan
from jshape.data.pairs import SAME_PATH, Examples, Pairs
from jshape.errors import BadBank, BadDataset, one_line, quoted
from jshape.learn.imprint import shown_on
from jshape.models.bank import Bank
from jshape.models.imprint import Imprint
from jshape.models.turn import turn

LEAST_SEEN = 0.5
"""Least share of a ROI with readings before and after that a look teaches anything from."""


class Lesson(NamedTuple):
    """What one action did, on the nodes of its predictor's grid, the hand as it was trained."""

    action: int
    before: np.ndarray
    """(rows, columns) surface, metres."""
    after: np.ndarray
    counted: np.ndarray
    """(rows, columns) 1 where it was seen before and after, else 0."""
    strength: float

    def error_mm(self, predictor: Imprint) -> float:
        """Mean |predicted - true| over the nodes that were seen, mm."""
        gap = np.abs(np.asarray(self.left_by(predictor))) * self.counted
        return 1e3 * float(gap.sum() / self.counted.sum())

    def left_by(self, predictor: Imprint) -> Float[np.ndarray, "rows columns"]:
        """True minus predicted change, metres."""
        return self.after - self.before - np.asarray(_change(predictor, self.before, self.strength))


@jax.jit
def _change(predictor: Imprint, before: Array, strength: Array) -> Array:
    return predictor.change(before, strength)


def hand_of(bank: Bank, name: str) -> Imprint:
    """The predictor of an action, which must be an f_P.

    Raises:
      BadBank: it is of another kind.
      UnknownName: the bank has no such action.
    """
    predictor = bank.predictor(name)
    if isinstance(predictor, Imprint):
        return predictor
    raise BadBank(
        f"{one_line(name, 30)}: a predictor of type {type(predictor).__name__} does not learn "
        "while it molds; those of banks of kind 'P' do"
    )


def lesson(
    bank: Bank,
    act: PlacedAction,
    before: Float[np.ndarray, "H W"],
    after: Float[np.ndarray, "H W"],
) -> Lesson:
    """What an action did, from the weighed images I before and after it; NaN = no reading.

    Raises:
      BadDataset: too little of its ROI was seen, or its path was of another length than the bank's.
      UnknownName: the bank has no such action.
    """
    if act.length != 1:
        raise BadDataset(f"a path {act.length:g} times as long teaches nothing about the usual one")
    hand = hand_of(bank, act.action)
    hand = hand.turned(act.yaw) if act.yaw else hand
    w, h = hand.roi
    ((u, v),) = first_pixels(np.rint([act.position]).astype(int), (w, h))
    window = np.s_[max(v, 0) : max(v + h, 0), max(u, 0) : max(u + w, 0)]
    rois = np.full((2, h, w), np.nan, np.float32)
    for roi, image in zip(rois, (before, after), strict=True):
        part = image[window]
        top, left = max(-v, 0), max(-u, 0)
        roi[top : top + part.shape[0], left : left + part.shape[1]] = part
    corner = np.array([[u, v]], np.int32)
    one = Examples(rois[:1], rois[1:], corner, np.array([act.strength], np.float32))
    return _lesson(bank, act.action, one, act.yaw)


def lessons_of(bank: Bank, pairs: Pairs) -> list[Lesson]:
    """The lessons of all pairs whose action the bank has, in their order.

    Raises:
      BadCamera: bank and pairs have different cameras.
      BadDataset: as `lesson`.
    """
    check_same_camera(bank.camera, pairs.camera, "the data set's")
    found = []
    for k, name in enumerate(pairs.action.tolist()):
        if name not in bank.actions:
            continue
        hand = hand_of(bank, name)
        one = pairs.select(np.array([k])).rois(name, hand.roi, padded=True)
        if hand.path_mm and one.path_mm and abs(one.path_mm / hand.path_mm - 1) > SAME_PATH:
            raise BadDataset(f"pair {pairs.id[k]}: its path is {one.path_mm:g} mm long")
        found.append(_lesson(bank, name, one, 0.0))
    return found


def _lesson(bank: Bank, name: str, one: Examples, yaw: float) -> Lesson:
    k = bank.actions.index(name)
    predictor = hand_of(bank, name)
    if not 1e-3 <= float(one.strengths[0]) <= 100:
        raise BadDataset(
            f"{name}: its strength is {quoted(float(one.strengths[0]))}; expected 0.001 to 100"
        )
    share = float(one.seen.mean())
    if share < LEAST_SEEN:
        raise BadDataset(
            f"{name}: {share:.0%} of its ROI was seen before and after; at least {LEAST_SEEN:.0%} "
            "must be"
        )
    prior, posterior = (fill_nan(roi)[None].astype(np.float32) for (roi,) in one[:2])
    whole = Examples(prior, posterior, one.corner, one.strengths)
    shown = shown_on((predictor.turned(yaw) if yaw else predictor).grid, whole, one.seen)
    before, after, counted = (np.asarray(part)[0] for part in shown[:3])
    if yaw:  # back into the hand's own frame
        beside = np.array([before.mean(), after.mean(), 0.0], np.float32)
        fields = np.stack([before, after, counted])
        before, after, counted = np.asarray(turn(fields, -yaw, predictor.grid.shape, beside))
        counted = (counted > 0.5).astype(np.float32)
    return Lesson(k, before, after, counted, float(one.strengths[0]))
