"""Where an action changed the bed: the ROI of a pair, found in its two frames.

Frames are `[v, u]`, uint16 counts, 0 = no reading; boxes are `(left, top, width, height)`, pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from jshape.data.missing import spread
from jshape.data.pairs import Pairs

SIGMA_PX = 1.2
"""Blur of the difference before it is judged, pixels: a stereo camera's noise is as wide."""
RIM_SIGMA_PX = 3.0
"""Blur of what is left beside the deep part of an effect: it shows shallow rims."""
SPECK_PX = 2.0
"""Radius of what is dropped as a speck of noise, pixels."""
RIM_SPECK_PX = 5.0
"""The same among shallow rims: the blurred noise has larger specks."""
NEAR_PX = 5.0
"""Parts of one effect may be this far apart, pixels."""
LEAST_MM = 0.5
"""A change smaller than this is not looked for, whatever the noise."""
SIGNAL = 5.0
"""An effect must stand out of the noise by this factor somewhere."""
EDGE = 3.2
"""Where the effect ends, in standard deviations of the noise (but at least `LEAST_MM`)."""
CUT_OFF = 4.0
"""Differences beyond this many times the edge's are cut off before the blur, see `_sides`."""
LEAST_AREA_PX = 95
"""Least area of an effect, pixels: 1 cm² at 0.45 m."""

Box = tuple[int, int, int, int]


def box_of(mask: np.ndarray) -> Box | None:
    """The box that holds all of a mask; None of an empty one."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return (left, top, width, height) if width else None


@dataclass(frozen=True, eq=False)
class Effect:
    """What differs between two frames."""

    change_mm: np.ndarray
    """(H, W) posterior minus prior depth, mm, blurred; positive is deeper; NaN = not known."""
    mask: np.ndarray
    """(H, W) bool: the largest changed place with the parts near it."""
    box: Box | None
    """Of the mask; None: nothing stands out of the noise."""
    others: tuple[Box, ...]
    """Boxes of other changed places, the largest first."""
    noise_mm: float
    """Standard deviation of the blurred difference where nothing happened."""
    peak_mm: float
    """Largest change inside the box (99th percentile of its size); 0 without an effect."""
    second_mm: float
    """Largest change of the next largest changed place."""
    share: float
    """Changed share of the pixels that both frames have."""
    unseen_mm: float = 0.0
    """What the change counts where the mask holds what is not known."""


def find_effect(
    prior: np.ndarray, posterior: np.ndarray, depth_unit: float, *, hidden: bool = False
) -> Effect:
    """The place that differs between two frames.

    Otsu's threshold on the size of the difference, raised above the noise, marks what has surely
    changed; from there the mask grows down to `EDGE` standard deviations of the noise.  What is
    shallower than that beside it (rims) is blurred once more, the deep part left out, and judged
    by its own, smaller noise.  Opening drops specks, closing joins parts that are near, and the
    connected component that holds the most sure change stays.

    `hidden`: the frames are of a camera at an angle, looked at from above (`data.pair_view`).  What
    lost its reading then has changed too: the wall of a hole hides its floor.
    """
    change, known = difference_mm(prior, posterior, depth_unit)
    drift = _most_frequent(change[known]) if known.any() else 0.0
    change = np.where(known, change - drift, 0.0).astype(np.float32)
    size = np.where(known, np.abs(change), 0.0).astype(np.float32)
    noise, otsu = _noise_and_otsu(size[known])
    limit = max(EDGE * noise, LEAST_MM)
    changed = _open(_sides(prior, posterior, depth_unit, drift, CUT_OFF * limit) > limit, SPECK_PX)
    if EDGE * noise > LEAST_MM:
        changed |= _with_rim(change, known, changed)
    if hidden:
        gone = _open((prior > 0) & (posterior == 0), SPECK_PX)
        changed |= gone
        size = np.where(gone, np.maximum(size, 2 * max(SIGNAL * noise, LEAST_MM)), size)
    share = float(changed.sum() / max(known.sum(), 1))
    joined = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, _disk(NEAR_PX / 2))
    count, labels = cv2.connectedComponents(joined, connectivity=8)
    area = np.bincount(labels[changed], minlength=count)
    surely = size > max(SIGNAL * noise, LEAST_MM)
    # By volume, not area: a shallow smear may be wide, an action is deep.
    volume = np.zeros((2, count))
    for row, core in zip(volume, (surely & (size > otsu), surely), strict=True):
        row += np.bincount(labels[core], weights=size[core], minlength=count)
    volume[:, 0] = 0.0
    volume[:, area < LEAST_AREA_PX] = 0.0
    shown = np.where(known, change, np.nan).astype(np.float32)
    order = [int(k) for k in np.lexsort(-volume[::-1]) if volume[1, k] > 0]
    if not order:
        return Effect(shown, np.zeros(size.shape, bool), None, (), noise, 0.0, 0.0, share)
    boxes = [box for k in order if (box := box_of((labels == k) & changed))]
    mask = (labels == order[0]) & changed
    peaks = [float(np.percentile(size[(labels == k) & changed], 99)) for k in order[:2]]
    second = peaks[1] if len(peaks) > 1 else 0.0
    unseen = peaks[0] if hidden else 0.0
    return Effect(shown, mask, boxes[0], tuple(boxes[1:]), noise, peaks[0], second, share, unseen)


def difference_mm(
    prior: np.ndarray, posterior: np.ndarray, depth_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Blurred posterior minus prior depth in mm, and where it is known: two (H, W).

    Pixels without a reading take no part: the blur is a mean over readings only.
    """
    change, both = _raw_mm(prior, posterior, depth_unit)
    change, known = _blurred(change, both, SIGMA_PX)
    return np.where(known, change, 0.0).astype(np.float32), known


