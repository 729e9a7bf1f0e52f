"""A bank that learns while it molds, from what each of its own actions did.

The bank to begin with was fitted to another bed or hand.  Three numbers per action correct f_P,

    tool + depth,   give·(1 + give'),   (rest, swell, deep)·(1 + rims'),

mostly alike for all actions, since one hand and one material do them all: with a prior of mean 0,
part of whose variance is shared, they follow from all looks at once by Gauss and Newton's method.
What then is left alike in an action's looks is added to its map `rest`, by as much as the looks
agree.  So one look teaches all actions a little, and eight teach a bank nearly what 25 would.

Nonsense teaches little: nodes and looks that are off by more than the others count for less.  And
the bank to begin with is kept as long as it predicts this run's actions better.  Where hand or
material change, what was learned foretells worse than the start, and is forgotten.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float
from jshape.data.pairs import Pairs
from jshape.learn.lessons import Lesson, hand_of, lessons_of
from jshape.models.bank import Bank
from jshape.models.imprint import Imprint

KEPT = 32
"""Looks that are kept, the last ones: what a run needs of memory and of time does not grow."""
SHARED, OWN = (7e-4, 0.1, 0.15), (5e-4, 0.07, 0.1)
"""How far depth (metres), give and rims usually are off for all actions alike, and for each.  Twice
as much teaches more from the first looks (26 % off after four, not 35, where all was wrong), and
makes a bank that was right up to 10 % worse, not 2."""
FARTHEST = (1e-2, 0.6, 0.9)
"""They are never taken to be off by more."""
ROUNDS = 2
"""Of Gauss and Newton's method: four predict the same to 0.2 %."""
TOLERATED = 1.5
"""Times the usual error from which on a node counts for less, as Huber has it."""
STRAY = 2.5
"""Times what this run's looks are usually off by from which on a look counts for less."""
STRANGEST = 4.0
"""Times the bank's own error that this run's are taken to be at most."""
AGREED, AGREED_WEIGHT = 0.25, 2.0
"""How alike two looks' rests are before any was compared (cosine), and how many that counts as."""
LAST = 16
"""Looks that say how good the bank is."""
CHANGED, WORSE = 2, 1.15
"""Hand or material are others than before where what was learned foretold so many looks worse than
the start would have, by so much: all but those are forgotten."""
DOUBT = 2.0
"""Looks that count as many as those, of a bank that is as good as it says it is."""
UNKNOWN_MM = 1.0
"""Error of an action of whose error the bank knows nothing."""
FACTORS = (0.25, 8.0)
"""Least and largest factor by which errors follow those of the run."""


