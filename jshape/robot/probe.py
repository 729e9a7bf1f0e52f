"""A test press beside the goal: what it leaves tells the material and the hand."""

import numpy as np
from scipy.ndimage import uniform_filter

from jshape._typing import Bool, Float
from jshape.actions import PlacedAction
from jshape.errors import JShapeError
from jshape.models.bank import Bank
from jshape.planning.options import Constraints

BESIDE = 0.02
"""Largest share of what the goal asks for that may lie in the ROI of a test press."""


def probe(
    bank: Bank,
    image: Float[np.ndarray, "H W"],
    goal: Float[np.ndarray, "H W"],
    constraints: Constraints = Constraints(),
    known: Bool[np.ndarray, "H W"] | None = None,
) -> PlacedAction:
    """The bank's smallest action where the goal asks for least.

    Args:
      bank: its actions; those that move material along are left out.
      image: I of the bed now.
      goal: I wanted.
      constraints: of them `reachable` and `max_uses`.
      known: pixels with a reading; the press is where its whole ROI has one.  None: all.

    Raises:
      JShapeError: the goal asks for something wherever the hand may go.
    """
    uses = constraints.max_uses or {}
    names = [name for name in bank.actions if uses.get(name, 1) > 0]
    names = [name for name in names if not bank.predictor(name).path_mm] or names
    if not names:
        raise JShapeError("no action is allowed for a test press; leave --probe out")
    name = min(names, key=lambda name: int(np.prod(bank.roi(name))))
    w, h = bank.roi(name)
    asked = np.abs(goal - image).astype(np.float64)
    allowed = np.zeros(asked.shape, bool)
    allowed[h // 2 : asked.shape[0] - h + h // 2 + 1, w // 2 : asked.shape[1] - w + w // 2 + 1] = 1
    if constraints.reachable is not None:
        allowed &= np.asarray(constraints.reachable) > 0
    if known is not None:  # half a pixel of the ROI, whatever sums round to
        blind = uniform_filter(1.0 - known, size=(h, w))  # pyright: ignore
        allowed &= blind * (w * h) < 0.5
    inside = uniform_filter(asked, size=(h, w), mode="constant") * (w * h)  # pyright: ignore
    # Of places that are as good, the one whose surroundings ask for least.
    around = uniform_filter(asked, size=(3 * h, 3 * w), mode="nearest")  # pyright: ignore
    cost = np.where(allowed, inside + 1e-3 * around, np.inf)
    v, u = np.unravel_index(np.argmin(cost), cost.shape)
    share = float(inside[v, u]) / max(float(asked.sum()), 1e-12) if allowed.any() else 1.0
    if share > BESIDE:
        raise JShapeError(
            f"no place for a test press: wherever {name} may go, its ROI holds {share:.0%} of what "
            f"the goal asks for; at most {BESIDE:.0%} may be; leave --probe out"
        )
    return PlacedAction(name, (int(u), int(v)), roi=(w, h))