def place_boxes(
    pairs: Pairs, effects: Sequence[Effect], keep: np.ndarray
) -> tuple[Pairs, np.ndarray]:
    """Pairs with the ROIs of their effects: each action's size is the mean of its boxes.

    The sides of a box lie where the effect fades into the noise, so its middle is uncertain.  The
    centre of the change (its mean place, weighted by its size) is steadier: a ROI is centred there,
    moved by what lies between that and the middle of the box on the action's average.  With that
    the boxes overlap by 0.86 with the simulator's, with their own middles by 0.85 (pokes: 0.83 and
    0.80; 90 pairs).  A ROI that would leave the image is shifted inside.

    Args:
      pairs: N pairs; the ROIs that they have are not used, except where `keep` says so.
      effects: N, of `find_effect`.
      keep: (N,) bool: these ROIs were drawn by hand; they stay.

    Returns:
      The pairs; and (N,) bool, whether an effect or a ROI by hand is there.  Where it is not, the
      ROI stays as it was.
    """
    boxes = {k: e.box for k, e in enumerate(effects) if e.box is not None and not keep[k]}
    there = keep.copy()
    there[list(boxes)] = True
    centre, size = pairs.centre.copy(), pairs.size.copy()
    for k, box in boxes.items():
        size[k] = box[2:]
    for action in pairs.actions:
        found = [k for k in boxes if pairs.action[k] == action]
        if not found:
            continue
        # Not over those by hand too: all rows together then have the mean of all boxes.
        mean = np.rint(size[found].mean(0)).astype(int)
        corners = np.array([boxes[k] for k in found], float)
        heavy = np.array([_centre_of_change(effects[k]) for k in found])
        middle = heavy + (corners[:, :2] + corners[:, 2:] / 2 - heavy).mean(0)
        first = np.rint(middle - mean / 2).astype(int)
        first = np.clip(first, 0, np.array([pairs.camera.width, pairs.camera.height]) - mean)
        size[found], centre[found] = mean, first + mean // 2
    return replace(pairs, centre=centre, size=size), there


def provisional_box(effect: Effect, shape: tuple[int, int]) -> Box:
    """A box around all that changed, with a twentieth of its size to spare on each side."""
    boxes = np.array([box for box in (effect.box, *effect.others) if box is not None])
    first, last = boxes[:, :2].min(0), (boxes[:, :2] + boxes[:, 2:]).max(0)
    spare = (last - first) // 20 + 2
    first = np.maximum(first - spare, 0)
    last = np.minimum(last + spare, shape[::-1])
    left, top, w, h = *first.tolist(), *(last - first).tolist()
    return left, top, w, h


