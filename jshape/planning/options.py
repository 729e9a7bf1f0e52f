"""What a plan may try, must keep to, ends at and may spend.

`jshape.plan`, `jshape.plan_depth`, `mold`, the command line and jshape.toml all take these four
records; their defaults, which the studio plans with, stand here alone.  They suit goals that the
trained hand did not make: dense positions, gentle and deep strengths, turned hands, and no action
that gains less than half of its usual error or than noise may feign.  `PAPER` is the paper's own
search.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import wraps
from typing import Any

from jshape._typing import ArrayLike
from jshape.errors import BadOption, JShapeError, did_you_mean, quoted

DEFAULT_BANK = "pressed-flour-robot"
YAWS = 4
"""Of the hand, where the bank's predictors can be turned and nothing else is said.  A stroke 40 mm
wide and 140 mm long, 15 mm deep: 0.288 mm become 0.078 in 3 actions, with one yaw 0.179 in 8."""
STRIDE = 12
"""Pixels between positions, where the ROIs are not small and nothing else is said."""
ERROR_MARGIN = 0.5
"""Where the bank knows its errors and nothing else is said."""
FEIGNED = 3.0
"""Least gain, in standard deviations of what noise adds to the gain of one action: the best of some
hundred windows that do not overlap seems to gain as much by chance alone."""


WINDOW = "for a part of the frames, set both to NaN beyond it (jshape.plan_depth)"
"""What to do where the command line has `--window`."""


def hinted(function: Callable) -> Callable:
    """A function that says what may have been meant by a keyword it does not have."""
    known = inspect.signature(function).parameters

    @wraps(function)
    def call(*args: Any, **keywords: Any) -> Any:
        for name in keywords:
            if name not in known:
                raise BadOption(f"{function.__qualname__}: {_unknown(name, list(known))}")
        return function(*args, **keywords)

    return call


def _unknown(name: str, known: Sequence[str]) -> str:
    for group, kind in GROUPS.items():
        if name in _names(kind):
            where = f"{group}={kind.__name__}({name}=...)"
            return f"unknown option {quoted(name)}; it is a field of {group}: {where}"
    if name == "window":
        return f"unknown option {quoted(name)}; {WINDOW}"
    near = did_you_mean(name, [*known, *(one for kind in GROUPS.values() for one in _names(kind))])
    return f"unknown option {quoted(name)}{near or '; allowed: ' + ', '.join(known)}"


def _names(kind: type) -> list[str]:
    return [one.name for one in fields(kind)]


@dataclass(frozen=True)
class SearchSpace:
    """What is tried: where, how deep and with which yaws."""

    positions: ArrayLike | Mapping[str, ArrayLike] | str | None = None
    """ROI centres (N, 2) of (u, v) for all actions, a mapping of action to such, a grid "21x15"
    (columns x rows) that spans the image for each action, or "paper": the paper's 15, the same for
    all actions (default: every `stride` pixels, the best of them refined by a local search)."""
    stride: int | None = None
    """Distance of positions along u and v, pixels, where none are given (default: 12, or a quarter
    of the smallest ROI's shorter side where that is less)."""
    strengths: Sequence[float] = (0.2, 0.5, 1.0, 1.6, 2.3)
    """Strengths to try: multiples of the trained depth of an action."""
    yaws: int | Mapping[str, int] | None = None
    """Number of yaw angles to try, evenly over half a turn (over a whole one where the predictor is
    `directed`); 1: the hand is not turned (default: 4 where the bank's predictors can be turned).
    A mapping says it for each action."""
    lengths: Sequence[float] = (0.6, 1.0, 1.6)
    """Lengths to try of the hand's path, of actions that have one: multiples of the trained
    path."""
    carries: Mapping[str, str] | None = None
    """Actions that are tried in pairs: one takes material out, the other brings it elsewhere
    (default: scoop and pour, where the bank has both; no pairs: all are single actions)."""
    out_of_bounds: str = "refuse"
    """Treatment of given positions whose ROI leaves the image: "refuse", "shift" or "drop"."""


@dataclass(frozen=True)
class Constraints:
    """What is allowed."""

    reachable: ArrayLike | None = None
    """Mask (H, W), not 0 where the hand may be placed (default: everywhere)."""
    clearance_mm: float = 0.0
    """Least distance of positions to the image's edge and to what `reachable` leaves out, mm."""
    max_uses: Mapping[str, int] | None = None
    """Action and how often it may be used at most (default: no limit)."""
    stock_cm3: float | None = None
    """Material in a stock beside the bed, cm³, from which actions may bring some and to which they
    may take some out (default: no stock; what is taken out is brought elsewhere)."""
    max_missing: float = 0.1
    """Largest share, 0 to 1, of a depth image's pixels without a reading that may be filled."""

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Raise JShapeError where a field that says nothing here is not at its default."""
        for name in names:
            if getattr(self, name) != getattr(Constraints, name):
                raise JShapeError(f"constraints: {name} has no effect here: {why}")

    def of_images(self) -> "Constraints":
        """Those for images: frames were read already."""
        return replace(self, max_missing=Constraints.max_missing)


@dataclass(frozen=True)
class StopCriteria:
    """When the sequence ends."""

    max_steps: int = 16
    """Most actions in the plan."""
    min_gain_mm: float | None = None
    """Least gain of an action, mm (default: what the noise of bed and goal may feign)."""
    tolerance_mm: float = 0.0
    """Distance at which the goal counts as reached, mm."""
    error_margin: float | None = None
    """Least gain of an action, in multiples of the usual error of its prediction (default: 0.5
    where the bank knows its errors, else 0)."""


@dataclass(frozen=True)
class SearchBudget:
    """What the search may spend; it returns the best plan found until then."""

    seconds: float | None = None
    """Time limit, seconds, compiling not counted (default: none)."""
    evaluations: int | None = None
    """Most predictions made (default: no limit)."""


GROUPS: dict[str, type] = {
    "space": SearchSpace,
    "constraints": Constraints,
    "stop": StopCriteria,
    "budget": SearchBudget,
}
"""The records by the keyword that takes each."""
for _kind in GROUPS.values():
    setattr(_kind, "__init__", hinted(_kind.__init__))  # noqa: B010 - pyright allows only this

PAPER: dict[str, Any] = {
    "bank": "flour-robot",
    "space": SearchSpace(positions="paper", strengths=(1.0,), yaws=1),
    "stop": StopCriteria(min_gain_mm=0.0, error_margin=0.0),
}
"""The paper's search, as keywords of `jshape.plan`: f_D, 15 positions, one strength, no margin."""


def options(base: Mapping[str, Any] | None = None, /, **named: Any) -> dict[str, Any]:
    """Keywords of `jshape.plan` from single fields, such as `options(PAPER, max_steps=4)`.

    Args:
      base: keywords to begin with; None is none of them, hence the defaults.
      **named: fields of any of the records, or other keywords of `jshape.plan` as they are.  A
        stride alone takes the place of positions.

    Raises:
      BadOption: neither a field nor such a keyword.
    """
    found = dict(base or {})
    if "stride" in named:
        named = {"positions": None} | named
    for group, kind in GROUPS.items():
        mine = {name: named.pop(name) for name in _names(kind) if name in named}
        if mine:
            found[group] = replace(found.get(group) or kind(), **mine)
    for name in named:
        if name not in (*GROUPS, *OTHERS):
            raise BadOption(f"options: {_unknown(name, [*GROUPS, *OTHERS])}")
    return found | named


OTHERS = ("bank", "planner", "start", "execution", "camera", "depth_unit")
"""Keywords that are no records: `start` and `execution` are of `plan`, `camera` and `depth_unit` of
`plan_depth`, the others of both."""
