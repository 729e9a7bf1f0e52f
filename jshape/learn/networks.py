"""Fitting f_C, f_CR, f_DC and f_DCR: three parts, put together as in the paper's Fig. pred."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float
from jshape.camera import Camera
from jshape.data.pairs import Examples
from jshape.errors import BadDataset
from jshape.learn.settings import Training
from jshape.learn.training import Hooks, roi_loss, train
from jshape.models.base import Predictor
from jshape.models.difference import Difference, fit_difference
from jshape.models.network import Network
from jshape.models.refined import Refined
from jshape.models.sequential import Sequential


def fit_network(
    kind: str,
    examples: Examples,
    camera: Camera,
    settings: Training,
    start: Predictor | None,
    hooks: Hooks,
) -> Predictor:
    """A U-Net trained on the loss d, alone or as a part: C, DC, CR or DCR (the paper's Fig. pred).

    f_C (Eq. lossC); f_DC is given I + ΔI (Eq. lossD); f_CR and f_DCR are the same refined (Eq.
    RCoutput, Eq. DRCoutput).  The network begins as that of `start`, or from the seed.

    Raises:
      BadDataset: pairs of other strengths than 1, which it would average over; as `train`.
    """
    if (examples.strengths != 1.0).any():
        least, most = examples.strengths.min(), examples.strengths.max()
        raise BadDataset(
            f"pairs of strengths from {least:g} to {most:g}; networks are trained at a "
            "strength of 1 only, banks of kind P and D at any"
        )
    # Bad pairs fail before training.
    difference = None if kind == "C" else fit_difference(examples.prior, examples.posterior)
    network = start.inside if isinstance(start, Refined) else start
    network = network.second if isinstance(network, Sequential) else network
    if not isinstance(network, Network):  # that bank had nothing better than f_D: `validation`
        from jshape.models import unet

        params = unet.init(jax.random.key(settings.seed), settings.width)
        network = Network(params, examples.roi)
    seen = examples
    if difference is not None and kind.startswith("D"):
        seen = examples._replace(prior=examples.prior + np.asarray(difference.delta))
    inside = train(roi_loss, network, seen, settings, hooks).params
    if difference is None:
        return inside
    inside = Sequential(difference, inside) if kind.startswith("D") else inside
    return refine(inside, difference, examples, settings) if kind.endswith("R") else inside


def refine(
    inside: Predictor, outside: Difference, examples: Examples, settings: Training
) -> Refined:
    """`inside` with B and μ of these examples, all of them.

    μ is one number per action: the mean over B and the pairs of I + ΔI - f(I), where there are
    readings; 0 if B is empty.
    """
    mask = changed_most(np.asarray(outside.delta), settings.morphology)
    total, count = 0.0, 0
    for first in range(0, len(examples.prior), settings.batch):
        batch = examples.select(np.arange(len(examples.prior))[first : first + settings.batch])
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


@jax.jit
def _gap(inside: Predictor, outside: Predictor, batch: Any) -> Array:
    """I + ΔI - f(I), (B, h, w)."""
    return outside(batch.prior, batch.corner) - inside(batch.prior, batch.corner)