def _centre_of_change(effect: Effect) -> np.ndarray:
    """The mean place (u, v) of an effect, weighted by the size of the change."""
    rows, columns = np.nonzero(effect.mask)
    weight = np.abs(np.nan_to_num(effect.change_mm[rows, columns], nan=effect.unseen_mm))
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum() + 0.5


def _raw_mm(
    prior: np.ndarray, posterior: np.ndarray, depth_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    both = (prior > 0) & (posterior > 0)
    change = posterior.astype(np.float32) - prior.astype(np.float32)
    return np.where(both, change * np.float32(1e3 * depth_unit), 0.0).astype(np.float32), both


def _sides(
    prior: np.ndarray, posterior: np.ndarray, depth_unit: float, drift: float, top: float
) -> np.ndarray:
    """Size of the difference, cut off at `top` before the blur: (H, W).

    A blurred wall 10 mm high reaches half a millimetre 2 pixels away from where it stands; one
    that is cut off at four times the limit crosses the limit 0.8 pixels away.
    """
    change, both = _raw_mm(prior, posterior, depth_unit)
    smooth, known = _blurred(np.clip(change - drift, -top, top), both, SIGMA_PX)
    return np.where(known, np.abs(smooth), 0.0)


def _with_rim(change: np.ndarray, known: np.ndarray, deep: np.ndarray) -> np.ndarray:
    """The deep part of an effect and what is shallow beside it: (H, W) bool."""
    deep = cv2.dilate(deep.astype(np.uint8), _disk(1.0)) > 0
    smooth, seen = _blurred(change, known & ~deep, RIM_SIGMA_PX)
    seen &= ~deep
    size = np.where(seen, np.abs(smooth), 0.0).astype(np.float32)
    noise, _ = _noise_and_otsu(size[seen])
    return _open((size > max(EDGE * noise, LEAST_MM)) | deep, RIM_SPECK_PX)


def _blurred(image: np.ndarray, known: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian mean over the known pixels only, and where there are enough of them."""
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma)
    total = cv2.GaussianBlur(np.where(known, image, 0.0).astype(np.float32), (0, 0), sigma)
    return total / np.maximum(weight, 1e-6), weight > 0.3


def _open(mask: np.ndarray, radius: float) -> np.ndarray:
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disk(radius)) > 0


def _noise_and_otsu(size: np.ndarray) -> tuple[float, float]:
    """Noise (standard deviation) and Otsu's threshold of the sizes |difference|, mm."""
    top = float(size.max(initial=0.0))
    if top <= 0:
        return 0.0, 0.0
    # 8 bits over the whole range would leave the noise in one bin: OpenCV takes 16 for Otsu.
    scaled = np.rint(size * (65535 / top)).astype(np.uint16)
    otsu = cv2.threshold(scaled.reshape(1, -1), 0, 1, cv2.THRESH_OTSU)[0] * top / 65535
    quiet = size
    noise = 0.0
    for _ in range(5):  # the effect itself is no noise: leave out what is beyond 3 deviations
        noise = spread(quiet)
        kept = size[size <= max(3 * noise, 1e-6)]
        if not kept.size:
            break
        quiet = kept
    return noise, float(otsu)


def _most_frequent(change: np.ndarray) -> float:
    """The mode of the differences, to a tenth of the noise: where the untouched bed has gone."""
    low, high = np.percentile(change, (2, 98))
    if high - low < 1e-6:
        return float(low)
    count, edges = np.histogram(change, bins=64, range=(low, high))
    k = int(np.argmax(np.convolve(count, (1, 1, 1), "same")))
    left, right = edges[max(k - 1, 0)], edges[min(k + 2, 64)]
    return float(np.median(change[(change >= left) & (change <= right)]))


def _disk(radius: float) -> np.ndarray:
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
