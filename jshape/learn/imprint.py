"""Fitting f_P: the maps of a pressed tool from the bed before and after."""

from collections.abc import Callable, Collection
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float, Key
from jshape.camera import Camera
from jshape.data.missing import fill_nan
from jshape.data.pairs import Examples
from jshape.errors import BadDataset
from jshape.learn.first_guess import Shown, begin, first_guess, fixed_of, images, mirrors
from jshape.models.imprint import Imprint
from jshape.models.orthographic import OrthographicGrid

PIXELS = 2.0
"""Pitch of the grid in pixels at the depth of the places.  Half the camera's resolution costs 0.02
mm of 0.5 and makes a sweep four times as fast."""
STEPS, PER_PAIR, PER_MANY, STEP = (100, 600), 12, 6, 3e-3
"""From nothing: least and most steps, steps per pair, those per pair where that is more than the
most, and the length of the first (Adam, in units of `SCALES`).  Few pairs are learned by heart when
they are gone over more often; 240 of many strengths gain 3 % by the longer way."""
ADAPT_STEPS, ADAPT_STEP = 50, 2e-3
"""The same from another bank's predictor: few, so that few pairs do not undo what it knows."""
TRUST = 12.0
"""With this many pairs, half of what all are off by is taken to be the bank's error."""
BATCH = 16
"""Pairs per step, at most."""
DEPTHS = range(-10, 11, 2)
"""How far from the median depth of the bed the depth of the places is looked for, mm."""
DOUBT = 4.0
"""How much more alike they must look per metre off the median: 0.4 % per millimetre."""
SCALES = {
    "reference": 30.0,
    "tool": 1e-2,
    "give": 1.0,
    "rest": 1e-2,
    "swell": 1e-2,
    "follow": 1.0,
    "deep": 1e-2,
    "stroke": 1e-2,
    "height": 1e-2,
    "rise": 1.0,
    "share": 0.3,
    "brought": 1.0,
}
"""What is fitted, and what 1 is to the optimiser."""
EDGE = 2e-4
"""A surface this near to the end of the camera's range may lie beyond it, metres."""


Loss = Callable[[Imprint, Shown], Array]
"""What `descend` lowers.  A function of a module: what was compiled for it is found by identity."""


def fit_imprint(
    examples: Examples, camera: Camera, start: Imprint | None = None, *, seed: int = 0
) -> Imprint:
    """f_P of one action from its pairs, or from another bank's f_P and few pairs.

    From nothing and with pairs of strength 1 only, other strengths are a guess: the tool goes as
    much deeper as its greatest lowering, and all beside it grows in proportion.

    Raises:
      BadDataset: no pairs, one without any pixel seen before and after, or pixels that no pair has
        seen.
    """
    filled, seen = complete(examples)
    if start is not None:
        shown = shown_on(start.grid, filled, seen)
        first, fixed, alike = _corrected(start, shown), fixed_of(start), mirrors(shown)
        steps, step = ADAPT_STEPS, ADAPT_STEP
    else:
        grid = grid_below(OrthographicGrid.over(camera, filled.roi), filled)
        shown = shown_on(grid, filled, seen)
        first, fixed, alike = begin(grid, shown)
        steps, step = steps_for(len(seen), alike), STEP
    key = jax.random.key(seed)
    found = descend(absolute_error, first, shown, key, steps, step, fixed, alike)
    if examples.path_mm:
        found = replace(found, path=1e-3 * examples.path_mm)
    if start is None and (shown.strength == 1.0).all():
        found = replace(found, stroke=found.deepest)  # pairs of one strength say nothing about it
    return found


def mean_imprint(examples: Examples, camera: Camera) -> Imprint:
    """The mean change of the bed as an f_P without a tool: what f_D is, seen from above."""
    filled, seen = complete(examples)
    grid = grid_below(OrthographicGrid.over(camera, filled.roi), filled)
    return first_guess(grid, shown_on(grid, filled, seen), tool=False)


