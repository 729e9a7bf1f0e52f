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

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float, Int
from jshape.camera import STATIC, Camera, in_memory, namespace
from jshape.errors import BadBank, quoted
from jshape.models.base import Predictor
from jshape.models.imprint_change import PreparedImprint, soft, summed
from jshape.models.orthographic import OrthographicGrid
from jshape.models.stretch import stretch, widened
from jshape.models.turn import square, turn

ONE_WAY = 0.3
"""Share by which a change differs from itself after half a turn if it goes one way.  Of the actions
with a heap in the bundled bank: grasp 1.34, scoop 0.79, sweep 0.63, pinch 0.08, pour 0.00."""
LONGEST = 10.0
"""Most times that a path can be as long as the trained one."""


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
    path: float | None = field(default=None, metadata=STATIC)
    """Length of the trained path along u, whose middle is the place, metres; None without one."""

    @property
    def path_mm(self) -> float:
        """Length of the trained path, mm; 0 if it has none."""
        return 1e3 * (self.path or 0.0)

    @property
    def directed(self) -> bool:
        """Whether it has a path, or a heap and does to a flat bed another thing after half a turn.

        What is poured lies round, and what fingers close on from two sides lies at both.
        """
        if self.path is not None or self.height is None:
            return self.path is not None
        one = in_memory(self)
        change = one.change(np.full(one.grid.shape, one.grid.depth, np.float32))
        # Node 0 of an even number has no opposite one.
        turned = np.roll(np.flip(change), [1 - n % 2 for n in change.shape], (0, 1))
        return bool(np.abs(change - turned).sum() > ONE_WAY * np.abs(change).sum())

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
        maps = self._moved(lambda fields, outside: turn(fields, yaw, shape, outside), yaw)
        grid = replace(self.grid, shape=shape, roi=square(self.roi))
        return replace(self, grid=grid, path=None, **maps)  # its path is no longer along u

    def lengthened(self, length: float) -> "Imprint":
        """The same hand along a path `length` times as long; its window grows or shrinks with it.

        The longer furrow displaces more, and the heap holds its share of that.  The shape follows
        from the numbers, so they must be known; `stretch` is traceable.

        Raises:
          BadBank: it has no path along u (a turned one: lengthen it first), or no such length.
        """
        if self.path is None:
            raise BadBank("this predictor has no path along u to lengthen; lengthen before turning")
        if not 0 < length <= LONGEST:
            raise BadBank(f"length is {quoted(length)}; expected above 0, up to {LONGEST:g}")
        (rows, columns), (w, h) = self.grid.shape, self.roi
        more, pitch = (length - 1.0) * self.path, float(self.grid.pitch)
        columns, nodes = widened(columns, more / pitch), self.path / pitch
        maps = self._moved(lambda fields, edge: stretch(fields, length, nodes, columns, edge))
        roi = widened(w, more * float(self.grid.camera.scale(float(self.grid.depth))[0])), h
        grid = replace(self.grid, shape=(rows, columns), roi=roi)
        return replace(self, grid=grid, path=length * self.path, **maps)

    def _moved(self, how: Any, *numbers: Any) -> dict[str, Any]:
        """All maps after `how`, which is given them and what is beyond their edges."""
        xp = namespace(self, *numbers)
        outside = {k: far for k, far in _OUTSIDE.items() if getattr(self, k) is not None}
        fields = xp.stack([xp.asarray(getattr(self, name)) for name in outside])
        moved = how(fields, np.array(list(outside.values()), np.float32))
        return dict(zip(outside, moved, strict=True))

    def change(
        self, surface: Float[Any, "*B rows columns"], strength: Any = 1.0
    ) -> Float[Any, "*B rows columns"]:
        """How much lower the bed is after the action, metres."""
        return self.on_grid().change(surface, strength)

    @property
    def deepest(self) -> Float[Array, ""]:
        """Greatest lowering of a flat bed at strength 1, metres: a stroke where none is known."""
        return (jnp.maximum(self.give, 0.0) * soft(self.tool) + self.rest).max()

    def search_grid(self) -> OrthographicGrid:
        """Its own: what it does there is the same at every place."""
        return self.grid

    def on_grid(self) -> "PreparedImprint":
        """What of a change does not depend on the bed, computed once for many beds."""
        xp = namespace(self)
        give, least = xp.asarray(self.give), np.float32(1e-6 * self.give.size)
        weights = xp.exp(xp.asarray(self.reference) - xp.asarray(self.reference).max())
        # 1 µm over the grid against 0 / 0.
        volume = summed(soft(xp.asarray(self.tool)), xp.maximum(give, np.float32(0))) + least
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
