"""Which frames of a recording show the open bed at rest; `data.changes` makes pairs of them.

Frames are `[v, u]`, uint16 counts, 0 = no reading; frame ranges are `[start, stop)`.  Everything is
judged on thumbnails (medians of blocks of `BLOCK` x `BLOCK` pixels), so that a recording of any
length fits into memory: 9 kB a frame for the paper's box.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from jshape.data.missing import middle_reading, spread
from jshape.errors import BadDataset

BLOCK = 8
"""Side of the blocks that a thumbnail is made of, pixels."""
NEAR_MM = 30.0
"""Default: what rises this far above the bed, coming from the image's edge, is a hand or an arm."""
MIN_FRAMES = 5
"""Default: fewer frames than this are no still segment."""
GUARD = 1
"""Frames left out beside motion: a shutter stays open for a while, a camera smooths over time, and
frames of several cameras are up to one apart."""
AT_ONCE = 0.5
"""Least correlation of when two cameras show the open bed.  At 30 degrees on either side, the bed
open for 10 of 34 frames, it was 0.88; with one 3 frames late 0.61, 5 frames 0.34."""


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

    @property
    def open(self) -> tuple[Segment, ...]:
        """The segments that show the open bed at rest."""
        return tuple(s for s in self.segments if s.state == "open")

    @property
    def shown(self) -> np.ndarray:
        """(T,) whether a frame is in one of them."""
        shown = np.zeros(len(self.motion), bool)
        for part in self.open:
            shown[part.start : part.stop] = True
        return shown


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
    found = Cut(motion, covered, segments)
    return _without_visitors(found, thumbs, depth_unit, least)


def cut_at_once(cuts: Sequence[Cut], names: Sequence[str], min_frames: int = MIN_FRAMES) -> Cut:
    """The cut of recordings by several cameras at once: open is what all of them see open.

    Raises BadDataset: they see the open bed at other moments: they were not recorded at once.
    """
    found, first = cuts[0], cuts[0].shown
    for other, name in zip(cuts[1:], names[1:], strict=True):
        if 0 < first.mean() < 1 and 0 < other.shown.mean() < 1:
            alike = float(np.corrcoef(first, other.shown)[0, 1])
            if alike < AT_ONCE:
                raise BadDataset(
                    f"{name}: shows the open bed at other moments than {names[0]} (correlation "
                    f"{alike:.2f}, at least {AT_ONCE:g}): were they recorded at once, by one clock?"
                )
        both = [
            _overlap(a, b, min_frames)
            for a in found.segments
            for b in other.segments
            if max(a.start, b.start) < min(a.stop, b.stop)
        ]
        found = Cut(
            np.maximum(found.motion, other.motion),
            np.maximum(found.occluded, other.occluded),
            tuple(both),
        )
    return found


def _overlap(a: Segment, b: Segment, least: int) -> Segment:
    start, stop = max(a.start, b.start), min(a.stop, b.stop)
    states = {a.state, b.state, "open" if stop - start >= least else "short"}
    return Segment(start, stop, next(s for s in ("occluded", "short", "open") if s in states))


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