def complete(examples: Examples) -> tuple[Examples, np.ndarray]:
    """Examples with their gaps filled, and which pixels (n, h, w) were seen before and after.

    Raises:
      BadDataset: as for `fit_imprint`.
    """
    if len(examples.prior) == 0:
        raise BadDataset("no pairs to fit to")
    seen = examples.seen
    if not seen.any((1, 2)).all():
        blind = int(np.argmin(seen.any((1, 2)))) + 1
        raise BadDataset(f"pair {blind} of {len(seen)} has no pixel seen before and after")
    unseen = ~seen.any(0)
    if unseen.any():
        raise BadDataset(
            f"{int(unseen.sum())} of {unseen.size} ROI pixels have no depth reading in any of the "
            f"{len(seen)} pairs"
        )
    prior, posterior = (
        np.stack([fill_nan(roi) for roi in rois]).astype(np.float32) for rois in examples[:2]
    )
    strengths = np.asarray(examples.strengths, np.float32)
    return Examples(prior, posterior, examples.corner, strengths, examples.path_mm), seen


def steps_for(count: int, alike: Collection[float] = ()) -> int:
    """Steps of a fit from nothing to so many pairs, and their mirror images."""
    copies = 1 + int(sum(alike))
    return max(int(np.clip(PER_PAIR * count * copies, *STEPS)), PER_MANY * count)


def shown_on(grid: OrthographicGrid, examples: Examples, seen: np.ndarray) -> Shown:
    """What complete examples show on a grid."""
    before, after = _surfaces(grid, examples)
    counted = jnp.asarray(_at_nodes(seen, grid), jnp.float32)
    return Shown(before, after, counted, jnp.asarray(examples.strengths))


def grid_below(
    blank: OrthographicGrid, examples: Examples, depths: Collection[int] = DEPTHS
) -> OrthographicGrid:
    """The grid over the ROI of `blank`, at the depth where places are meant.

    That is not known: of `depths` around the median of what was seen (mm), it is the one from which
    the changes of all pairs look most alike, per strength.  On a flat bed all do, and the median
    is right.
    """
    camera, (w, h) = blank.camera, blank.roi
    per_metre = np.stack([blank.per_metre(corner) for corner in jnp.asarray(examples.corner)])
    middle = float(camera.z_max) - float(np.median(examples.prior / per_metre))
    rows = h * float(camera.fx) / float(camera.fy) / PIXELS
    shape = (int(np.ceil(rows)), int(np.ceil(w / PIXELS)))

    def at(depth: float) -> OrthographicGrid:
        pitch = jnp.float32(PIXELS / float(camera.scale(depth)[0]))
        return replace(blank, depth=jnp.float32(depth), pitch=pitch, shape=shape)

    strength = examples.strengths[:, None, None]

    def unlike(depth: float) -> float:
        before, after = _surfaces(at(depth), examples)
        change = np.asarray(after - before)
        return float(np.abs(change - strength * np.median(change / strength, 0)).mean())

    found = {1e-3 * mm: unlike(middle + 1e-3 * mm) for mm in depths}
    least = max(found[0.0], 1e-9)  # one pair is like itself from everywhere
    return at(middle + min(found, key=lambda off: found[off] / least + DOUBT * abs(off)))


@jax.jit
def _surfaces(
    grid: OrthographicGrid, examples: Examples
) -> tuple[Float[Array, "n rows columns"], Float[Array, "n rows columns"]]:
    """The bed below ROIs of I before and after; one pair after the other, to spare memory."""

    def one(pair):
        prior, posterior, corner = pair
        per_metre = grid.per_metre(corner)
        before, after = (grid.camera.z_max - roi / per_metre for roi in (prior, posterior))
        return grid.from_roi(before, corner), grid.from_roi(after, corner)

    return jax.lax.map(one, tuple(map(jnp.asarray, examples[:3])))


