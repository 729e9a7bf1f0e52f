"""f_D: the effect of an action is its average effect (Eq. DiffImage and Eq. Doutput)."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float
from jshape.camera import namespace
from jshape.errors import BadDataset
from jshape.models.base import Predictor, per_roi
from jshape.models.turn import square, turn


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Difference(Predictor):
    """f_D of one action: adds the mean change ΔI to a ROI."""

    turns: ClassVar[bool] = True
    carry_over: ClassVar[float | None] = 0.0
    on_host: ClassVar[bool] = True
    delta: Float[Any, "h w"]
    """ΔI, the mean of posterior minus prior over the training pairs, units of I."""

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.delta.shape[1], self.delta.shape[0]

    def __call__(
        self, roi: Float[Any, "*B h w"], corner: Any, strength: Any = 1.0
    ) -> Float[Any, "*B h w"]:
        """ROIs after the action, not yet clipped to [0, 1].  Eq. Doutput.

        An action of another strength changes that many times as much: f_D knows no better.
        """
        xp = namespace(self, roi, strength)
        return roi + per_roi(strength, roi) * xp.broadcast_to(self.delta, roi.shape)

    def turned(self, yaw: float | Array | np.floating) -> "Difference":
        """The same change turned by `yaw` radians from u towards v; its ROI becomes a square.

        As seen from straight above: f_D knows nothing of the view from the side.
        """
        w, h = square(self.roi)
        return replace(self, delta=turn(self.delta, yaw, (h, w)))


def fit_difference(
    prior: Float[np.ndarray, "N h w"],
    posterior: Float[np.ndarray, "N h w"],
    strength: Float[np.ndarray, "N"] | None = None,
) -> Difference:
    """f_D from N pairs of ROIs of I.  Eq. DiffImage.

    A pixel without a reading (NaN) in either image of a pair is left out of that pixel's mean.
    With pairs of several strengths x, ΔI is that for which x·ΔI is nearest to the changes, by least
    squares: Σ x·change / Σ x².  Without, x is 1 and that is the mean.

    Raises:
      BadDataset: no pairs, or a pixel that no pair has seen.
    """
    if len(prior) == 0:
        raise BadDataset("no pairs to average")
    change = np.asarray(posterior, np.float64) - np.asarray(prior, np.float64)
    seen = np.isfinite(change)
    count = seen.sum(0)
    if (count == 0).any():
        raise BadDataset(
            f"{int((count == 0).sum())} of {count.size} ROI pixels have no depth reading in any "
            f"of the {len(prior)} pairs"
        )
    if strength is None:
        delta = np.where(seen, change, 0.0).sum(0) / count
    else:
        times = np.asarray(strength, np.float64)[:, None, None]
        delta = np.where(seen, times * change, 0.0).sum(0) / (seen * times**2).sum(0)
    return Difference(jnp.asarray(delta, jnp.float32))
