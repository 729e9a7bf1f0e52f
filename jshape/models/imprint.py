"""f_P: a tool learned per action, pressed into the bed, and a heap of what it moved.

The paper closes with a coarse physical model refined by data; this is one.  On a metric grid seen
from above (`orthographic`), with surfaces s as depth (positive is lower):

    r      = s - Σ reference·s              relief against the mean of the bed below the tool
    cut    = max(tool + (x - 1)·stroke - r, 0), softly    what stands above the tool's underside
    change = give·cut + x·rest + (x - 1)·min(x, 1)·deep + swell·(volume - x) + min(x, 1)·follow·r

where x is the strength: how many times as deep as the trained action.  `tool`, `give`, `rest`,
`deep`, `swell` and `follow` are maps over the grid, fitted to pairs together with the number
`stroke` and the weights of the reference.  f_D is the special case tool = -infinity, deep = swell =
follow = 0; what it misses is that a tool levels the bed below it: where it presses, the surface
after does not depend on the one before.

An action that brings material or drags it along also has a heap, which fills the bed from below as
the tool cuts it from above:

    heaped = max(flow·r + height - 100 mm + rise·level, 0), softly
    level    such that Σ heaped = share·Σ give·cut + x·brought

which is taken from the change.  Where `flow` is 1 the heap's surface does not depend on the bed
before, and low places are filled first, as material slides; where it is 0, it lies on the bed as it
is.  Its sides are as steep as those of the map `height`: more volume, a wider heap.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float, Int
from jshape.camera import Camera, in_memory, namespace
from jshape.models.base import Predictor
from jshape.models.orthographic import OrthographicGrid
from jshape.models.turn import square, turn

SOFT = 1e-3
"""How softly the tool's edge meets the bed, metres: contact fades over about this height."""
NO_HEAP = 0.1
"""How far below the bed the heap is where its height is 0, metres: nothing of it shows."""
HEAP_STEPS = 3
"""Steps towards the heap's level; 6 predict the same to 0.004 mm on average, one differs by
0.01 to 0.24 mm."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Imprint(Predictor):
    """f_P of one action: maps over a metric grid, and where the grid lies."""

    turns: ClassVar[bool] = True
    on_host: ClassVar[bool] = True
    grid: OrthographicGrid
    """The grid, and the camera that sees it."""
    reference: Float[Any, "rows columns"]
    """Logarithms of the weights of the bed's reference depth; softmax makes them sum to 1."""
    tool: Float[Any, "rows columns"]
    """How far the tool's underside is below the reference, metres."""
    give: Float[Any, "rows columns"]
    """Share of what stands above the underside that gives way.  Signed: beside the tool it may be
    below 0, where hills are felt by rising further."""
    rest: Float[Any, "rows columns"]
    """Change on a bed of any shape, metres; negative is raised: the rims."""
    swell: Float[Any, "rows columns"]
    """Change when twice as much is displaced as on a flat bed, metres."""
    follow: Float[Any, "rows columns"]
    """Change per metre of relief."""
    deep: Float[Any, "rows columns"]
    """How much more than in proportion `rest` grows with strength, metres: a hand that closes
    heaps up more than twice as much when it is twice as deep."""
    stroke: Float[Any, ""]
    """How much farther down the underside is at a strength of 2, metres."""
    height: Float[Any, "rows columns"] | None = None
    """Of the heap's surface above `NO_HEAP` below the reference; like the next four None for an
    action without a heap."""
    rise: Float[Any, "rows columns"] | None = None
    """How much of the level the surface rises by: little in the tool's own path."""
    flow: Float[Any, "rows columns"] | None = None
    """Share of the relief that the heap levels."""
    share: Float[Any, ""] | None = None
    """Share of what the tool displaces that is heaped."""
    brought: Float[Any, ""] | None = None
    """Heaped at strength 1 whatever the bed is, metres times nodes."""

    @property
    def carry_over(self) -> float:
        """More than 0, since `follow`, `swell` and the mean of the bed below reach farther.

        0.1 was enough for all but 1 of 300,000 candidates of 30 actions.  A heap lays elsewhere
        all that finds no room.
        """
        return 0.2 if self.height is None else 1.2

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.grid.roi

    def seen_by(self, camera: Camera, depth: float) -> "Imprint":
        """The same action below another camera, with places `depth` metres from it."""
        return replace(self, grid=self.grid.seen_by(camera, depth))

    def __call__(
        self, roi: Float[Any, "*B h w"], corner: Any, strength: Any = 1.0
    ) -> Float[Any, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].  Replaces Eq. Doutput.

        A stronger action lowers the tool by `stroke` times (strength - 1): one deeper knock, not
        several.  Below a strength of 0.2 all of it fades to nothing.
        """
        single = np.ndim(roi) == 2 and np.ndim(corner) == 1 and np.ndim(strength) == 0
        if single and namespace(self, roi, corner, strength) is np:
            roi, corner = np.asarray(roi, np.float32), np.asarray(corner)
            return in_memory(self)._of_one(roi, corner, np.float32(strength))
        one = jnp.vectorize(self._of_one, signature="(h,w),(n),()->(h,w)")
        return one(roi, jnp.asarray(corner), jnp.asarray(strength, jnp.float32))

    def _of_one(
        self, roi: Float[Any, "h w"], corner: Int[Any, "2"], strength: Any
    ) -> Float[Any, "h w"]:
        xp = namespace(self, roi, corner, strength)
        per_metre = self.grid.per_metre(corner)
        before = self.grid.from_roi(self.grid.camera.z_max - roi / per_metre, corner)
        after = before + self.change(before, strength)
        # The change as the camera sees it: what both looks blur alike drops out.
        seen_before, seen_after = self.grid.to_roi(xp.stack([before, after]), corner)
        return roi - (seen_after - seen_before) * per_metre

    def turned(self, yaw: float | Array | np.floating) -> "Imprint":
        """The same hand turned by `yaw` radians from u towards v; its ROI becomes a square."""
        shape = square(self.grid.shape)
        xp = namespace(self, yaw)
        outside = {k: far for k, far in _OUTSIDE.items() if getattr(self, k) is not None}
        fields = xp.stack([xp.asarray(getattr(self, name)) for name in outside])
        turned = turn(fields, yaw, shape, np.array(list(outside.values()), np.float32))
        maps = dict(zip(outside, turned, strict=True))
        return replace(self, grid=replace(self.grid, shape=shape, roi=square(self.roi)), **maps)

    def change(
        self, surface: Float[Any, "*B rows columns"], strength: Any = 1.0
    ) -> Float[Any, "*B rows columns"]:
        """How much lower the bed is after the action, metres."""
        return self.on_grid().change(surface, strength)

    @property
    def deepest(self) -> Float[Array, ""]:
        """Greatest lowering of a flat bed at strength 1, metres: a stroke where none is known."""
        return (jnp.maximum(self.give, 0.0) * _soft(self.tool) + self.rest).max()

    def search_grid(self) -> OrthographicGrid:
        """Its own: what it does there is the same at every place."""
        return self.grid

    def on_grid(self) -> "PreparedImprint":
        """What of a change does not depend on the bed, computed once for many beds."""
        xp = namespace(self)
        give, least = xp.asarray(self.give), np.float32(1e-6 * self.give.size)
        weights = xp.exp(xp.asarray(self.reference) - xp.asarray(self.reference).max())
        # 1 µm over the grid against 0 / 0.
        volume = _sum(_soft(xp.asarray(self.tool)), xp.maximum(give, np.float32(0))) + least
        return PreparedImprint(
            weights=weights / weights.sum(),
            tool=self.tool,
            give=self.give,
            rest=self.rest,
            swell=self.swell,
            follow=self.follow,
            deep=self.deep,
            stroke=self.stroke,
            volume=volume,
            least=xp.asarray(least),
            height=self.height,
            rise=None if self.rise is None else xp.maximum(self.rise, np.float32(0)),
            flow=self.flow,
            share=self.share,
            brought=self.brought,
        )


_OUTSIDE = {"reference": -50.0, "tool": -0.1}
_OUTSIDE |= dict.fromkeys(("give", "rest", "swell", "follow", "deep"), 0.0)
_OUTSIDE |= dict.fromkeys(("height", "rise", "flow"), 0.0)
"""Beyond a turned map: not below the tool, 100 mm above any bed, no change, no heap."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PreparedImprint:
    """f_P ready for use: its maps, and what follows from them alone."""

    weights: Float[Any, "rows columns"]
    tool: Float[Any, "rows columns"]
    give: Float[Any, "rows columns"]
    rest: Float[Any, "rows columns"]
    swell: Float[Any, "rows columns"]
    follow: Float[Any, "rows columns"]
    deep: Float[Any, "rows columns"]
    stroke: Float[Any, ""]
    volume: Float[Any, "1 1"]
    """Displaced on a flat bed at strength 1, metres times nodes."""
    least: Float[Any, ""]
    height: Float[Any, "rows columns"] | None = None
    rise: Float[Any, "rows columns"] | None = None
    flow: Float[Any, "rows columns"] | None = None
    share: Float[Any, ""] | None = None
    brought: Float[Any, ""] | None = None

    def __call__(
        self, surface: Float[Any, "*B rows columns"], first: Any, strength: Any
    ) -> Float[Any, "*B rows columns"]:
        """The bed after the action, metres: the same wherever its first node is."""
        return surface + self.change(surface, strength)

    def change(
        self, surface: Float[Any, "*B rows columns"], strength: Any = 1.0
    ) -> Float[Any, "*C rows columns"]:
        """How much lower the bed is after the action, metres; batched over both arguments."""
        xp = namespace(self, surface, strength)
        strength = xp.asarray(strength, np.float32)[..., None, None]
        rank = max(surface.ndim, strength.ndim)

        def like(field: Any) -> Any:
            """With as many axes as the result."""
            return field.reshape(*[1] * (rank - field.ndim), *field.shape)

        surface, strength, give = like(surface), like(strength), like(self.give)
        shallow = xp.minimum(strength, 1.0)
        relief = surface - _sum(surface, self.weights)
        cut = _soft(like(self.tool) + (strength - 1.0) * self.stroke - relief)
        # Rims hold what was displaced: more of it, higher rims.
        displaced = _sum(cut, xp.maximum(self.give, 0.0)) + self.least
        volume = displaced / like(self.volume)
        beside = strength * like(self.rest) + (strength - 1.0) * shallow * like(self.deep)
        swell = like(self.swell) * (volume - strength)
        whole = give * cut + beside + swell + shallow * like(self.follow) * relief
        if self.height is not None:
            reach = like(self.flow) * relief + like(self.height) - NO_HEAP
            moved = self.share * displaced + self.brought * strength
            whole = whole - self._heaped(reach, like(self.rise), moved)
        return xp.clip(5.0 * strength, 0.0, 1.0) * whole

    def _heaped(self, reach: Any, rise: Any, volume: Any) -> Any:
        """What lies on the bed, metres, of a heap that would reach so far at level 0.

        Newton's steps of the root of its volume: that grows about as the level does.
        """
        xp = namespace(reach, rise, volume)
        volume, every = xp.maximum(volume, self.least), np.ones(reach.shape[-2:], np.float32)
        level = np.float32(0)
        for _ in range(HEAP_STEPS):
            height = reach + rise * level
            held = _sum(_soft(height), every)
            slope = _sum(_meets(height), self.rise)
            step = 2.0 * (xp.sqrt(held * volume) - held) / (slope + 1e-3)
            level = xp.clip(level + step, -0.05, 0.1)
        return _soft(reach + rise * level)


