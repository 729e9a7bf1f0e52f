"""f_C: a U-Net draws the ROI after the action (Eq. Coutput)."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp

from jshape._typing import Array, Float
from jshape.camera import STATIC
from jshape.models.base import Predictor, per_roi


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Network(Predictor):
    """f_C of one action: the parameters of a U-Net from ROI to ROI (see `models.unet`)."""

    params: dict[str, Any]
    """Nested dicts of float32 arrays; the width is in their shapes."""
    size: tuple[int, int] = field(metadata=STATIC)
    """ROI size (w, h), pixels."""

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.size

    def __call__(
        self, roi: Float[Array, "*B h w"], corner: Array, strength: float | Array = 1.0
    ) -> Float[Array, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].  Eq. Coutput.

        A network knows one depth only, so an action of another strength changes that many times as
        much as it says.  `corner` is ignored.  The network sees the ROI's mean where there is no
        reading (NaN): level with its surroundings, in training as in use; the result stays NaN.
        """
        from jshape.models import unet

        seen = jnp.isfinite(roi)
        count = jnp.maximum(seen.sum((-2, -1), jnp.float32, keepdims=True), 1.0)
        mean = jnp.where(seen, roi, 0.0).sum((-2, -1), keepdims=True) / count
        after = unet.apply(self.params, jnp.where(seen, roi, mean))
        return scaled(roi, after, strength)


def scaled(
    roi: Float[Array, "*B h w"], after: Float[Array, "*B h w"], strength: float | Array
) -> Float[Array, "*B h w"]:
    """The change from `roi` to `after`, times the strength (*B) or one number."""
    return roi + per_roi(strength, roi) * (after - roi)
