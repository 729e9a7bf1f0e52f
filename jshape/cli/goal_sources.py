"""What `jshape goal` can make a goal from: files and words to a change of the bed's height."""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jshape import metric
from jshape.actions import PlacedAction
from jshape.camera import check_same_camera, differing, window_of
from jshape.cli.goal_frame import GoalFrame
from jshape.cli.goal_options import GoalOptions
from jshape.data.intrinsics import within
from jshape.data.missing import fill_missing, missing
from jshape.data.missing import said as said_of
from jshape.data.view import image_of_depth
from jshape.errors import BadCamera, BadPosition, JShapeError, quoted
from jshape.goals import (
    BedMap,
    Relief,
    bed_map,
    drawn_on_image,
    largest_size,
    placed,
    relief_of_heights,
    relief_of_mask,
    relief_of_solid,
    relief_of_text,
)
from jshape.goals.reliefs import inked
from jshape.io import formats, points
from jshape.io.frames import frame_of, goal_source
from jshape.models.bank import Bank
from jshape.planning.api import rollout
from jshape.planning.maps import over_bed
from jshape.planning.plan import Plan

DEPTH_MM = 8.0
"""How deep texts and masks are sunk unless one says otherwise, mm: the least depth of the letters
of the planning benchmark."""
SHARE = 0.6
"""Of the largest size that fits, unless one says how large."""
SMALL = 0.5
"""Of the usual size: what is made smaller, since it is near the edge, is said."""
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Metres per unit of a mesh."""
LONGEST_M = 2.0
"""A mesh of up to so many units is taken for metres, a larger one for millimetres."""

_ACTION = re.compile(
    r"([\w-]+)\s+([0-9.]+)\s*,\s*([0-9.]+)(?:\s*x\s*([0-9.]+))?(?:\s*@\s*(-?[0-9.]+))?"
    r"(?:\s*length\s*([0-9.]+))?"
)


class Wanted(NamedTuple):
    """What is asked of a bed."""

    name: str
    """For people."""
    change: np.ndarray
    """(Y, X) change of height, metres, up."""
    assumed: list[str]
    """What was guessed, in sentences."""
    size_mm: tuple[float, float] | None = None
    """Of what was placed."""
    at: tuple[float, float] | None = None
    """Pixel of its middle."""
    frame: np.ndarray | None = None
    """(H, W) the frame that it is, where it is one."""
    stands: bool = False
    """It was seen or pressed: steeper than loose material."""


def wanted_of(options: GoalOptions, where: str, bed: BedMap, now: GoalFrame, bank: Bank) -> Wanted:
    """The change of a bed, of file `where` and frame `now`, that the options ask for."""
    kind, value = next(
        (name, value) for name in NAMES if (value := getattr(options, name)) is not None
    )
    if kind in ("frame", "actions"):
        places = "at", "size_mm", "turn", "raise_mm", "depth_mm"
        options.refuse(places, f" says nothing of --{kind}: its places are its own")
    if kind == "frame":
        return _frame(value, options, where, bed, now)
    if kind == "actions":
        return _actions(value, where, bed, now, bank)
    if options.at is not None:
        u, v = now.places(np.array([options.at]))[0]
        options = replace(options, at=(float(u), float(v)))
    return _DRAWN[kind](value, options, bed, now)


def _text(text: str, options: GoalOptions, bed: BedMap, now: GoalFrame) -> Wanted:
    return _laid(relief_of_text(text, _height(options)), options, bed)


def _mask(path: str, options: GoalOptions, bed: BedMap, now: GoalFrame) -> Wanted:
    drawn, name = _drawing(path, options), f"mask {Path(path).name}"
    if _is_placed(options):
        return _laid(relief_of_mask(drawn, _height(options), name), options, bed)
    return _on_image(inked(drawn, name) * np.float32(_height(options)), bed, now, name)


def _height_map(path: str, options: GoalOptions, bed: BedMap, now: GoalFrame) -> Wanted:
    drawn, name = _drawing(path, options), f"height map {Path(path).name}"
    low, high = -(options.depth_mm or 0.0) / 1e3, (options.raise_mm or 0.0) / 1e3
    if options.raise_mm is None:  # what is bright is what is meant, up or down
        low, high = (None, None) if options.depth_mm is None else (0.0, low)
    relief = relief_of_heights(drawn, low, high, name)
    if _is_placed(options):
        return _laid(relief, options, bed)
    return _on_image(relief.heights, bed, now, name)


def _mesh(path: str, options: GoalOptions, bed: BedMap, now: GoalFrame) -> Wanted:
    corners, faces = points.read_mesh(path)
    assumed, unit = [], options.mesh_unit
    if unit is None:
        sides = np.ptp(corners, axis=0)
        unit = "m" if sides.max() <= LONGEST_M else "mm"
        if options.size_mm is None:
            size = " x ".join(f"{side:.4g}" for side in sides)
            assumed.append(
                f"the mesh is {size} of its own units, taken for {unit}; --mesh-unit says otherwise"
            )
    if options.depth_mm and options.raise_mm:
        raise JShapeError("a mesh is raised or sunk: give --raise-mm or --depth-mm, not both")
    name = f"mesh {Path(path).name}"
    relief = relief_of_solid(corners, faces, unit=UNITS[unit], up=options.mesh_up, name=name)
    if options.size_mm is not None:
        relief = relief.sized(options.size_mm / 1e3, whole=True)
    if options.depth_mm or options.raise_mm:
        factor = _height(options) / float(np.nanmax(relief.heights))
        relief = replace(relief, heights=relief.heights * np.float32(factor))
    return _laid(relief, options, bed, assumed, sized=True)


def _frame(name: str, options: GoalOptions, where: str, bed: BedMap, now: GoalFrame) -> Wanted:
    path, camera = Path(name), now.camera if now.view is None else now.view.source
    own = goal_source(path, now.source, Path(where).parent)
    left_out: Counter[str] = Counter()
    # Its depths may be any: neither range matters.
    found = frame_of(path, own._replace(stated=False), left_out=left_out)
    theirs = within(own.camera, (float(camera.z_min), float(camera.z_max)))
    at = window_of(camera, theirs)
    if at is None:
        raise BadCamera(
            f"{path}: of another camera than the bed: {differing(theirs, camera, 'bed')}"
        )
    found = found[at[1] : at[1] + camera.height, at[0] : at[0] + camera.width]
    if now.view is not None:
        found = now.view.depth(found, name)
        found = np.where(missing(found), bed.frame, found)  # hidden: as it is
    frame, filled = fill_missing(found, limit=options.max_missing, where=name)
    gaps = f"{filled} pixels of {name} without depth, filled{said_of(left_out)}"
    said = [gaps] if filled else []
    change = bed.heights_of(frame) - bed.height
    return Wanted(f"frame {path.name}", change, said, frame=frame, stands=True)


def _actions(text: str, where: str, bed: BedMap, now: GoalFrame, bank: Bank) -> Wanted:
    """What the bank predicts, on the bed's own map: effects keep their size in metres."""
    view, bank = over_bed(bank, now.camera, bed.frame, where)
    own = not view.above or now.view is not None
    first = image_of_depth(bed.frame, bank.camera, view=view, where=where).image
    acts = _acts(text, bank, lambda at: view.positions(now.places(at), bed.level))
    then = rollout(first, first, acts, bank=bank).images[-1]
    before, after = (
        np.asarray(bank.camera.depth(metric.unweigh(image, bank.camera))) for image in (first, then)
    )
    seen = bed_map(before, bank.camera)
    change = seen.heights_of(after) - seen.height
    (x, y), (x0, y0) = bed.axes(), seen.axes()
    rows, columns = (y - y0[0]) / seen.cell, (x - x0[0]) / seen.cell
    cells = np.meshgrid(rows, columns, indexing="ij")
    change = ndimage.map_coordinates(change, cells, order=1, mode="constant")
    said = [] if own else ["the bank's camera is another one: the bed is seen from above"]
    count = len(acts)
    name = f"{count} action{'s' * (count > 1)}"
    return Wanted(name, change.astype(np.float32), said, stands=True)


