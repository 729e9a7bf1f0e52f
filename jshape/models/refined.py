"""f_CR and f_DCR: a network inside B, the mean difference outside (Eq. RCoutput, DRCoutput)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jshape._typing import Array, Float
from jshape.models.base import Predictor, per_roi


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Refined(Predictor):
    """`inside` where the action changes most, shifted by μ; `outside` elsewhere."""

    inside: Predictor
    """F_C in f_CR, f_DC in f_DCR."""
    outside: Predictor
    """Of the same ROI size: f_D."""
    mask: Float[Array, "h w"]
    """B: 1 where the action changes a pixel most, else 0."""
    offset: Float[Array, ""]
    """μ in [-1, 1], units of I: makes the means of both predictors alike over B."""

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.mask.shape[1], self.mask.shape[0]

    def __call__(
        self, roi: Float[Array, "*B h w"], corner: Array, strength: float | Array = 1.0
    ) -> Float[Array, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].  Eq. RCoutput.

        μ is a part of the change, so the strength scales it like the rest.
        """
        inside = self.inside(roi, corner, strength) + per_roi(strength, roi) * self.offset
        within = jnp.broadcast_to(self.mask > 0, roi.shape)
        return jnp.where(within, inside, self.outside(roi, corner, strength))
