"""From a recording to pairs: which frames show the open bed at rest, and what changed between them.

Frames are `[v, u]`, uint16 counts, 0 = no reading; frame ranges are `[start, stop)`.  Everything is
judged on thumbnails (medians of blocks of `BLOCK` x `BLOCK` pixels), so that a recording of any
length fits into memory: 9 kB a frame for the paper's box.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from jshape.data.annotate import Effect, difference_mm, find_effect
from jshape.data.missing import middle_reading, spread

BLOCK = 8
"""Side of the blocks that a thumbnail is made of, pixels."""
NEAR_MM = 30.0
"""Default: what rises this far above the bed, coming from the image's edge, is a hand or an arm."""
MIN_FRAMES = 5
"""Default: fewer frames than this are no still segment."""
MOST_FRAMES = 60
"""Most frames that are averaged: more would only take memory (0.45 mm of noise become 0.06)."""
RESET_SHARE = 0.4
"""Default: where more of the bed than this has changed, it has been levelled."""
LEVELLED_MM = 1.0
"""A levelled bed differs by more than this from the one before, nearly everywhere."""
GUARD = 1
"""Frames left out beside motion: a shutter stays open for a while, a camera smooths over time."""


@dataclass(frozen=True)
class Segment:
    """A range of frames without motion."""

    start: int
    stop: int
    state: Literal["open", "occluded", "short"]
    """The open bed; something rests in front of it; or too few frames to tell."""

    def __str__(self) -> str:
        return f"{self.start}-{self.stop - 1}"


@dataclass(frozen=True, eq=False)
class Cut:
    """How a recording was cut.  T frames."""

    motion: np.ndarray
    """(T,) share of the image that differs from the frame before."""
    occluded: np.ndarray
    """(T,) share of the image with something before the bed."""
    segments: tuple[Segment, ...]
    """In order, without overlap."""
    noise_mm: float
    """Standard deviation of a thumbnail's block over time."""

    @property
    def open(self) -> tuple[Segment, ...]:
        """The segments that show the open bed at rest."""
        return tuple(s for s in self.segments if s.state == "open")


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


