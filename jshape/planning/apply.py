"""A sequence of actions carried out on images, one ROI after the other.  Eq. predStep1 to 3."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.camera import in_memory, namespace


def after_action(
    predictor: Any,
    image: Float[Any, "H W"],
    corner: Int[Any, "2"],
    strength: float | Array | np.floating = 1.0,
    offset: Float[Any, "2"] | None = None,
) -> tuple[Float[Any, "h w"], Float[Any, ""]]:
    """The ROI after an action, clipped to [0, 1], and the share of its pixels that was clipped.

    Args:
      predictor: of the action (see `Bank.placed`).
      image: I before.
      corner: first pixel (u, v) of the ROI.
      strength: how many times as deep as the trained action.
      offset: how far the exact place is from the ROI's, pixels (u, v); None: not at all.
    """
    whole = predictor, image, corner, strength
    host = predictor.on_host and namespace(*whole, offset) is np
    xp = np if host else jnp
    after = _after if host else _compiled
    return after(
        in_memory(predictor) if host else predictor,
        xp.asarray(image),
        xp.asarray(corner),
        xp.asarray(strength, np.float32),
        None if offset is None else xp.asarray(offset, np.float32),
    )


def _after(
    predictor: Any,
    image: Float[Any, "H W"],
    corner: Int[Any, "2"],
    strength: Float[Any, ""],
    offset: Float[Any, "2"] | None,
) -> tuple[Float[Any, "h w"], Float[Any, ""]]:
    xp = namespace(predictor, image, corner, strength, offset)
    w, h = predictor.roi
    if xp is np:
        roi = image[corner[1] : corner[1] + h, corner[0] : corner[0] + w]
    else:
        roi = lax.dynamic_slice(image, corner[::-1], (h, w))
    if offset is None:
        raw = predictor(roi, corner, strength)
    else:
        # The bed as seen from the exact place, and what changes there put back.
        seen = shift(roi, offset)
        raw = roi + shift(predictor(seen, corner, strength) - seen, -offset)
    after = xp.clip(raw, 0.0, 1.0)
    return after, (raw != after).mean(dtype=np.float32)


_compiled = jax.jit(_after)


def shift(window: Float[Any, "n m"], by: Any) -> Float[Any, "n m"]:
    """`window` read `by` (u, v) nodes further, linearly interpolated; beyond the edge, the edge.

    By less than one node either way.
    """
    xp = namespace(window, by)
    window, by = xp.asarray(window), xp.asarray(by)
    for axis in (0, 1):
        share = by[1 - axis]
        size = window.shape[axis]
        line = np.arange(size, dtype=np.int32)
        ahead = xp.take(window, np.minimum(line + 1, size - 1), axis=axis)
        behind = xp.take(window, np.maximum(line - 1, 0), axis=axis)
        rest = 1.0 - xp.abs(share)
        window = rest * window + xp.maximum(share, 0) * ahead + xp.maximum(-share, 0) * behind
    return window
