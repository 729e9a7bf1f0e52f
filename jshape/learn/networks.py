"""Fitting f_C, f_CR, f_DC and f_DCR: three parts, put together as in the paper's Fig. pred."""

from collections.abc import Iterator
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float
from jshape.camera import Camera
from jshape.data.pairs import Examples
from jshape.learn.settings import Training
from jshape.learn.training import Hooks, roi_loss, train
from jshape.models.base import Predictor
from jshape.models.difference import Difference, fit_difference
from jshape.models.network import Network
from jshape.models.refined import Refined
from jshape.models.sequential import Sequential


def fit_network(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Network:
    """f_C, a U-Net trained on the loss d (Eq. lossC)."""
    return _trained(examples, settings, cast(Network | None, start), hooks)


def fit_after_difference(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Sequential:
    """f_DC, a U-Net that is given I + ΔI (Eq. lossD)."""
    first = fit_difference(examples.prior, examples.posterior)
    lowered = examples._replace(prior=examples.prior + np.asarray(first.delta))
    network = cast(Network, cast(Sequential, start).second) if start is not None else None
    return Sequential(first, _trained(lowered, settings, network, hooks))


def fit_refined(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Refined:
    """f_CR (Eq. RCoutput)."""
    outside = fit_difference(examples.prior, examples.posterior)  # bad pairs fail before training
    inner = cast(Refined, start).inside if start is not None else None
    network = fit_network(examples, camera, settings, inner, hooks)
    return refine(network, outside, examples, settings)


def fit_after_difference_refined(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Refined:
    """f_DCR (Eq. DRCoutput)."""
    inner = cast(Refined, start).inside if start is not None else None
    inside = fit_after_difference(examples, camera, settings, inner, hooks)
    return refine(inside, cast(Difference, inside.first), examples, settings)


def _trained(
    examples: Examples, settings: Training, start: Network | None, hooks: Hooks
) -> Network:
    """A trained network, from `start` (whose width it keeps) or from the seed."""
    if start is None:
        from jshape.models import unet

        params = unet.init(jax.random.key(settings.seed), settings.width)
        start = Network(params, examples.roi)
    return train(roi_loss, start, examples, settings, hooks).params


def refine(
    inside: Predictor, outside: Difference, examples: Examples, settings: Training
) -> Refined:
    """`inside` with B and μ of these examples, all of them.

    μ is one number per action: the mean over B and the pairs of I + ΔI - f(I), where there are
    readings; 0 if B is empty.
    """
    mask = changed_most(np.asarray(outside.delta), settings.morphology)
    total, count = 0.0, 0
    for batch in _in_batches(examples, settings.batch):
        gap = np.asarray(_gap(inside, outside, batch), np.float64)[:, mask]
        total, count = total + np.nansum(gap), count + int(np.isfinite(gap).sum())
    offset = np.clip(total / max(count, 1), -1.0, 1.0)
    return Refined(
        inside, outside, jnp.asarray(mask, jnp.float32), jnp.asarray(offset, jnp.float32)
    )


def changed_most(delta: Float[np.ndarray, "h w"], morphology: str) -> np.ndarray:
    """B, (h, w) of bool: Otsu's threshold on |ΔI|, then erosion (above Eq. RCoutput).

    The paper names no structuring element: erosion takes a square of side 3.  "dilate" is what the
    authors' code does instead, with a square of side 1 + floor(w h / 3000).
    """
    import cv2  # not above: banks of other kinds are fitted without it

    size = np.abs(delta)
    top = float(size.max())
    if top == 0.0:
        return np.zeros(delta.shape, bool)
    # 16 bits over the actual range: 8 bits of [0, 1] leave a shallow action a dozen levels.
    levels = np.rint(size / top * 65535).astype(np.uint16)
    _, over = cv2.threshold(levels, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    if morphology == "dilate":
        side = 1 + delta.size // 3000
        mask = cv2.dilate(over, np.ones((side, side), np.uint8))
    else:
        mask = cv2.erode(over, np.ones((3, 3), np.uint8))
    return mask > 0


def _in_batches(examples: Examples, most: int) -> Iterator[Examples]:
    for start in range(0, len(examples.prior), most):
        yield examples.select(np.arange(start, min(start + most, len(examples.prior))))


@jax.jit
def _gap(inside: Predictor, outside: Predictor, batch: Any) -> Array:
    """I + ΔI - f(I), (B, h, w)."""
    return outside(batch.prior, batch.corner) - inside(batch.prior, batch.corner)
