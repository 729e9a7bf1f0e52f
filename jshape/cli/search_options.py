"""The options of a search, for all commands that plan: the fields of `planning/options.py`."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from jshape.cli.options import (
    Common,
    Count,
    Devices,
    Duration,
    Nonnegative,
    PositiveCount,
    Positives,
    Seed,
    Share,
    Use,
)
from jshape.data.missing import missing
from jshape.data.view import View, middle_of
from jshape.errors import BadImage, BadPosition
from jshape.io import drawings, files
from jshape.io.records import Range, read_value
from jshape.models.bank import Bank
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
class Searches(Common, SearchSpace, Constraints, StopCriteria, SearchBudget):
    """The fields of the records of `jshape.plan`, as the command line reads them."""

    planner: Annotated[str, Parameter(choices=tuple(PLANNERS), metavar="NAME")] = "greedy"
    """Search to plan with; greedy is the quickest."""
    devices: Devices | None = None
    """CPU devices that share the work (default: one per core, at most 8)."""
    positions: Annotated[str | None, Parameter(metavar="CxR|FILE")] = None
    """Positions to try: a grid such as 21x15 for each action, paper (the paper's 15) or a JSON file
    (default: every `--stride` pixels)."""
    stride: PositiveCount | None = None
    strengths: Positives = field(default_factory=lambda: list(SearchSpace.strengths))
    yaws: PositiveCount | None = None
    """Number of yaw angles to try, evenly over half a turn; 1: the hand is not turned (default: 4
    where the bank's predictors can be turned)."""
    out_of_bounds: Literal["refuse", "shift", "drop"] = "refuse"
    """Treatment of given positions whose ROI leaves the image."""
    reachable: Annotated[str | None, Parameter(metavar="MASK")] = None
    """Mask image of the frames' size or the bank's, not 0 where the hand may be placed (default:
    everywhere)."""
    clearance_mm: Nonnegative = Constraints.clearance_mm
    max_uses: list[Use] | None = None
    """Action and how often it may be used at most; repeat the option for others."""
    max_missing: Share = Constraints.max_missing
    max_steps: Count = StopCriteria.max_steps
    min_gain_mm: Nonnegative = StopCriteria.min_gain_mm
    tolerance_mm: Nonnegative = StopCriteria.tolerance_mm
    error_margin: Nonnegative | None = None
    seconds: Duration | None = None
    evaluations: PositiveCount | None = None
    seed: Seed = SearchBudget.seed


Pixel = Annotated[int, Range(-(2**31), 2**31 - 1)]
FIELDS = tuple(one.name for kind in GROUPS.values() for one in fields(kind))
"""Of the records."""
KEPT = ("planner", *FIELDS)
"""Options that a resumed run keeps."""


def search_of(given: Searches) -> dict[str, Any]:
    """Keywords of `jshape.plan` from the options, but the reachable mask.

    Raises:
      BadPosition, BadFile: a file of positions that is none.
    """
    found = {name: getattr(given, name) for name in FIELDS if name in given.given}
    found.pop("reachable", None)
    if "positions" in found:
        found["positions"] = _positions(found["positions"])
    if "max_uses" in found:
        found["max_uses"] = dict(found["max_uses"])
    if "planner" in given.given:
        found["planner"] = given.planner
    return options(None, execution=over_devices(given.devices), **found)


def kept_of(given: Searches) -> dict[str, Any]:
    """The options of `KEPT` that were given, as a run keeps them."""
    found = {name: getattr(given, name) for name in KEPT if name in given.given}
    if given.max_uses:
        found["max_uses"] = [f"{name}={count}" for name, count in given.max_uses]
    return found


def reachable(
    path: str | None,
    shape: tuple[int, int],
    bank: Bank,
    view: View,
    frame: np.ndarray | None = None,
) -> np.ndarray | None:
    """Pixels of the bank's image that the hand can reach, from a file; None: all.

    Args:
      path: of the mask; None is none.
      shape: of the camera's frames: a mask of this size is seen as they are.
      bank: whose image another mask must fit.
      view: how the frames become the bank's image.
      frame: (H, W) metres of the bed; None: as high as the middle of the bank camera's range.

    Raises:
      BadImage: the mask has another size, or readings that are none.
    """
    if path is None:
        return None
    free = read_mask(path, {"the camera": shape, "the bank's": bank.camera.shape})
    return _seen(free, view, frame) if free.shape == shape else free


def read_mask(path: str | Path, shapes: dict[str, tuple[int, int]]) -> np.ndarray:
    """Where a drawing is not 0; it must have one of the shapes."""
    mask = drawings.read_drawing(Path(path))
    if mask.shape not in shapes.values():
        made = ", ".join(f"{whose} makes {shape}" for whose, shape in shapes.items())
        raise BadImage(f"{path}: has {mask.shape} (rows, columns); {made}")
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{path}: has pixels that are NaN or infinite")
    drawn = np.ma.filled(mask, 0) != 0
    if not drawn.any():
        raise BadImage(f"{path}: is 0 everywhere; other numbers mark where the hand may be placed")
    return drawn


def _seen(mask: np.ndarray, view: View, frame: np.ndarray | None) -> np.ndarray:
    """A mask of the source's image (H, W) in the target's (h, w); nothing is beyond its edge."""
    (height, width), (rows, columns) = view.source.shape, view.target.shape
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    depth = None
    if frame is not None:
        surface = view.depth(frame, "frame")
        depth = np.where(missing(surface), middle_of(view.target), surface).ravel()
    u, v = view.pixels(pixels, depth).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    free = np.zeros(rows * columns, bool)
    free[inside] = mask[v[inside], u[inside]]
    return free.reshape(rows, columns)


def _positions(text: str) -> np.ndarray | str:
    """Positions named on the command line: a grid as for `jshape.plan`, or a JSON file."""
    if Path(text).suffix.lower() != ".json":
        return text
    places, where = files.read_json(text).get("positions"), f"{text}: positions"
    found = read_value(list[tuple[Pixel, Pixel]], places, where, error=BadPosition)
    if not found:
        raise BadPosition(f"{where} is []; expected [[u, v], ...]")
    return np.array(found)