def _meets(height: Any) -> Any:
    """About the slope of `_soft`: from 0 to 1."""
    xp = namespace(height)
    t = height / np.float32(SOFT)
    return 0.5 + 0.5 * t / xp.sqrt(4.0 + t * t)


def _soft(height: Any) -> Any:
    """max(height, 0) with a soft corner, metres: SOFT * softplus(height / SOFT) to 0.2 µm.

    The rational function takes a third of the time of exponential and logarithm in a sweep.
    """
    xp = namespace(height)
    t = xp.abs(height) / np.float32(SOFT)
    corner = 1.0 + t * (0.18072232 + t * (0.03586025 + t * 0.0029687))
    corner = corner * corner
    return xp.maximum(height, np.float32(0)) + np.float32(SOFT * 0.6931472) / (corner * corner)


def _sum(field: Any, weights: Any) -> Any:
    """Σ weights·field over the grid, kept as two axes of 1.

    As a product with a vector, which a CPU computes in its vector units: a sweep takes half of the
    time that `sum` over both axes would.
    """
    traced = namespace(field, weights) is jnp
    product = partial(jnp.matmul, precision="highest") if traced else np.matmul
    if field.ndim == 2:
        ones = np.ones((1, len(field)), np.float32)
        return product(ones, field * weights).sum(-1, keepdims=True)
    flat = field.reshape(*field.shape[:-2], -1)
    return product(flat, weights.reshape(-1, 1))[..., None]