def thumbnail(counts: np.ndarray) -> np.ndarray:
    """Medians of blocks: (H // BLOCK, W // BLOCK) uint16, 0 where over half have no reading.

    A median, because a mean would follow the flying pixels at a hand's rim.
    """
    h, w = (max(1, side // BLOCK) for side in counts.shape)
    blocks = counts[: h * BLOCK, : w * BLOCK]
    size = blocks.shape[0] // h, blocks.shape[1] // w
    blocks = blocks.reshape(h, size[0], w, size[1]).swapaxes(1, 2).reshape(h, w, -1)
    return np.where((blocks > 0).mean(-1) >= 0.5, middle_reading(blocks, -1), 0).astype(np.uint16)


def cut(
    thumbs: np.ndarray, depth_unit: float, *, near_mm: float = NEAR_MM, min_frames: int = MIN_FRAMES
) -> Cut:
    """Still segments of a recording, and which of them show the open bed.

    A frame moves if blocks differ from the frame before by six times the noise.  Something is
    before the bed where blocks are nearer than the bed by `near_mm`, in one piece that reaches the
    image's edge (an arm does) or rises twice as high; or where a piece of the bed gives no reading
    that mostly gives one (too near for the camera).  The bed at a block is the median of all
    moments at which that block was still: the open bed must be seen for most of the quiet time.

    `near_mm` is the least height of a hand or arm above the bed, `min_frames` the least length of
    a segment; `thumbs` are (T, h, w) thumbnails in counts.
    """
    blocks = thumbs.shape[1] * thumbs.shape[2]
    least = max(2, round(0.001 * blocks))
    # 0.8 % of the paper's box is 16 cm²: a hand is larger, a new hill at the edge hardly.
    hand = max(4, round(0.008 * blocks))
    unit_mm = 1e3 * depth_unit
    noise = _noise_mm(thumbs, unit_mm)
    limit = max(6 * 2**0.5 * noise, 2 * unit_mm, 1.0) / unit_mm
    moving = np.zeros(thumbs.shape, bool)
    for k in range(1, len(thumbs)):
        moving[k] = _step(thumbs[k - 1], thumbs[k]) > limit
    # Blocks that never rest (a screen at the edge, a shiny wall) say nothing about the hand.
    moving &= moving.mean(0) <= 0.5
    count = moving.sum((1, 2))
    motion, jumps = count / blocks, count >= least

    bed = _bed(thumbs, moving)
    often = (thumbs > 0).mean(0) > 0.5
    covered = np.zeros(len(thumbs))
    for k, thumb in enumerate(thumbs):
        known = (thumb > 0) & (bed > 0)
        rise = np.where(known, bed.astype(np.int32) - thumb, 0) * unit_mm
        before = _pieces(rise > near_mm, hand, rise > 2 * near_mm)
        lost = _pieces(often & (thumb == 0), max(10 * least, 4), None)
        covered[k] = (before | lost).mean()
    # The rim of a resting hand flickers: before the bed, motion is what moves more than that.
    hidden = covered > 0
    jumps[1:] = np.where(hidden[1:] & hidden[:-1], motion[1:] > 0.02, jumps[1:])
    segments = _segments(jumps, hidden, min_frames)
    found = Cut(motion, covered, segments, noise)
    return _without_visitors(found, thumbs, depth_unit, least)


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


def _step(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """|difference| of two thumbnails in counts, 0 where either has no reading."""
    both = (before > 0) & (after > 0)
    return np.where(both, np.abs(after.astype(np.int32) - before), 0)


def _noise_mm(thumbs: np.ndarray, unit_mm: float) -> float:
    """Standard deviation of a block over time: of up to 1000 steps, without the largest ones."""
    which = np.linspace(1, len(thumbs) - 1, min(1000, len(thumbs) - 1)).astype(int)
    steps = [_step(thumbs[k - 1], thumbs[k]) for k in np.unique(which)]
    quiet = np.concatenate([step[step > 0] for step in steps]) if steps else np.zeros(0)
    return spread(quiet) * unit_mm / 2**0.5


def _bed(thumbs: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Median (h, w) of every block over the moments at which it was still, counts; 0 = unknown."""
    found = np.zeros(thumbs.shape[1:], np.uint16)
    for row in range(thumbs.shape[1]):  # row by row: a sorted copy of all would need as much again
        seen = thumbs[:, row] > 0
        still = seen & ~moving[:, row]
        still[:-1] &= ~moving[1:, row]
        still = np.where(still.any(0), still, seen)
        found[row] = middle_reading(np.where(still, thumbs[:, row], 0))
    return found


def _pieces(mask: np.ndarray, least: int, surely: np.ndarray | None) -> np.ndarray:
    """Connected pieces of at least `least` blocks that reach the edge or hold `surely` blocks."""
    if mask.sum() < least:
        return np.zeros_like(mask)
    count, found, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    labels = np.asarray(found, int)
    keep = stats[:, cv2.CC_STAT_AREA] >= least
    if surely is not None:
        edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        sure = np.bincount(labels[surely], minlength=count) >= least / 2
        keep &= sure | np.isin(np.arange(count), edge)
    keep[0] = False
    return keep[labels]


def _segments(jumps: np.ndarray, covered: np.ndarray, least: int) -> tuple[Segment, ...]:
    """Runs of frames without a jump inside, split where the bed is covered or uncovered."""
    count = len(covered)
    change = np.r_[True, jumps[1:] | (covered[1:] != covered[:-1]), True][: count + 1]
    bounds = np.flatnonzero(change)
    segments = []
    for start, stop in zip(bounds, bounds[1:], strict=False):
        start, stop, hidden = int(start), int(stop), bool(covered[start])
        if not hidden:  # the frames at the seams may show a trace of what moved
            start += GUARD * (start > 0)
            stop -= GUARD * (stop < count)
        if stop - start < 1:
            continue
        state = "occluded" if hidden else "open" if stop - start >= least else "short"
        if stop - start >= least or state == "short":
            segments.append(Segment(start, stop, state))
    return tuple(segments)


def _without_visitors(found: Cut, thumbs: np.ndarray, depth_unit: float, least: int) -> Cut:
    """The cut without segments in which something lies on the bed at the image's edge.

    Fingers that rest flat on the bed are lower than `NEAR_MM`.  But material does not come and
    go: what is 8 mm nearer than both before and after, where those two agree, is no material.
    """
    still = [k for k, s in enumerate(found.segments) if s.state == "open"]
    segments = list(found.segments)
    mean = {
        k: 1e3 * mean_of(thumbs[segments[k].start : segments[k].stop], depth_unit) for k in still
    }
    for a, b, c in zip(still, still[1:], still[2:], strict=False):
        first, here, last = mean[a], mean[b], mean[c]
        same = (first > 0) & (here > 0) & (last > 0) & (np.abs(first - last) < 3.0)
        nearer = same & (np.minimum(first, last) - here > 8.0)
        if _pieces(nearer, 2 * least, np.zeros_like(nearer)).any():
            segments[b] = replace(segments[b], state="occluded")
    return replace(found, segments=tuple(segments))


def mean_of(thumbs: np.ndarray, depth_unit: float) -> np.ndarray:
    """The mean (h, w) of thumbnails (T, h, w) over their readings, metres; NaN where none is."""
    count = (thumbs > 0).sum(0)
    mean = thumbs.sum(0, dtype=np.float64) / np.maximum(count, 1)
    return np.where(count > 0, depth_unit * mean, np.nan)
