"""f_P: a tool learned per action, pressed into the ground to a depth set by what lies below it.

The paper closes with a coarse physical model refined by data; this is one.  On a metric grid seen
from above (`predict.ground`), with surfaces s as depth (positive is lower):

    r      = s - Σ reference·s              relief against the mean of the ground below the tool
    cut    = max(tool - r, 0), softly       what stands above the tool's underside
    change = give·cut + rest + swell·(volume - 1) + follow·r

`tool`, `give`, `rest`, `swell` and `follow` are maps over the grid, fitted to pairs together with
the weights of the reference.  f_D is the special case tool = -infinity, swell = follow = 0; what it
misses is that a tool levels the ground below it: where it presses, the surface after does not
depend on the one before.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jshape._typing import Array, Float, Int
from jshape.camera import Camera
from jshape.predict.ground import Ground

SOFT = 1e-3
"""How softly the tool's edge meets the ground, metres: contact fades over about this height."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Pressed:
    """f_P of one action: maps over a metric grid, and where the grid lies."""

    ground: Ground
    """The grid, and the camera that sees it."""
    reference: Float[Array, "rows columns"]
    """Logarithms of the weights of the ground's reference depth; softmax makes them sum to 1."""
    tool: Float[Array, "rows columns"]
    """How far the tool's underside is below the reference, metres."""
    give: Float[Array, "rows columns"]
    """Share of what stands above the underside that gives way.  Signed: beside the tool it may be
    below 0, where hills are felt by rising further."""
    rest: Float[Array, "rows columns"]
    """Change on ground of any shape, metres; negative is raised: the rims."""
    swell: Float[Array, "rows columns"]
    """Change when twice as much is displaced as on flat ground, metres."""
    follow: Float[Array, "rows columns"]
    """Change per metre of relief."""

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.ground.roi

    def seen_by(self, camera: Camera, depth: float) -> "Pressed":
        """The same action below another camera, with places `depth` metres from it."""
        return replace(self, ground=self.ground.seen_by(camera, depth))

    def __call__(
        self, roi: Float[Array, "*B h w"], place: Array, strength: float | Array = 1.0
    ) -> Float[Array, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].  Replaces Eq. Doutput.

        A stronger action lowers the tool by its depth times (strength - 1): one deeper knock, not
        several.  Below a strength of 0.2 all of it fades to nothing.
        """
        one = jnp.vectorize(self._of_one, signature="(h,w),(n),()->(h,w)")
        return one(roi, jnp.asarray(place), jnp.asarray(strength, jnp.float32))

    def _of_one(
        self, roi: Float[Array, "h w"], place: Int[Array, "2"], strength: Float[Array, ""]
    ) -> Float[Array, "h w"]:
        per_metre = self.ground.per_metre(place)
        before = self.ground.from_roi(self.ground.camera.z_max - roi / per_metre, place)
        after = before + self.change(before, strength)
        # The change as the camera sees it: what both looks blur alike drops out.
        seen_before, seen_after = self.ground.to_roi(jnp.stack([before, after]), place)
        return roi - (seen_after - seen_before) * per_metre

    def change(
        self, surface: Float[Array, "*B rows columns"], strength: float | Array = 1.0
    ) -> Float[Array, "*B rows columns"]:
        """How much lower the ground is after the action, metres."""
        weights = jax.nn.softmax(self.reference.reshape(-1)).reshape(self.reference.shape)
        relief = surface - _sum(surface * weights)
        give = jnp.maximum(self.give, 0.0)
        flat = _soft(self.tool)
        deepest = (give * flat + self.rest).max()
        lowered = (jnp.asarray(strength)[..., None, None] - 1.0) * deepest
        cut = _soft(self.tool - relief)
        cut_deeper = _soft(self.tool + lowered - relief)
        # Shares of the volume displaced on flat ground; 1 µm over the grid against 0 / 0.
        least = 1e-6 * give.size
        volume = _sum(give * cut) / (_sum(give * flat) + least)
        more = (_sum(give * cut_deeper) + least) / (_sum(give * cut) + least)
        rest = self.rest * jnp.where(self.rest < 0, more, 1.0)
        beside = rest + self.swell * (volume - 1.0) + self.follow * relief
        strength = jnp.asarray(strength)[..., None, None]
        whole = self.give * cut_deeper + jnp.clip(strength, 0.0, 1.0) * beside
        return jnp.clip(5.0 * strength, 0.0, 1.0) * whole


def _soft(height: Array) -> Array:
    """max(height, 0) with a soft corner, metres."""
    return SOFT * jax.nn.softplus(height / SOFT)


def _sum(field: Array) -> Array:
    """Over the grid, kept as two axes of 1."""
    return field.sum((-2, -1), keepdims=True)
