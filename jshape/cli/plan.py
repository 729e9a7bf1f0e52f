"""`jshape plan INITIAL DESIRED`: on two frames, or on two height maps, which need no camera."""

import shlex
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from jshape.cli.names import Preset, Uses
from jshape.cli.options import CameraFile, Common, Part, Positive, Writes, spelled
from jshape.cli.reachable import base_of, reachable
from jshape.cli.search_options import Searches, search_of
from jshape.cli.tables import print_table, say, warn, write_pictures
from jshape.data.missing import said as said_of
from jshape.data.view import View
from jshape.errors import BadFile, JShapeError
from jshape.height_map import HeightMap
from jshape.io import folders, formats
from jshape.io.frames import frame_of, goal_source, part_of, source_of
from jshape.io.maps import SUFFIX, read_map
from jshape.models.bank import Bank
from jshape.planning import api
from jshape.planning import plan_file as plans
from jshape.planning.maps import bank_for, check_frames, over_beds
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.planning.plan import Plan
from jshape.planning.search.base import Status
from jshape.robot.learning import bank_of

CONTENTS = ("plan.json", "plan.png", "actions.png", "steps.png")
"""Files of a plan's folder."""
OF_FRAMES = ("camera_file", "depth_unit", "depth_range", "window")
"""Options that say how frames are seen; a map has been seen."""


@dataclass(frozen=True, kw_only=True)
class PlanOptions(Uses, Searches, Part, Writes):
    """Of `jshape plan`."""

    at_once = True

    out: Path | None = None
    """Folder for plan.json and pictures."""
    camera_file: Annotated[Preset | None, CameraFile] = None
    """camera.json, or a preset's name (default: camera.json beside INITIAL, else the bank's); of
    DESIRED too, unless its own folder has one."""
    depth_unit: Positive | None = None
    """Metres per count of 16-bit images."""


def plan(initial: Path, desired: Path, /, options: PlanOptions = PlanOptions()) -> dict[str, Any]:
    """Read two images, plan, print and write.

    Args:
      initial: Depth image now: 16-bit PNG, TIFF, NPY; or a height map (NPZ).
      desired: The same wanted, or a point cloud (PLY, PCD).
    """
    read = _of_maps if are_maps(initial, desired, options) else _of_frames
    search = search_of(options)  # first of all: it chooses JAX's devices, and a bank starts JAX
    bank_name = str(options.bank or DEFAULT_BANK)
    bank = bank_of(bank_name)
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
    found, said, told = read(initial, desired, options, bank, search)
    result = {"bank": bank_name, "planner": options.planner, **said, **plans.plan_fields(found)}
    if options.out is not None:
        with folders.atomic_folder(options.out, options.overwrite, contents=CONTENTS) as folder:
            found.to_json(folder / "plan.json")
    print(f"bank: {bank_name}; {told}")
    for note in found.notes:
        warn(note)
    _print(found, options.planner)
    if options.out is not None:
        rois = bank_for(bank, found.camera).rois
        pictures = {
            "plan.png": partial(_draw, "plan_figure", found, rois=rois),
            "actions.png": partial(_draw, "overlay_figure", found, rois=rois),
            "steps.png": partial(_draw, "steps_figure", found),
        }
        write_pictures(options.out, pictures)
        result["out"] = str(options.out)
        print(f"plan and pictures: {options.out}")
    return result


def are_maps(initial: Path, desired: Path, options: Common) -> bool:
    """Whether both are height maps, by their names."""
    first, second = (path.suffix.lower() == SUFFIX for path in (initial, desired))
    if first != second:
        one, other = (initial, desired) if first else (desired, initial)
        how = ["jshape", "heightmap", str(other), "--like", str(one), "--out", f"MAP{SUFFIX}"]
        raise BadFile(
            f"{other}: is no height map, and {one} is; give two of a kind: {shlex.join(how)} makes "
            "one"
        )
    wrong = [name for name in OF_FRAMES if options.given.get(name) == "cli"]
    if first and wrong:
        raise JShapeError(f"{spelled(*wrong)}: for frames; a height map has been seen already")
    return first


Planned = tuple[Plan, dict[str, Any], str]
"""A plan, what its JSON holds beside it, and what is said of how it was made."""


class Beds(NamedTuple):
    """Two frames, ready to plan on."""

    bank: Bank
    """For the view."""
    frames: tuple[np.ndarray, np.ndarray]
    """Depths, metres."""
    views: tuple[View, View]
    names: tuple[str, str]
    mask: np.ndarray | None
    """Where the hand may be placed."""
    cameras: tuple[str, str]
    """How each is known to be seen."""
    left_out: tuple[Counter[str], Counter[str]]
    """Pixels without depth, and why."""


