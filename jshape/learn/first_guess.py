"""What an f_P starts from: what the mean change of its pairs says about an action."""

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from jshape._typing import Array, Float
from jshape.models.imprint import Imprint
from jshape.models.imprint_change import NO_HEAP, SOFT
from jshape.models.orthographic import OrthographicGrid

CONTACT = 0.3
"""The tool is first taken to touch where the mean change exceeds this share of its greatest."""
LOWERS = 0.1
"""An action whose mean change lowers nothing by this share of what it raises has no tool: a handful
that is poured displaces 0.1 mm and raises 18.  `swell` goes with what a tool displaces on flat
bed, and against next to nothing it predicted 14 mm off where the mean difference was 2.3."""
OF_TOOL = ("tool", "give", "swell", "share")
"""What stays as it is for an action without a tool; `swell` goes with what a tool displaces."""
HEAPED = 0.6
"""Share of what the mean change raises that is heaped at first; the rest are rims."""
IN_PATH = 0.1
"""Share of its level by which a heap rises in the tool's path: it fills holes there to the tool's
underside, and lies beside."""
STEEPNESS, FOOT = 0.6, 0.15
"""Of the heap's sides at first, and where they begin: at this share of its greatest height."""
ALIKE, ALIKE_OF, LEAST_PAIRS = 1.8, 0.5, 4
"""A mean change is its own mirror image if it differs from it by less than so many standard errors
of the mean and by less than this share of itself, both on average over the nodes, and is from at
least so many pairs.  Of eight actions, those that are differ by 0.4 to 1.3, the others by 2.4 to 13
standard errors."""


class Shown(NamedTuple):
    """What n pairs show on the height map."""

    before: Float[Array, "n rows columns"]
    """Surfaces as depth, metres."""
    after: Float[Array, "n rows columns"]
    counted: Float[Array, "n rows columns"]
    """1 where the node was seen before and after, else 0."""
    strength: Float[Array, "n"]


def begin(
    grid: OrthographicGrid, shown: Shown, out: Collection[str] = ()
) -> tuple[Imprint, tuple[str, ...], tuple[float, float, float]]:
    """Where a fit starts, what of it stays as it is, and which mirror images are alike.

    An action that lowers nothing has no tool but a heap; one that is not the same from all sides
    moves material to one of them, and has both.  `out` says what is left out: "tool", "heap".
    """
    mean, alike = _mean_change(shown), mirrors(shown)
    lowers = float(mean.max()) >= LOWERS * float(-mean.min())
    first = first_guess(grid, shown, tool=lowers and "tool" not in out)
    drags = len(shown.strength) >= LEAST_PAIRS and not all(alike)
    if "heap" not in out and (drags or not lowers):
        first = with_heap(first, shown)
    return first, fixed_of(first) if lowers else OF_TOOL, alike


def fixed_of(start: Imprint) -> tuple[str, ...]:
    """What of a predictor stays as it is in a fit that starts from it."""
    if start.height is None:
        return ()
    return ("swell", "brought") if bool(jnp.any(start.give)) else OF_TOOL


def mirrors(shown: Shown) -> tuple[float, float, float]:
    """1 where the action is its own mirror image, else 0: of rows, of columns, and of both.

    Such an action's maps are fitted as mirror images of themselves: each pair is worth several.
    Of two without the third only the nearest counts: two mirror images make the third, and the mean
    of a map and two of its images is no image of itself (fits to it diverged).
    """
    mean, count = np.asarray(_mean_change(shown)), len(shown.strength)
    if count < LEAST_PAIRS:
        return 0.0, 0.0, 0.0
    strength = np.asarray(shown.strength)[:, None, None]
    spread = np.asarray(shown.counted) * (shown.after - shown.before - strength * mean)
    error = np.sqrt((spread**2).sum(0) / (count - 1) / (strength**2).sum()).mean()
    least = min(ALIKE * float(error), ALIKE_OF * float(np.abs(mean).mean()))
    apart = np.array([np.abs(mean - np.asarray(image)).mean() for image in images(mean)])
    near = apart < least
    rows, columns, both = near if near.sum() != 2 else apart == apart.min()
    return float(rows), float(columns), float(both)


def images(field: Array | np.ndarray) -> list[Array]:
    """A map's mirror images about its middle node: of its rows, of its columns, of both."""

    def image(field: Array | np.ndarray, axis: int) -> Array:
        # Node 0 of an even number is its own image: the opposite one lies beyond the map.
        return jnp.roll(jnp.flip(field, axis), 1 - field.shape[axis] % 2, axis)

    return [image(field, 0), image(field, 1), image(image(field, 0), 1)]


def first_guess(grid: OrthographicGrid, shown: Shown, *, tool: bool = True) -> Imprint:
    """A tool as deep as the mean change, which is the prediction on a flat bed.

    Without a tool all of the mean change is `rest`.
    """
    mean = _mean_change(shown)
    touched = mean > CONTACT * jnp.maximum(mean.max(), 1e-9)
    touched = touched if tool else jnp.zeros_like(touched)
    rest = jnp.where(touched, 0.0, mean)
    none = jnp.zeros_like(mean)
    return Imprint(
        grid,
        reference=jnp.where(jnp.abs(mean) > 0.5 * jnp.abs(mean).max(), jnp.float32(0.0), -6.0),
        # Below the bed beside the tool by 3 mm: it is felt by hills, not by the flat.
        tool=mean - 3e-3,
        give=touched.astype(jnp.float32),
        rest=rest,
        swell=rest if tool else none,
        follow=none,
        deep=none,
        stroke=mean.max(),
    )


def with_heap(first: Imprint, shown: Shown) -> Imprint:
    """A first guess with part of what the mean change raises as a heap, or without a tool all."""
    mean = np.asarray(_mean_change(shown))
    path, up = np.asarray(first.give) > 0, np.maximum(-mean, 0.0)
    part = HEAPED if path.any() else 1.0
    foot = FOOT * up.max()
    away = np.asarray(distance_transform_edt(up <= foot)) * float(first.grid.pitch)
    surface = np.where(up > foot, -part * up, STEEPNESS * away - part * foot)
    floor = np.maximum(mean, CONTACT * mean.max()) + SOFT
    surface = np.where(path, floor, surface)
    rims = jnp.where(first.rest < 0, (1.0 - part) * first.rest, first.rest)
    volume = jnp.float32(part * up.sum())
    return replace(
        first,
        rest=rims,
        swell=(1.0 - part) * first.swell,
        height=jnp.asarray(np.clip(NO_HEAP - surface, 0.0, None), jnp.float32),
        rise=jnp.where(path, jnp.float32(IN_PATH), 1.0),
        flow=jnp.asarray(path if path.any() else np.ones_like(mean), jnp.float32),
        share=volume / first.on_grid().volume[0, 0] if path.any() else jnp.float32(0.0),
        brought=jnp.float32(0.0) if path.any() else volume,
    )


def _mean_change(shown: Shown) -> Float[Array, "rows columns"]:
    """The change that is nearest to all, each being its strength times as much, metres."""
    weight = shown.counted * shown.strength[:, None, None]
    whole = (weight * shown.strength[:, None, None]).sum(0)
    return ((shown.after - shown.before) * weight).sum(0) / jnp.where(whole > 0, whole, 1.0)
