"""What a predictor is: what one action does to its region of interest (ROI)."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from jshape._typing import Array, Float
from jshape.camera import Camera, namespace
from jshape.errors import BadBank
from jshape.models.orthographic import OrthographicGrid


def per_roi(strength: Any, roi: Float[Any, "*B h w"]) -> Float[Any, "*B 1 1"]:
    """Strengths (*B) or one number, in the shape that multiplies ROIs."""
    xp = namespace(strength, roi)
    return xp.broadcast_to(xp.asarray(strength, np.float32), roi.shape[:-2])[..., None, None]


class Predictor(ABC):
    """What the ROI of one action becomes: a pytree, callable.

    `roi` and `__call__` are all that it needs.  The other hooks say what it can do beyond that;
    by default: nothing.
    """

    turns: ClassVar[bool] = False
    """Whether `turned` works: the search then tries several yaws of the hand."""
    carry_over: ClassVar[float | None] = None
    """What a change of the bed by 1 leaves after the action, node by node: something from 0 to 1,
    give or take this share of all changes below the window.  None: not known.  A search that knows
    it need not evaluate most candidates again after an action (see `evaluate.pending`)."""
    on_host: ClassVar[bool] = False
    """Whether it works on NumPy arrays with NumPy alone: then nothing is compiled for it."""

    path_mm: float = 0.0
    """Length of the trained action's path along the hand's x, mm; 0: it has none to lengthen."""
    directed: bool = False
    """Whether it differs when the hand is turned by half a turn, because it moves material one
    way: the search then tries yaws over a full turn."""

    @property
    @abstractmethod
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""

    @abstractmethod
    def __call__(
        self, roi: Float[Array, "*B h w"], corner: Array, strength: float | Array = 1.0
    ) -> Float[Array, "*B h w"]:
        """ROIs of I after the action, not yet clipped.

        Args:
          roi: of I before the action.
          corner: first pixels (u, v) of the ROIs in the image, (*B, 2) or (2,): a bed seen from the
            side looks different.
          strength: how many times as deep as the trained action, (*B) or one number.
        """

    def turned(self, yaw: float | Array | np.floating) -> "Predictor":
        """The same action, the hand turned by `yaw` radians from u towards v; a square ROI."""
        raise BadBank(f"a predictor of type {type(self).__name__} cannot turn the hand")

    def lengthened(self, length: float) -> "Predictor":
        """The same action along a path `length` times as long about its place; before `turned`.

        Raises:
          BadBank: it has no path.
        """
        raise BadBank(
            f"a predictor of type {type(self).__name__} has no path to lengthen; those of banks of "
            "kind 'P' that are fitted to pairs with path_mm have"
        )

    def seen_by(self, camera: Camera, depth: float) -> "Predictor":
        """The same action for another camera, `depth` metres above where actions are placed.

        Raises:
          BadBank: it predicts images of one camera.
        """
        raise BadBank(
            f"a predictor of type {type(self).__name__} is bound to its camera; those of banks of "
            "kind 'P' are not"
        )

    def search_grid(self) -> OrthographicGrid | None:
        """The orthographic grid on which `on_grid` works; None: it works on images only.

        A bank whose predictors all have one is searched on that grid.
        """
        return None

    def on_grid(self) -> Any:
        """The action there, a pytree: (surface, first node (u, v), strength) -> surface after.

        Where its maps of the grid's shape are 0 it changes nothing: a search puts zeros around
        them, so that windows of several sizes share one compiled kernel.
        """
        raise NotImplementedError