def beds_of(initial: Path, desired: Path, options: Any, bank: Bank) -> Beds:
    """Read two frames, as the options say."""
    raw = formats.read_array(initial)
    source = source_of(initial, raw.shape, options.camera_file, bank, options.depth_unit)
    if raw.dtype == np.uint8:
        near, far = float(source.camera.z_min), float(source.camera.z_max)
        light = f"8 bits are luminance: white is {near:g} m away, black {far:g} m"
        source = source._replace(said=f"{source.said}; {light}")
    left_out: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    first = frame_of(initial, source, raw=raw, left_out=left_out[0])
    wanted = goal_source(desired, source, initial.parent)
    goal = frame_of(desired, wanted, left_out=left_out[1])
    part = options.window, options.depth_range
    if any(part):
        first = part_of(first, *part, source.camera)
        if wanted.camera == source.camera:  # of another one it is elsewhere
            goal = part_of(goal, *part, wanted.camera)
    names, cameras = (str(initial), str(desired)), (source.camera, wanted.camera)
    *views, bank = over_beds(bank, cameras, (first, goal), names, again=any(part))
    surface = partial(views[0].depth, first, names[0])
    mask = reachable(options.reachable, views[0], surface, base_of(source.camera))
    said = source.said, wanted.said
    return Beds(bank, (first, goal), (views[0], views[1]), names, mask, said, left_out)


def maps_of(
    initial: Path, desired: Path, options: Any
) -> tuple[HeightMap, HeightMap, np.ndarray | None]:
    """Read two height maps, and where the hand may be placed."""
    now, wanted = read_map(initial), read_map(desired)
    how = f"jshape heightmap FRAME --like {shlex.quote(str(initial))}"
    check_frames(now, wanted, f"{initial} and {desired}", how)
    above = now.camera()
    base, surface = base_of(above) if now.frame else None, partial(now.depth, above)
    mask = reachable(options.reachable, View(above, above, (0, 0)), surface, base)
    frameless = [path for path, one in ((initial, now), (desired, wanted)) if one.frame is None]
    if len(frameless) == 1:
        warn(f"{frameless[0]}: has no frame; that of the other map is taken for its own")
    return now, wanted, mask


def _of_frames(
    initial: Path, desired: Path, options: PlanOptions, bank: Bank, search: dict[str, Any]
) -> Planned:
    beds = beds_of(initial, desired, options, bank)
    how = keywords(search, reachable=beds.mask)
    found = api.plan_views(beds.bank, beds.frames, beds.views, beds.names, **how)
    source, wanted = beds.cameras
    said, own = {"source": source, "left_out": beds.left_out}, ""
    if wanted != source:
        said["goal_source"], own = wanted, f"; of the goal: {wanted}"
    now, later = (f"{n}{said_of(y)}" for n, y in zip(found.filled, beds.left_out, strict=True))
    beyond = f"beyond the depth range: {found.clamped[0]} now, {found.clamped[1]} in the goal"
    gaps = f"pixels without depth, filled: {now} now, {later} in the goal; {beyond}"
    return found, said, f"camera: {source}{own}\n{gaps}"


def _of_maps(
    initial: Path, desired: Path, options: PlanOptions, bank: Bank, search: dict[str, Any]
) -> Planned:
    now, wanted, mask = maps_of(initial, desired, options)
    found = api.plan(now, wanted, bank=bank, **keywords(search, reachable=mask))
    known = 1.0 if found.seen is None else float(found.seen.mean())
    told = f"on height maps: {initial}, {known:.1%} of it known in both"
    return found, {"source": str(initial), "known": known}, told


def _draw(figure: str, found: Plan, **how: Any) -> Any:
    from jshape.viz import pictures  # not above: where it is broken, there is a plan without them

    return getattr(pictures, figure)(found, **how)


def _print(found: Plan, planner: str) -> None:
    """A row for each action, and how far from the goal the last ends, where that is known."""
    columns, d = found.columns(), found.distances_mm
    known = {"action": "start", "to the goal (mm)": f"{d[0]:.3f}"}
    start = ("", *(known.get(name, "") for name in columns))
    rows = [(k + 1, *row) for k, row in enumerate(zip(*columns.values(), strict=True))]
    print_table(("step", *columns), [start, *rows])
    if said := found.interval_after(len(found)):
        print(f"{d[-1]:.3f} mm from the goal{said}")
    spent = f"{planner}, {found.seconds:.2f} s, {found.evaluations} predictions"
    say(f"{found.status.name}: {found.status.meaning} ({spent})")  # pictures take a second more
    if not found.actions and found.status is Status.NO_IMPROVEMENT:
        print("no action of the bank helps at these positions: try a smaller --stride")