def _at_nodes(seen: np.ndarray, grid: OrthographicGrid) -> np.ndarray:
    """Of masks (n, h, w), the pixel below each node (n, rows, columns), parallax left out."""
    camera = grid.camera
    picked = []
    scale = camera.scale(float(grid.depth))[::-1]
    for count, size, pixels in zip(grid.shape, seen.shape[1:], scale, strict=True):
        step = float(grid.pitch) * float(pixels)
        pixel = np.rint((np.arange(count) - count // 2) * step + size // 2)
        picked.append(np.clip(pixel, 0, size - 1).astype(int))
    return seen[:, picked[0]][:, :, picked[1]]


def _corrected(start: Imprint, shown: Shown) -> Imprint:
    """`start` with what it is wrong by on all pairs alike, as far as they are many."""
    left = -surface_error(start, shown) / shown.strength[:, None, None]
    left = jnp.where(shown.counted > 0, left, jnp.nan)
    share = len(left) / (len(left) + TRUST)
    return replace(start, rest=start.rest + share * jnp.nan_to_num(jnp.nanmedian(left, 0)))


def surface_error(predictor: Imprint, shown: Shown) -> Float[Array, "n rows columns"]:
    """Predicted minus true surfaces, metres.

    Where the true one is at the end of the camera's range, all that lies beyond is right: a knock
    of twice the depth leaves the paper's range over a tenth of its ROI.
    """
    gap = shown.before + predictor.change(shown.before, shown.strength) - shown.after
    camera = predictor.grid.camera
    gap = jnp.where(shown.after > camera.z_max - EDGE, jnp.minimum(gap, 0.0), gap)
    return jnp.where(shown.after < camera.z_min + EDGE, jnp.maximum(gap, 0.0), gap)


def absolute_error(predictor: Imprint, shown: Shown) -> Float[Array, ""]:
    """The mean |predicted - true| / √strength over nodes that were seen before and after.

    Plans mostly use shallow strokes, and deep ones would outweigh them.  In units of 10 mm, that of
    the maps: Adam's epsilon is then far below the gradients.
    """
    weight = shown.counted / jnp.sqrt(shown.strength)[:, None, None]
    gap = jnp.abs(surface_error(predictor, shown)) * weight
    return 100.0 * gap.sum() / jnp.maximum(shown.counted.sum(), 1.0)


def descend(
    loss: Loss,
    start: Imprint,
    shown: Shown,
    key: Key[Array, ""],
    steps: int,
    step: float,
    fixed: Collection[str] = (),
    alike: Collection[float] = (0.0, 0.0, 0.0),
) -> Imprint:
    """`start` after `steps` steps of Adam, the first of length `step`, falling by half a cosine.

    Those of `SCALES` that are `fixed` stay as they are; maps stay the mirror images of themselves
    that are marked in `alike` (see `mirrors`).
    """
    # As numbers, so that each thing that is fixed or alike does not compile anew.
    free = {name: float(name not in fixed) for name in fitted(start)}
    return _descend(loss, start, shown, key, steps, step, free, jnp.asarray(alike, jnp.float32))


def fitted(predictor: Imprint) -> list[str]:
    """Those of `SCALES` that a predictor has: without a heap nothing of it."""
    return [name for name in SCALES if getattr(predictor, name) is not None]


@jax.jit(static_argnames=["loss"])
def _descend(
    loss: Loss,
    start: Imprint,
    shown: Shown,
    key: Key[Array, ""],
    steps: int | Array,
    step: float | Array,
    free: dict[str, float | Array],
    alike: Float[Array, "3"],
) -> Imprint:
    import optax

    count = shown.before.shape[0]
    adam = optax.scale_by_adam()

    def balanced(field):
        if field.ndim < 2:
            return field
        turned = zip(alike, images(field), strict=True)
        return (field + sum(weight * image for weight, image in turned)) / (1.0 + alike.sum())

    first = {name: balanced(getattr(start, name)) for name in free}
    zero = jax.tree.map(jnp.zeros_like, first)

    def moved(shift):
        maps = {name: first[name] + SCALES[name] * part for name, part in shift.items()}
        return replace(start, **maps)

    def one(number, state):
        shift, memory = state
        order = jax.random.permutation(jax.random.fold_in(key, number), count)
        some = Shown(*(part[order[: min(BATCH, count)]] for part in shown))
        slope = jax.grad(lambda shift: loss(moved(shift), some))(shift)
        slope = {name: balanced(free[name] * part) for name, part in slope.items()}
        with jax.numpy_dtype_promotion("standard"):  # optax's Adam counts in int32
            updates, memory = adam.update(slope, memory)
        length = step * 0.5 * (1.0 + jnp.cos(jnp.pi * jnp.float32(number) / steps))
        return jax.tree.map(lambda x, dx: x - length * dx, shift, updates), memory

    shift, _ = jax.lax.fori_loop(0, steps, one, (zero, adam.init(zero)))
    return moved(shift)
