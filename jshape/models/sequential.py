"""One predictor after another: f_DC is a network applied to what f_D predicts (Eq. lossD)."""

from dataclasses import dataclass

import jax

from jshape._typing import Array, Float
from jshape.models.base import Predictor
from jshape.models.network import scaled


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Sequential(Predictor):
    """What `second` makes of what `first` predicts, for one action."""

    first: Predictor
    """F_D in f_DC."""
    second: Predictor
    """Of the same ROI size; the network in f_DC."""

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.first.roi

    def __call__(
        self, roi: Float[Array, "*B h w"], corner: Array, strength: float | Array = 1.0
    ) -> Float[Array, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].

        The paper's Eq. lossD prints the input as Ia + ΔI, a slip for I + ΔI.  `second` was trained
        on one depth, so the strength scales the whole change and neither part.
        """
        return scaled(roi, self.second(self.first(roi, corner), corner), strength)
