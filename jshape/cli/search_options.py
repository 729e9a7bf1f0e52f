"""The options of a search, for all commands that plan: the fields of `planning/options.py`."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jshape.cli import arguments
from jshape.data.view import View
from jshape.errors import BadImage, BadPosition
from jshape.io import drawings, files
from jshape.models.bank import Bank
from jshape.planning.devices import over_devices
from jshape.planning.options import fields_of, options
from jshape.planning.search import PLANNERS

FIELDS: dict[str, tuple[Any, str, str]] = {
    "positions": (str, "CxR|FILE", "a grid of positions for each action, paper for the paper's 15, "
                                   "or a JSON file"),
    "stride": (arguments.positive_count, "PIXELS", "between positions that are not given (12; less "
                                                 "for small ROIs)"),
    "strengths": (arguments.positives, "S,S,...", "depths to try, times the trained one"),
    "yaws": (arguments.positive_count, "N", "number of yaw angles in [0, pi) (4 where the bank can "
                                            "turn the hand; 1 disables rotation)"),
    "out_of_bounds": (str, "WHAT", "positions whose ROI leaves the image: refuse, shift, drop"),
    "reachable": (str, "MASK", "image, not 0 where the hand may be placed, of the frames' size "
                               "or the bank's"),
    "clearance_mm": (arguments.nonnegative, "MM", "least distance of positions to the image's edge "
                                                  "and to what --reachable leaves out"),
    "max_uses": (arguments.use, "ACTION=N", "use an action at most N times; may be given again"),
    "max_missing": (arguments.share, "SHARE", "largest share of pixels without depth to fill"),
    "reproject": (bool, "", "see frames of another camera or height as the bank's camera would"),
    "max_steps": (arguments.count, "N", "most actions"),
    "min_gain_mm": (arguments.nonnegative, "MM", "an action must gain more than this"),
    "tolerance_mm": (arguments.nonnegative, "MM", "stop when the goal is this near"),
    "error_margin": (arguments.nonnegative, "X", "an action must also gain more than X times its "
                                                 "usual error (0.5 where the bank knows it)"),
    "seconds": (arguments.duration, "TIME", "of a search: 5s, 500ms, 2min; compiling not counted"),
    "evaluations": (arguments.positive_count, "N", "most predictions of a search"),
    "seed": (arguments.seed, "N", "of searches that draw"),
}  # fmt: skip
"""How each field is read, what stands for its value, and what it is."""
KEPT = ("planner", *FIELDS)
"""Options that a resumed run keeps."""


def add_search(parser: argparse.ArgumentParser) -> None:
    """The options that say how to search; those not given keep the defaults of the records."""
    usual = fields_of({})
    where = parser.add_mutually_exclusive_group()
    for name, (kind, metavar, what) in FIELDS.items():
        more: dict[str, Any] = {"type": kind, "metavar": metavar}
        if kind is bool:
            more = {"action": "store_true", "default": None}
        elif kind is arguments.use:
            more["action"] = "append"
        elif name == "out_of_bounds":
            more["choices"] = ("refuse", "shift", "drop")
        default = usual[name]
        if isinstance(default, tuple):
            default = ",".join(f"{x:g}" for x in default)
        said = "" if default in (None, False) else f" (default: {default})"
        to: Any = where if name in ("positions", "stride") else parser
        added = to.add_argument(f"--{name.replace('_', '-')}", help=what + said, **more)
        added.usual = usual[name]  # what holds where the option is None: not given
    planner: Any = parser.add_argument(
        "--planner",
        choices=tuple(PLANNERS),
        metavar="NAME",
        help=f"which search: {', '.join(PLANNERS)} (default: greedy, the quickest)",
    )
    planner.usual = "greedy"
    arguments.add_devices(parser)


def search_of(given: argparse.Namespace) -> dict[str, Any]:
    """Keywords of `jshape.plan` from the options that `add_search` added, but the reachable mask.

    Raises:
      BadPosition, BadFile: a file of positions that is none.
    """
    found = {name: getattr(given, name) for name in FIELDS if getattr(given, name) is not None}
    found.pop("reachable", None)
    if "positions" in found:
        found["positions"] = _positions(found["positions"])
    if "max_uses" in found:
        found["max_uses"] = dict(found["max_uses"])
    if given.planner:
        found["planner"] = given.planner
    return options(None, execution=over_devices(given.devices), **found)


def kept_of(given: argparse.Namespace) -> dict[str, Any]:
    """The options of `KEPT` as a run keeps them."""
    found = {name: getattr(given, name) for name in KEPT}
    if given.max_uses:
        found["max_uses"] = [f"{name}={count}" for name, count in given.max_uses]
    return found


def reachable(
    path: str | None, shape: tuple[int, int], bank: Bank, view: Callable[[], View]
) -> np.ndarray | None:
    """Pixels of the bank's image that the hand can reach, from a file; None: all.

    Args:
      path: of the mask; None is none.
      shape: of the camera's frames: a mask of this size is seen as they are.
      bank: whose image another mask must fit.
      view: how the frames become the bank's image.

    Raises:
      BadImage: the mask has another size, or readings that are none.
    """
    if path is None:
        return None
    mask = drawings.read_drawing(Path(path))
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{path}: has pixels that are NaN or infinite")
    free = np.ma.filled(mask, 0) != 0
    if free.shape == shape:
        return _seen(free, view())
    if free.shape == bank.camera.shape:
        return free
    raise BadImage(
        f"{path}: has {mask.shape} (rows, columns); the camera makes {shape}, the bank's "
        f"{bank.camera.shape}"
    )


def _seen(mask: np.ndarray, view: View) -> np.ndarray:
    """A mask of the source's image (H, W) in the target's (h, w); nothing is beyond its edge."""
    (height, width), (rows, columns) = view.source.shape, view.target.shape
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    u, v = view.pixels(pixels).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    free = np.zeros(rows * columns, bool)
    free[inside] = mask[v[inside], u[inside]]
    return free.reshape(rows, columns)


def _positions(text: str) -> np.ndarray | str:
    """Positions named on the command line: a grid as for `jshape.plan`, or a JSON file."""
    if Path(text).suffix.lower() != ".json":
        return text
    places = files.read_json(text).get("positions")
    pairs = places if isinstance(places, list) else [None]
    whole = all(
        isinstance(pair, list)
        and len(pair) == 2
        and all(type(x) is int and abs(x) < 2**31 for x in pair)
        for pair in pairs
    )
    if not whole or not pairs:
        raise BadPosition(f'{text}: expected {{"positions": [[u, v], ...]}}, whole pixels')
    return np.array(pairs)