def _acts(
    text: str, bank: Bank, in_bank: Callable[[np.ndarray], np.ndarray]
) -> Sequence[PlacedAction]:
    """Actions of the command line, or of a plan's file, in the bank's image."""
    if Path(text).suffix.lower() == ".json":
        found = Plan.from_json(text)
        check_same_camera(bank.camera, found.camera, "the plan's")
        return list(found)
    acts = [_spoken(part.strip()) for part in text.split(";") if part.strip()]
    if not acts:
        raise BadPosition("no action is given; expected some like 'knock 240,197; press 91,92x1.5'")
    places = in_bank(np.array([act.position for act in acts])).tolist()
    return [replace(act, position=(u, v)) for act, (u, v) in zip(acts, places, strict=True)]


def _spoken(text: str) -> PlacedAction:
    """An action like "sweep 312,91x1.5@30 length 1.2", its turn in degrees."""
    found = _ACTION.fullmatch(text)
    try:
        name, u, v, strength, turn, length = found.groups() if found else []
        how = float(strength or 1), math.radians(float(turn or 0)), float(length or 1)
        return PlacedAction(name, (float(u), float(v)), *how)
    except ValueError:
        raise BadPosition(
            f"{quoted(text)} is not an action like 'knock 240,197', 'grasp 312,91x1.5@30' or "
            "'sweep 312,91x1.5@30 length 1.2' (u,v x strength @ degrees length times the trained)"
        ) from None


