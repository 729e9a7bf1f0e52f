"""What f_P is made of, switched off one at a time and added one at a time from f_D upwards."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.ndimage import map_coordinates

from jshape._typing import Array, Float, Int
from jshape.camera import Camera
from jshape.data.pairs import Examples, Pairs
from jshape.learn import imprint
from jshape.learn.first_guess import OF_TOOL, Shown, begin
from jshape.learn.fit import fit
from jshape.learn.scores import Trial, roi_errors_mm
from jshape.learn.study import split_pairs
from jshape.models.bank import Bank
from jshape.models.imprint import Imprint
from jshape.models.orthographic import OrthographicGrid

MEAN, WHOLE = "f_D", "f_P"
"""Where the components are added to, and what has them all."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AsSeen(OrthographicGrid):
    """The image I itself in place of the ground: no view from above, and R stays in it."""

    def from_roi(
        self, depth: Float[Array, "h w"], corner: Int[Array, "2"]
    ) -> Float[Array, "rows columns"]:
        """Each node is a place of the ROI, wherever the ROI is in the image."""
        at = (
            (jnp.arange(n, dtype=jnp.float32) - n // 2) * step + m // 2
            for n, m, step in self._sides()
        )
        return _sampled(depth, *at)

    def to_roi(
        self, surface: Float[Array, "B rows columns"], corner: Int[Array, "2"]
    ) -> Float[Array, "B h w"]:
        """And back."""
        at = [
            (jnp.arange(m, dtype=jnp.float32) - m // 2) / step + n // 2
            for n, m, step in self._sides()
        ]
        return jax.vmap(lambda one: _sampled(one, *at))(surface)

    def per_metre(self, corner: Int[Array, "2"]) -> Float[Array, "h w"]:
        """The same for every pixel."""
        w, h = self.roi
        return jnp.full((h, w), 1.0 / (self.camera.z_max - self.camera.z_min), jnp.float32)

    def _sides(self) -> list[tuple[int, int, float | Array]]:
        """Of rows and columns: nodes, pixels, and pixels from node to node."""
        per_pixel = self.pitch / self.depth
        focals = self.camera.fy, self.camera.fx
        return [(n, m, per_pixel * f)
                for n, m, f in zip(self.shape, self.roi[::-1], focals, strict=True)]  # fmt: skip


def _sampled(
    surface: Float[Array, "n m"], rows: Float[Array, "h"], columns: Float[Array, "w"]
) -> Float[Array, "h w"]:
    """Linear interpolation on all crossings of rows and columns; beyond the edge, the edge."""
    return map_coordinates(surface, jnp.meshgrid(rows, columns, indexing="ij"), 1, mode="nearest")


def squared_error(predictor: Imprint, shown: Shown) -> Float[Array, ""]:
    """As `learn.imprint.absolute_error`, of squares."""
    weight = shown.counted / jnp.sqrt(shown.strength)[:, None, None]
    gap = 1e4 * imprint.surface_error(predictor, shown) ** 2 * weight
    return gap.sum() / jnp.maximum(shown.counted.sum(), 1.0)


class Variant(NamedTuple):
    """f_P without some of its components; or f_D."""

    name: str
    """In rows: "f_D", "f_P", "f_P without tool", "f_D with view, absolute"."""
    said: str
    """The step in words: "+ learned reference", "without rims"; what it is for f_D and f_P."""
    without: tuple[str, ...] = ()
    """The components left out, see `fit_variant`."""
    view: type[OrthographicGrid] = OrthographicGrid


SAID = {
    "view": "view from above",
    "depth": "depth of the places",
    "absolute": "absolute error",
    "tool": "tool that levels",
    "rest": "rims",
    "reference": "learned reference",
    "swell": "growing rims",
    "follow": "following the relief",
    "mirror": "mirror images",
    "heap": "heap of what is moved",
    "stroke": "own stroke",
    "deep": "rims of deep strokes",
}
"""The components in words."""
STEPS_UP = {
    "view": "+ view from above, depth of the places, rims on nodes",
    "absolute": "+ fit by descent, absolute error",
}
"""Steps up from f_D that bring more than the one component."""
STEPS_DOWN = {
    "absolute": "squared error instead",
    "tool": "without tool that levels and growing rims",
}
"""Steps down from f_P that are more than to leave one component out, or something else."""
ADDED = ("absolute", "mirror", "tool", "reference", "swell", "follow", "stroke", "deep", "heap")
"""In this order to the mean change seen from above."""
OF_STRENGTHS = ("stroke", "deep")
"""What pairs of one strength say nothing about."""


def added(varied: bool) -> list[Variant]:
    """From f_D to f_P, each with one more; `varied` says that pairs have several strengths."""
    names = [name for name in ADDED if varied or name not in OF_STRENGTHS]
    found = [
        Variant(MEAN, "mean change of the image"),
        Variant(f"{MEAN} with view", STEPS_UP["view"], ("descent", *names)),
    ]
    for k, name in enumerate(names, 1):
        last = k == len(names)
        # Rims and what is beside the tool are there from the start: the mean change.
        label = WHOLE if last else f"{MEAN} with view, {', '.join(names[:k])}"
        said = STEPS_UP.get(name, f"+ {SAID[name]}")
        found.append(Variant(label, said, tuple(names[k:])))
    return found


def left_out(varied: bool) -> list[Variant]:
    """f_P, and f_P without each of its components."""
    found = [Variant(WHOLE, "all components")]
    for name, said in SAID.items():
        if varied or name not in OF_STRENGTHS:
            without, view = ((), AsSeen) if name == "view" else ((name,), OrthographicGrid)
            said = STEPS_DOWN.get(name, f"without {said}")
            found.append(Variant(f"{WHOLE} without {name}", said, without, view))
    return found


def fit_variant(variant: Variant, examples: Examples, camera: Camera, seed: int = 0) -> Imprint:
    """As `fit_imprint` from nothing, without some components.

    "depth": looking for the depth of the places, else it is the median; "descent": fitting, else it
    is the first guess; "absolute": the absolute error, else its square; "mirror": maps that are
    mirror images of themselves; "heap": of what is moved; "tool": what levels, `tool` and `give`,
    else all is `rest`, and there is no `swell` either, which goes with what the tool displaces; and
    each of the other maps, which then stays 0, or for "reference" and "stroke" as first guessed.
    """
    out = {*variant.without, *(OF_TOOL if "tool" in variant.without else ())}
    filled, seen = imprint.complete(examples)
    depths = (0,) if "depth" in out else imprint.DEPTHS
    grid = imprint.grid_below(variant.view.over(camera, filled.roi), filled, depths)
    shown = imprint.shown_on(grid, filled, seen)
    first, fixed, alike = begin(grid, shown, out)
    out |= {*fixed}
    blank = {name: jnp.zeros_like(first.rest) for name in ("rest", "swell") if name in out}
    first = replace(first, **blank)
    if "mirror" in out:
        alike = (0.0, 0.0, 0.0)
    if "descent" in out:
        return first
    loss = squared_error if "absolute" in out else imprint.absolute_error
    key, steps = jax.random.key(seed), imprint.steps_for(len(seen), alike)
    fixed = out & set(imprint.SCALES)
    found = imprint.descend(loss, first, shown, key, steps, imprint.STEP, fixed, alike)
    return replace(found, stroke=found.deepest) if (shown.strength == 1.0).all() else found


def bank_of(variant: Variant, pairs: Pairs, seed: int) -> Bank:
    """A variant fitted to the pairs of one agent."""
    if variant.name == MEAN:
        return fit(pairs, "D")
    predictors = tuple(
        fit_variant(variant, pairs.rois(name), pairs.camera, seed) for name in pairs.actions
    )
    return Bank(pairs.camera, predictors, pairs.actions, "P")


class Trials:
    """Variants over partitions; each step of the iteration is one variant fitted to one agent."""

    def __init__(self, pairs: Pairs, variants: Sequence[Variant], partitions: int, seed: int):
        """As `learn.study.Study`; a variant that does what another does is fitted once."""
        self.pairs, self.partitions, self.seed = pairs, partitions, seed
        self.alike: dict[tuple, list[Variant]] = {}
        for one in dict.fromkeys(variants):
            what = (one.name == MEAN, frozenset(one.without), one.view)
            self.alike.setdefault(what, []).append(one)
        self.agents = list(dict.fromkeys(pairs.agent.tolist()))

    def __len__(self) -> int:
        return len(self.alike) * self.partitions * len(self.agents)

    def __iter__(self) -> Iterator[list[Trial]]:
        for splits in split_pairs(self.pairs, self.partitions, seed=self.seed):
            for agent, split in splits.items():
                training, tested = (self.pairs.select(index) for index in split)
                for variants in self.alike.values():
                    bank = bank_of(variants[0], training, self.seed)
                    yield self._tested(bank, variants, agent, training, tested)

    def _tested(
        self, bank: Bank, alike: Sequence[Variant], agent: str, training: Pairs, tested: Pairs
    ) -> list[Trial]:
        found = []
        for action, mine in tested.by_action():
            errors = roi_errors_mm(bank, mine, action, size=self.pairs.roi_size(action))
            count = int((training.action == action).sum())
            found += [Trial(v.name, agent, agent, action, count, mine.id, *errors) for v in alike]
        return found
