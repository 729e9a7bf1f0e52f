"""From still segments of a recording to pairs: their means, and what changed between them.

Frames are `[v, u]`, uint16 counts, 0 = no reading.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from jshape.data.annotate import Effect, difference_mm, find_effect
from jshape.data.missing import middle_reading, spread
from jshape.data.segment import Segment

MOST_FRAMES = 60
"""Most frames that are averaged: more would only take memory (0.45 mm of noise become 0.06)."""
RESET_SHARE = 0.4
"""Default: where more of the bed than this has changed, it has been levelled."""
LEVELLED_MM = 1.0
"""A levelled bed differs by more than this from the one before, nearly everywhere."""


@dataclass(frozen=True, eq=False)
class Averaged:
    """An open segment and the mean of its frames."""

    segment: Segment
    counts: np.ndarray
    """(H, W) uint16, 0 = no reading."""
    noise_mm: float
    """Standard deviation of the mean as `difference_mm` blurs it: from its even and odd frames."""


@dataclass(frozen=True, eq=False)
class Change:
    """What happened between two neighbouring open segments."""

    kind: Literal["action", "none", "reset"]
    before: Averaged
    after: Averaged
    effect: Effect
    why: str
    """For people: why it makes no pair; empty for an action."""

    @property
    def between(self) -> tuple[int, int]:
        """The first frame of the change, and the first after it."""
        return self.before.segment.stop, self.after.segment.start


def average(stack: np.ndarray, depth_unit: float) -> np.ndarray:
    """One frame of several of the same bed: the mean over each pixel's readings.

    Readings far from the pixel's median (a flicker, a flying pixel) are left out.  A pixel with
    readings in less than a quarter of the frames (or in one of several) has none.  Counts (S, H, W)
    become counts (H, W).
    """
    median = middle_reading(stack).astype(np.float32)
    # 1 % of the depth is 4.5 mm at 0.45 m: ten times the noise of one frame.  Not less than 2 mm.
    least = max(2.0, 2e-3 / depth_unit)
    keep = (stack > 0) & (np.abs(stack - median) <= np.maximum(0.01 * median, least))
    kept = keep.sum(0)
    total = (stack * keep).sum(0, dtype=np.float64)
    enough = kept >= (max(2, len(stack) / 4) if len(stack) > 1 else 1)
    return np.where(enough, np.rint(total / np.maximum(kept, 1)), 0).astype(np.uint16)


def averaged_frames(segment: Segment) -> list[int]:
    """Indices of the frames that are averaged: at most `MOST_FRAMES`, evenly spread."""
    count = min(segment.stop - segment.start, MOST_FRAMES)
    return np.linspace(segment.start, segment.stop - 1, count).round().astype(int).tolist()


def average_segment(segment: Segment, stack: np.ndarray, depth_unit: float) -> Averaged:
    """The mean of a segment's frames (S, H, W), and how noisy it still is."""
    counts = average(stack, depth_unit)
    if len(stack) < 4:
        return Averaged(segment, counts, 0.0)
    halves = average(stack[::2], depth_unit), average(stack[1::2], depth_unit)
    change, known = difference_mm(*halves, depth_unit)
    # The difference of two halves has 2 / (S / 2) of one frame's variance, the mean 1 / S.
    return Averaged(segment, counts, spread(change[known]) / 2)


def compare(
    before: Averaged,
    after: Averaged,
    depth_unit: float,
    noise_mm: float,
    *,
    reset_share: float = RESET_SHARE,
    hidden: bool = False,
) -> Change:
    """What happened between two open segments.

    An action changes one place.  Nothing beyond the noise makes no pair, and neither does a change
    all over the bed (more than `reset_share` of it), or in two places far apart of which one is at
    least half as deep as the other.  `noise_mm` is the standard deviation of an averaged frame; it
    is not taken from the difference: all over a levelled bed, the change would look like noise.
    `hidden`: as `find_effect`.
    """
    effect = find_effect(before.counts, after.counts, depth_unit, hidden=hidden)
    known = np.isfinite(effect.change_mm)
    limit = max(5 * 2**0.5 * noise_mm, LEVELLED_MM)
    share = float((np.abs(effect.change_mm[known]) > limit).mean()) if known.any() else 0.0
    kind, why = "action", ""
    if share > reset_share:
        kind, why = "reset", f"{share:.0%} of the bed changed, as if it had been levelled"
    elif effect.box is None:
        kind, why = "none", f"nothing changed beyond the noise of {effect.noise_mm:.2f} mm"
    elif effect.second_mm > 0.5 * effect.peak_mm:
        places = 1 + len(effect.others)
        kind, why = "reset", f"the bed changed in {places} places far apart, not in one"
    return Change(kind, before, after, effect, why)
