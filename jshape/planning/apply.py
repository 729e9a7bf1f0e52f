"""A sequence of actions carried out on images, one ROI after the other.  Eq. predStep1 to 3."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.models.bank import Bank


def after_action(
    bank: Bank,
    image: Float[Any, "H W"],
    corner: Int[Any, "2"],
    strength: float | Array | np.floating = 1.0,
    yaw: float | Array | np.floating = 0.0,
    offset: Float[Any, "2"] | tuple[float, float] = (0.0, 0.0),
    *,
    action: int,
    turned: bool = False,
    moved: bool = False,
) -> tuple[Float[Array, "h w"], Float[Array, ""]]:
    """The ROI after an action, clipped to [0, 1], and the share of its pixels that was clipped.

    Args:
      bank: predicts.
      image: I before.
      corner: first pixel (u, v) of the ROI.
      strength: how many times as deep as the trained action.
      yaw: turn of the hand, radians, if `turned`.
      offset: how far the exact place is from the ROI's, pixels (u, v), if `moved`.
      action: its number in the bank.
      turned: the hand is turned; the ROI is a square.
      moved: the place is between pixels.
    """
    predictor = bank.predictors[action]
    if turned:
        predictor = predictor.turned(yaw)
    by = jnp.asarray(offset, jnp.float32) if moved else None
    strength = jnp.asarray(strength, jnp.float32)
    return _after(predictor, jnp.asarray(image), jnp.asarray(corner), strength, by)


@jax.jit
def _after(
    predictor: Any,
    image: Float[Array, "H W"],
    corner: Int[Array, "2"],
    strength: Float[Array, ""],
    offset: Float[Array, "2"] | None,
) -> tuple[Float[Array, "h w"], Float[Array, ""]]:
    w, h = predictor.roi
    roi = lax.dynamic_slice(image, corner[::-1], (h, w))
    if offset is None:
        raw = predictor(roi, corner, strength)
    else:
        # The bed as seen from the exact place, and what changes there put back.
        seen = shift(roi, offset)
        raw = roi + shift(predictor(seen, corner, strength) - seen, -offset)
    after = jnp.clip(raw, 0.0, 1.0)
    return after, (raw != after).mean(dtype=jnp.float32)


def shift(window: Float[Array, "n m"], by: Array) -> Float[Array, "n m"]:
    """`window` read `by` (u, v) nodes further, linearly interpolated; beyond the edge, the edge.

    By less than one node either way.
    """
    for axis in (0, 1):
        share = by[1 - axis]
        size = window.shape[axis]
        line = jnp.arange(size, dtype=jnp.int32)
        ahead = jnp.take(window, jnp.minimum(line + 1, size - 1), axis=axis)
        behind = jnp.take(window, jnp.maximum(line - 1, 0), axis=axis)
        rest = 1.0 - jnp.abs(share)
        window = rest * window + jnp.maximum(share, 0) * ahead + jnp.maximum(-share, 0) * behind
    return window