class Judged(NamedTuple):
    """A lesson, and how well banks foretold it."""

    lesson: Lesson
    start_mm: float
    """Error of the bank that the run began with."""
    learned_mm: float
    """Error of what had been learned before."""
    used_mm: float
    """Error of the bank in use: one of the two."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the looks of a run say of a bank.  Made by `Evidence(bank)`, grown by `note`."""

    start: Bank
    """The bank that the run began with."""
    judged: tuple[Judged, ...] = ()
    """The last `KEPT` lessons, the latest last."""
    count: int = 0
    """Lessons so far, also those that are not kept any more."""
    numbers: Float[np.ndarray, "A 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """Depth in metres, give' and rims' of each action, as they are now taken to be."""

    def __post_init__(self):
        for name in self.start.actions:
            hand_of(self.start, name)
        if not len(self.numbers):
            object.__setattr__(self, "numbers", np.zeros((len(self.start.actions), 3)))

    def note(self, lesson: Lesson) -> "Evidence":
        """With one more lesson."""
        now = [bank.predictors[lesson.action] for bank in (self.start, self.learned, self.bank)]
        judged = Judged(lesson, *(lesson.error_mm(predictor) for predictor in now))
        kept = (*self.judged, judged)[-KEPT:]
        last = kept[-CHANGED:]
        learned, start = sum(one.learned_mm for one in last), sum(one.start_mm for one in last)
        if len(kept) > CHANGED and learned > WORSE * start:
            again = Evidence(self.start)
            for one in last:
                again = again.note(one.lesson)
            return replace(again, count=self.count + 1)
        found = replace(self, judged=kept, count=self.count + 1)
        return replace(found, numbers=found._solved())

    @cached_property
    def learned(self) -> Bank:
        """The bank as the lessons correct it, whether or not it is better than the start."""
        if not self.judged:
            return self.start
        hands = [
            corrected(predictor, numbers)
            for predictor, numbers in zip(self.start.predictors, self.numbers, strict=True)
        ]
        lessons: list[list[Lesson]] = [[] for _ in hands]
        for judged in self.judged:
            lessons[judged.lesson.action].append(judged.lesson)
        left = [
            [lesson.left_by(hand) for lesson in mine]
            for hand, mine in zip(hands, lessons, strict=True)
        ]
        weights = self._weights
        alike = agreement(lessons, left)
        for k, mine in enumerate(lessons):
            if mine:
                mean = common(mine, left[k], [weights[id(lesson)] for lesson in mine], alike)
                hands[k] = replace(hands[k], rest=hands[k].rest + jnp.asarray(mean))
        return replace(self.start, predictors=tuple(hands))

    @cached_property
    def bank(self) -> Bank:
        """The bank to predict with: `learned`, or the start as long as that foretells no worse.

        Its errors and intervals follow those of the run.
        """
        if not self.judged:
            return self.start
        bank = self.start if self.keeps_start else self.learned
        errors, spread, times = bank.errors_mm, bank.intervals, jnp.asarray(self._factors())
        return replace(
            bank,
            errors_mm=None if errors is None else errors * times,
            intervals=None if spread is None else spread * times[:, None],
        )

    @property
    def keeps_start(self) -> bool:
        """Whether what was learned foretold the last actions worse than the start would have."""
        weights = self._weights
        lost = [
            weights[id(one.lesson)] * (one.learned_mm - one.start_mm) for one in self.judged[-LAST:]
        ]
        return sum(lost) > 0

    def _usual_mm(self) -> np.ndarray:
        """(A,) error of each action that the start bank knows of, mm."""
        known = self.start.errors_mm
        known = np.full(len(self.start.actions), np.nan) if known is None else np.asarray(known)
        return np.where(known > 0, known, UNKNOWN_MM)

    def _factors(self) -> Float[np.ndarray, "A"]:
        """By how much the run's errors were larger than the start bank takes them to be."""
        last, usual, weights = self.judged[-LAST:], self._usual_mm(), self._weights
        weight = np.array([weights[id(one.lesson)] for one in last])
        times = weight * [one.used_mm / usual[one.lesson.action] for one in last]
        action = np.array([one.lesson.action for one in last])
        all_of_them = (DOUBT + times.sum()) / (DOUBT + weight.sum())
        found = []
        for k in range(len(usual)):
            mine = action == k
            found.append((DOUBT * all_of_them + times[mine].sum()) / (DOUBT + weight[mine].sum()))
        return np.clip(found, *FACTORS).astype(np.float32)

    @cached_property
    def _weights(self) -> dict[int, float]:
        """How much each lesson counts: less where it is off by more than the others are."""
        usual = self._usual_mm()
        times = {id(one.lesson): one.start_mm / usual[one.lesson.action] for one in self.judged}
        typical = np.clip(np.median(list(times.values()) or [1.0]), 1.0, STRANGEST)
        most = STRAY * float(typical)
        return {which: float((most / max(off, most)) ** 2) for which, off in times.items()}

    def _solved(self) -> Float[np.ndarray, "A 3"]:
        """The numbers that lessons and prior make most likely."""
        count, usual, weights = len(self.numbers), 1e-3 * self._usual_mm(), self._weights
        shared, own = (np.diag(np.square(sizes)) for sizes in (SHARED, OWN))
        prior = np.kron(np.ones((count, count)), shared) + np.kron(np.eye(count), own)
        precision, numbers = np.linalg.inv(prior), self.numbers
        for _ in range(ROUNDS):
            left, right = precision.copy(), np.zeros(3 * count)
            for lesson, *_ in self.judged:
                k, mm = lesson.action, usual[lesson.action]
                change, slope = _sloped(
                    self.start.predictors[k], np.float32(numbers[k]), lesson.before, lesson.strength
                )
                gap = lesson.after - lesson.before - np.asarray(change, float)
                slope = np.asarray(slope, float).reshape(-1, 3)
                sure = np.minimum(1.0, TOLERATED * mm / np.maximum(np.abs(gap), 1e-9))
                # Errors of neighbours are alike: a look counts as one node does.
                each = (weights[id(lesson)] * lesson.counted * sure).ravel()
                each /= lesson.counted.sum() * mm**2
                at = np.s_[3 * k : 3 * k + 3]
                left[at, at] += (slope * each[:, None]).T @ slope
                right[at] += (slope * each[:, None]).T @ (gap.ravel() + slope @ numbers[k])
            numbers = np.linalg.solve(left, right).reshape(count, 3)
            numbers = np.clip(numbers, -np.array(FARTHEST), FARTHEST)
        return numbers


def adapt(bank: Bank, pairs: Pairs) -> Bank:
    """The bank with what a few pairs teach it, in the order in which they were seen.

    At least as good as the bank to begin with on the last pairs, each foretold from those before
    it; errors and intervals follow those of the pairs.  With a few dozen pairs of each action
    `jshape.fit(pairs, "P", start=bank)` is better.

    Args:
      bank: of kind "P".
      pairs: of its camera; those of actions that it does not have are left out.

    Raises:
      BadBank: another kind of bank.
      BadCamera: bank and pairs have different cameras.
      BadDataset: too little of a pair's ROI was seen, or its path is of another length.
    """
    evidence = Evidence(bank)
    for lesson in lessons_of(bank, pairs):
        evidence = evidence.note(lesson)
    return evidence.bank


def corrected(predictor: Imprint, numbers: Float[Array, "3"] | np.ndarray) -> Imprint:
    """f_P with its tool lower, giving way more, and with larger rims: see the module."""
    depth, give, rims = jnp.asarray(numbers, jnp.float32)
    return replace(
        predictor,
        tool=predictor.tool + depth,
        give=predictor.give * (1.0 + give),
        **{name: getattr(predictor, name) * (1.0 + rims) for name in ("rest", "swell", "deep")},
    )


@jax.jit
def _change(predictor: Imprint, numbers: Array, before: Array, strength: Array) -> Array:
    return corrected(predictor, numbers).change(before, strength)


@jax.jit
def _sloped(
    predictor: Imprint, numbers: Array, before: Array, strength: Array
) -> tuple[Array, Array]:
    """The change, and its slope (rows, columns, 3) along the numbers."""
    change = _change(predictor, numbers, before, strength)
    return change, jax.jacfwd(_change, 1)(predictor, numbers, before, strength)


def agreement(lessons: Sequence[Sequence[Lesson]], left: Sequence[Sequence[np.ndarray]]) -> float:
    """The mean cosine between what is left in two looks at one action, over all of them."""
    total, count = AGREED * AGREED_WEIGHT, AGREED_WEIGHT
    for mine, rests in zip(lessons, left, strict=True):
        seen = [_blurred(one.counted * rest, 1.5) for one, rest in zip(mine, rests, strict=True)]
        length = [max(float(np.linalg.norm(rest)), 1e-9) for rest in seen]
        for k, rest in enumerate(seen):
            for j in range(k):
                total += float((rest * seen[j]).sum()) / (length[k] * length[j])
                count += 1
    return float(np.clip(total / count, 0.05, 0.9))


def common(
    lessons: Sequence[Lesson], left: Sequence[np.ndarray], weights: Sequence[float], alike: float
) -> Float[np.ndarray, "rows columns"]:
    """What is left in all looks at an action, per strength, shrunk by how little they agree.

    Of n values with a common part whose share of the variance is `alike`, the best estimate of
    that part is their mean times n / (n + (1 - alike) / alike).
    """
    stack = zip(lessons, left, weights, strict=True)
    total, counts = np.zeros((2, *left[0].shape))
    number = 0.0  # of looks at strength 1 that would say as much: a shallow one says little of it
    for lesson, rest, weight in stack:
        total += weight * lesson.strength * lesson.counted * rest
        counts += weight * lesson.strength**2 * lesson.counted
        number += weight * lesson.strength**2
    mean = _blurred(total / np.maximum(counts, 1e-6), max(number, 1.0) ** -0.5)
    return (mean * number / (number + (1.0 - alike) / alike)).astype(np.float32)


def _blurred(field: np.ndarray, nodes: float) -> np.ndarray:
    import cv2

    return cv2.GaussianBlur(field.astype(np.float32), (0, 0), nodes)
