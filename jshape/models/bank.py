"""A bank: one camera, some actions, and a predictor for each.  One pytree for all of them."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jshape import metric
from jshape._typing import Array, ArrayLike, Float
from jshape.actions import first_pixels, fits
from jshape.camera import Camera, check_camera, namespace
from jshape.errors import (
    BadCamera,
    BadImage,
    BadPosition,
    JShapeError,
    UnknownName,
    one_line,
    quoted,
)
from jshape.models import spread as spreads
from jshape.models.base import Predictor


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("camera", "predictors", "errors_mm", "intervals"),
    meta_fields=("actions", "kind"),
    drop_fields=("fitted_to",),
)
@dataclass(frozen=True, eq=False, repr=False)
class Bank:
    """The predictors of all actions, for one camera.  `kind` names the idea: "P" is f_P."""

    camera: Camera
    predictors: tuple[Any, ...]
    """One `Predictor` per action, in the order of `actions`."""
    actions: tuple[str, ...]
    """Names of the actions."""
    kind: str = "D"
    """The predictors' kind: "P", "D", "C", "CR", "DC" or "DCR"""
    errors_mm: Float[Array, "A"] | None = None
    """How wrong each action's prediction usually is: the mean |true - predicted| over its ROI on
    pairs that it was not fitted to, mm.  NaN: not known for that action; None: for none of them.
    In mm, so that it stays true below another camera."""
    intervals: Float[Array, "A 2"] | None = None
    """(mm, share) of each action: the law of its predictions' 80 % interval (`models.spread`).
    NaN: not known for that action; None: for none of them."""
    fitted_to: str = ""
    """The pairs that it was fitted to, in words; compiled code does not see it."""

    def __repr__(self) -> str:
        rois = ", ".join(f"{one_line(name, 30)} {w}x{h}" for name, (w, h) in self.rois.items())
        size = f"{self.camera.width}x{self.camera.height}"
        fitted_to = f", fitted to {self.fitted_to}" if self.fitted_to else ""
        return one_line(f"Bank({self.kind}: {rois}; camera {size}{fitted_to})", 400)

    def predictor(self, name: str) -> Predictor:
        """The predictor of one action.

        Raises:
          UnknownName: the bank has no such action.
        """
        if name not in self.actions:
            raise UnknownName("action", name, self.actions)
        return self.predictors[self.actions.index(name)]

    def roi(self, name: str) -> tuple[int, int]:
        """ROI size (w, h) of one action, pixels."""
        return self.predictor(name).roi

    @property
    def rois(self) -> dict[str, tuple[int, int]]:
        """ROI size (w, h) of every action, pixels."""
        return {name: self.roi(name) for name in self.actions}

    @property
    def largest_roi(self) -> tuple[int, int]:
        """The largest (w, h) over the actions, pixels; (1, 1) if there are none."""
        w, h = (max((roi[k] for roi in self.rois.values()), default=1) for k in (0, 1))
        return w, h

    @property
    def turns(self) -> bool:
        """Whether the hand can be turned: every predictor knows what it then does."""
        return all(predictor.turns for predictor in self.predictors)

    def placed(
        self, action: int, yaw: float | Array | np.floating | None = None, length: float = 1.0
    ) -> Predictor:
        """What an action does with the hand turned, along a path so many times as long.

        Args:
          action: its number.
          yaw: turn of the hand from u towards v, radians; None is not turned.
          length: multiple of the trained path's length.
        """
        hand = self.predictors[action]
        hand = hand if length == 1 else hand.lengthened(length)
        return hand if yaw is None else hand.turned(yaw)

    def error_of_d(self) -> Float[Array, "A"]:
        """By how much d of the whole image is usually wrong because one action was predicted.

        Only the action's ROI (w, h) is predicted, and a difference of absolute values is at most
        the absolute value of the difference, pixel by pixel.  So, whatever the goal,

            |d(true, goal) - d(predicted, goal)| <= mean |true - predicted| over the image
                                                  = its mean over the ROI * (w h) / (H W),

        and the mean over the ROI is `errors_mm` in units of I.  A gain below this may be none.

        Returns:
          Per action, in units of d; 0 where the error is not known.
        """
        if self.errors_mm is None:
            return jnp.zeros(len(self.actions), jnp.float32)
        sizes = [self.roi(name) for name in self.actions]
        share = np.array([w * h for w, h in sizes]) / (self.camera.height * self.camera.width)
        xp = namespace(self.errors_mm, self.camera)
        errors = xp.asarray(self.errors_mm, np.float32)
        known = xp.where(xp.isnan(errors), 0.0, errors) * share.astype(np.float32)
        return jnp.asarray(known / xp.asarray(metric.to_mm(1.0, self.camera)), jnp.float32)

    def seen_by(self, camera: Camera, depth: float) -> "Bank":
        """The same actions for another camera, of another resolution or height over the bed.

        Args:
          camera: the other one; it looks straight down too.
          depth: how far from it the bed is where actions are placed, metres.

        Raises:
          BadBank: predictors that are images of one camera, not of the bed (f_D, networks).
          BadCamera: a camera that makes no sense, or whose range does not hold `depth`.
        """
        check_camera(camera)
        if not float(camera.z_min) < depth < float(camera.z_max):
            raise BadCamera(
                f"depth {quoted(depth)} is not between z_min {camera.z_min} and z_max "
                f"{camera.z_max} (m)"
            )
        seen = tuple(predictor.seen_by(camera, depth) for predictor in self.predictors)
        return replace(self, camera=camera, predictors=seen)

    def half_width_mm(self, name: str, before: ArrayLike, after: ArrayLike) -> Float[Any, "*B h w"]:
        """Half of the 80 % interval of each pixel of a prediction, mm; NaN: not known.

        Args:
          name: of the action.
          before: (*B, h, w) of I before it, of any size.
          after: the same as predicted.

        Raises:
          UnknownName: the bank has no such action.
        """
        self.predictor(name)
        rows = np.full((len(self.actions), 2), np.nan) if self.intervals is None else self.intervals
        xp = namespace(before, after)
        change = metric.to_mm(xp.asarray(after) - xp.asarray(before), self.camera)
        nearby = spreads.around(change, spreads.radii_px(self.camera))
        return spreads.half_width_mm(rows[self.actions.index(name)], nearby)

    def predict(
        self,
        name: str,
        roi: ArrayLike,
        *,
        position: ArrayLike | None = None,
        strength: ArrayLike = 1.0,
    ) -> Float[Array, "*B h w"]:
        """ROIs of I after an action, clipped to [0, 1]; batch axes allowed.  Eq. lastMapping.

        Args:
          name: of the action.
          roi: (*B, h, w) of I.
          position: ROI centres (*B, 2) or (2,) as (u, v), pixels: tells a predictor that works in
            metres where the camera looks from.  None is the middle of the image.
          strength: how many times as deep as the trained action, (*B) or one number from 0.

        Raises:
          UnknownName: the bank has no such action.
          BadImage: the last two axes are not the action's (h, w), or not of real numbers in
            [0, 1]; NaN (no reading) is allowed.
          BadPosition: positions that are no (u, v) whose ROI is in the image.
          JShapeError: a strength that is no number from 0; or batches that do not fit together.
        """
        w, h = self.roi(name)
        if np.shape(roi)[-2:] != (h, w):
            raise BadImage(f"{name}: ROI has shape {np.shape(roi)}; its last axes must be {(h, w)}")
        _check_rois(name, roi)
        if position is None:
            position = (self.camera.width // 2, self.camera.height // 2)
        _check_positions(self.camera, name, position, (w, h))
        _check_strength(strength)
        try:
            batch = np.broadcast_shapes(
                np.shape(roi)[:-2], np.shape(position)[:-1], np.shape(strength)
            )
        except ValueError:
            raise JShapeError(
                f"{name}: {np.shape(roi)[:-2]} ROIs, {np.shape(position)[:-1]} positions and "
                f"{np.shape(strength)} strengths do not fit together"
            ) from None
        corner = jnp.asarray(first_pixels(np.asarray(position), (w, h)), jnp.int32)
        roi = jnp.broadcast_to(jnp.asarray(roi, jnp.float32), (*batch, h, w))
        strength = jnp.asarray(strength, jnp.float32)
        return jnp.clip(self.predictor(name)(roi, corner, strength), 0.0, 1.0)

    def spread(
        self,
        name: str,
        roi: ArrayLike,
        *,
        position: ArrayLike | None = None,
        strength: ArrayLike = 1.0,
    ) -> Float[Array, "*B h w"]:
        """Standard deviation of what `predict` gives, per pixel of I; NaN: not known.

        That of the normal law whose 80 % lie in the pixel's interval.  Arguments and errors are
        those of `predict`.
        """
        after = self.predict(name, roi, position=position, strength=strength)
        before = jnp.broadcast_to(jnp.asarray(roi, jnp.float32), after.shape)
        half = self.half_width_mm(name, before, after)
        return half / (spreads.PER_STD * metric.to_mm(1.0, self.camera))


def _known(values: ArrayLike) -> np.ndarray | None:
    """The numbers, where they are known: under `jit` they are not."""
    return None if isinstance(values, Tracer) else np.asarray(values)


def _check_rois(name: str, roi: ArrayLike) -> None:
    known = _known(roi)
    if known is None:
        return
    if known.dtype.kind != "f":
        raise BadImage(f"{name}: ROI has type {known.dtype}; I has floats in [0, 1]")
    seen = known[~np.isnan(known)]
    if seen.size and (seen.min() < -1e-5 or seen.max() > 1 + 1e-5):
        raise BadImage(
            f"{name}: ROI has values from {seen.min():g} to {seen.max():g}; I is in [0, 1]"
        )


def _check_positions(camera: Camera, name: str, position: ArrayLike, roi: tuple[int, int]) -> None:
    try:
        known = np.asarray(position)
    except ValueError:
        known = np.zeros(0)
    if known.shape[-1:] != (2,) or known.dtype.kind not in "iuf":
        raise BadPosition(f"{name}: position is {quoted(position)}; expected (..., 2) of u, v")
    if not np.isfinite(known).all() or not fits(camera, known.reshape(-1, 2), roi).all():
        raise BadPosition(
            f"{name}: its {roi[0]}x{roi[1]} ROI at {quoted(position)} leaves the "
            f"{camera.width}x{camera.height} image"
        )


def _check_strength(strength: Any) -> None:
    known = _known(strength)
    if known is None:
        return
    if known.dtype.kind not in "iuf" or not np.isfinite(known).all() or (known < 0).any():
        raise JShapeError(f"strength is {quoted(strength)}; it must be a number from 0")
