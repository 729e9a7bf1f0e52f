"""What every planner takes and gives back."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import jax

from jshape._typing import Array, Float, Int


class Status(IntEnum):
    """Why a plan ends."""

    CONVERGED = 0
    """The distance left is at most the tolerance, up to rounding."""
    MAX_STEPS = 1
    """As many actions as allowed."""
    NO_IMPROVEMENT = 2
    """No action lowers the distance by more than the least gain asked for."""

    @property
    def meaning(self) -> str:
        """The same in words."""
        return {
            Status.CONVERGED: "the distance left is within the tolerance",
            Status.MAX_STEPS: "as many actions as allowed",
            Status.NO_IMPROVEMENT: "no further action is predicted to gain enough",
        }[self]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Limits:
    """When a search stops.  Numbers, traced: changing one does not recompile."""

    min_gain: float | Array = 0.0
    """An action must lower d by more than this."""
    tolerance: float | Array = 0.0
    """The paper's accuracy d̄: the search has converged when d is at most this."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Found:
    """The sequence a search found, in storage of fixed size: K = max_steps; B under `vmap`."""

    steps: Int[Any, "*B"]
    """How many actions: entries past this are fillers."""
    chosen: Int[Any, "*B K"]
    """Candidate numbers, -1 past the end."""
    patches: Float[Any, "*B K hmax wmax"]
    """Predicted ROI of each step, clipped to [0, 1], in the upper left corner."""
    clipped: Float[Any, "*B K"]
    """Share of that ROI's pixels which were clipped."""
    status: Int[Any, "*B"]
    """A `Status`."""
    evaluations: Int[Any, "*B"]
    """How many ROI predictions were made."""