def _laid(
    relief: Relief,
    options: GoalOptions,
    bed: BedMap,
    assumed: list[str] | None = None,
    *,
    sized: bool = False,
) -> Wanted:
    """A relief where and as large as the options say."""
    turn, assumed = math.radians(options.turn), assumed or []
    if not sized:
        longest, usual = (SHARE * largest_size(relief, bed, at, turn) for at in (options.at, None))
        if options.size_mm is None and longest < SMALL * usual:
            assumed.append(
                f"so near the view's edge it is made {1e3 * longest:.0f} mm large, not "
                f"{1e3 * usual:.0f} as in its middle; --size-mm or --at say otherwise"
            )
        relief = relief.sized(longest if options.size_mm is None else options.size_mm / 1e3)
    change = placed(relief, bed, options.at, turn)
    size = 1e3 * relief.size[0], 1e3 * relief.size[1]
    return Wanted(relief.name, change, assumed, size, options.at or bed.middle())


def _on_image(heights: np.ndarray, bed: BedMap, now: GoalFrame, name: str) -> Wanted:
    """A drawing of the size of the frame, or of the part of it that is looked at."""
    heights = now.drawing(heights)
    rows, columns = bed.camera.shape
    if heights.shape == (rows, columns) and heights.shape != bed.frame.shape:
        (left, top), part = bed.corner, heights
        heights = np.full(bed.frame.shape, np.float32(np.nan))
        heights[top : top + rows, left : left + columns] = part
    return Wanted(name, drawn_on_image(heights, bed, name), [])


def _is_placed(options: GoalOptions) -> bool:
    return options.size_mm is not None or options.at is not None or options.turn != 0


def _height(options: GoalOptions) -> float:
    """Metres up of what is raised or sunk."""
    if options.raise_mm is not None and options.depth_mm is not None:
        raise JShapeError("give --raise-mm or --depth-mm, not both")
    if options.raise_mm is not None:
        return options.raise_mm / 1e3
    return -(options.depth_mm or DEPTH_MM) / 1e3


def _drawing(path: str, options: GoalOptions) -> np.ndarray:
    drawn = formats.read_drawing(path)
    if not options.invert:
        return drawn
    return np.nanmax(np.ma.compressed(drawn)) - drawn


_DRAWN = {"text": _text, "mask": _mask, "height_map": _height_map, "mesh": _mesh}

NAMES = (*_DRAWN, "frame", "actions")
"""What a goal can be made from; each is an option."""
