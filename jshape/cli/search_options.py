"""The options of a search, for all commands that plan: the fields of `planning/options.py`."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from jshape.cli.options import (
    CarryOf,
    Common,
    Count,
    Devices,
    Duration,
    Nonnegative,
    PositiveCount,
    Positives,
    Share,
    Use,
)
from jshape.errors import BadPosition
from jshape.io import files
from jshape.io.records import Range, read_value
from jshape.planning.devices import over_devices
from jshape.planning.options import (
    GROUPS,
    Constraints,
    SearchBudget,
    SearchSpace,
    StopCriteria,
    options,
)
from jshape.planning.search import PLANNERS


@dataclass(frozen=True, kw_only=True)
class Tries(Common, SearchSpace, Constraints):
    """What plans may try and must keep to, as the command line reads it."""

    positions: Annotated[str | None, Parameter(metavar="CxR|FILE")] = None
    """Positions to try: a grid such as 21x15 for each action, paper (the paper's 15) or a JSON file
    (default: every `--stride` pixels)."""
    stride: PositiveCount | None = None
    strengths: Positives = field(default_factory=lambda: list(SearchSpace.strengths))
    yaws: PositiveCount | None = None
    """Number of yaw angles to try, evenly over half a turn (sweeps and scoops: a whole one); 1: the
    hand is not turned (default: 4 where the bank's predictors can be turned)."""
    lengths: Positives = field(default_factory=lambda: list(SearchSpace.lengths))
    carries: list[CarryOf] | None = None
    """Actions tried in pairs: the second brings what the first takes out; repeat the option for
    others (default: scoop=pour, where the bank has both)."""
    out_of_bounds: Literal["refuse", "shift", "drop"] = "refuse"
    """Treatment of given positions whose ROI leaves the image."""
    reachable: Annotated[str | None, Parameter(metavar="MASK")] = None
    """Mask image of the frames' size or the bank's, not 0 where the hand may be placed, or JSON: an
    area in metres of the arm's base or the map (default: everywhere)."""
    clearance_mm: Nonnegative = Constraints.clearance_mm
    max_uses: list[Use] | None = None
    """Action and how often it may be used at most; repeat the option for others."""
    stock_cm3: Nonnegative | None = None
    max_missing: Share = Constraints.max_missing
    max_steps: Count = StopCriteria.max_steps
    """Most actions in the plan."""


@dataclass(frozen=True, kw_only=True)
class Searches(Tries, StopCriteria, SearchBudget):
    """The fields of the records of `jshape.plan`."""

    planner: Annotated[str, Parameter(choices=tuple(PLANNERS), metavar="NAME")] = "greedy"
    """Search to plan with; greedy is the quickest."""
    devices: Devices | None = None
    """Devices that share the work (default: every accelerator, or the CPU as one)."""
    max_steps: Count = StopCriteria.max_steps
    min_gain_mm: Nonnegative | None = None
    """Least gain of an action, mm (default: what the noise of bed and goal may feign)."""
    tolerance_mm: Nonnegative = StopCriteria.tolerance_mm
    error_margin: Nonnegative | None = None
    seconds: Duration | None = None
    evaluations: PositiveCount | None = None


Pixel = Annotated[int, Range(-(2**31), 2**31 - 1)]
FIELDS = tuple(one.name for kind in GROUPS.values() for one in fields(kind))
"""Of the records."""
KEPT = ("planner", "batch", "adapt", *FIELDS)
"""Options that a resumed run keeps."""


def search_of(given: Searches) -> dict[str, Any]:
    """Keywords of `jshape.plan` from the options, but the reachable mask."""
    found = tries_of(given)
    if "planner" in given.given:
        found["planner"] = given.planner
    return options(None, execution=over_devices(given.devices), **found)


def tries_of(given: Tries) -> dict[str, Any]:
    """Fields of the records of `jshape.plan` that were given, but the reachable mask."""
    found = {name: getattr(given, name) for name in FIELDS if name in given.given}
    found.pop("reachable", None)
    if "positions" in found:
        found["positions"] = _positions(found["positions"])
    for name in ("max_uses", "carries"):
        if name in found:
            found[name] = dict(found[name])
    return found


def kept_of(given: Searches) -> dict[str, Any]:
    """The options of `KEPT` that were given, as a run keeps them."""
    found = {name: getattr(given, name) for name in KEPT if name in given.given}
    for name in ("max_uses", "carries"):
        if getattr(given, name):
            found[name] = [f"{one}={other}" for one, other in getattr(given, name)]
    return found


def _positions(text: str) -> np.ndarray | str:
    """Positions named on the command line: a grid as for `jshape.plan`, or a JSON file."""
    if Path(text).suffix.lower() != ".json":
        return text
    places, where = files.read_json(text).get("positions"), f"{text}: positions"
    found = read_value(list[tuple[Pixel, Pixel]], places, where, error=BadPosition)
    if not found:
        raise BadPosition(f"{where} is []; expected [[u, v], ...]")
    return np.array(found)
