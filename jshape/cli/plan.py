"""`jshape plan INITIAL DESIRED`."""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jshape.actions import by_mm, strokes_mm
from jshape.cli.names import Preset, Uses
from jshape.cli.options import CameraFile, Part, Positive, Writes
from jshape.cli.plan_maps import are_maps, hand_columns, plan_maps
from jshape.cli.reachable import base_of, reachable
from jshape.cli.search_options import Searches, search_of
from jshape.cli.tables import print_table
from jshape.data.missing import said as said_of
from jshape.io import banks, files, folders, formats
from jshape.io.frames import frame_of, goal_source, part_of, source_of
from jshape.planning import plan_file as plans
from jshape.planning.api import plan_views
from jshape.planning.maps import over_beds
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.planning.plan import Plan
from jshape.planning.search.base import Status
from jshape.viz.style import Drawing, drawn

CONTENTS = ("plan.json", "plan.png", "actions.png", "steps.png")
"""Files of a plan's folder."""


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
    if are_maps(initial, desired):
        return plan_maps(initial, desired, options, CONTENTS, _pictures)
    search = search_of(options)  # first of all: it chooses JAX's devices, and a bank starts JAX
    bank_name = options.bank or DEFAULT_BANK
    bank = banks.load_bank(bank_name)
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
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
    view, beside, bank = over_beds(bank, cameras, (first, goal), names, again=any(part))
    surface = partial(view.depth, first, names[0])
    mask = reachable(options.reachable, view, surface, base_of(source.camera))
    found = plan_views(
        bank, (first, goal), (view, beside), names, **keywords(search, reachable=mask)
    )
    said = {"bank": str(bank_name), "source": source.said, "planner": options.planner}
    if wanted.said != source.said:
        said["goal_source"] = wanted.said
    result = said | plans.plan_fields(found) | {"left_out": left_out}
    if options.out is not None:
        with folders.atomic_folder(options.out, options.overwrite, contents=CONTENTS) as folder:
            found.to_json(folder / "plan.json")
        for name, picture in drawn(partial(_pictures, found, bank.rois)).items():
            files.write_atomic(options.out / name, picture)
        result["out"] = str(options.out)
    _print(found, said, left_out)
    if options.out is not None:
        print(f"plan and pictures: {options.out}")
    return result


def _pictures(found: Plan, rois: dict[str, tuple[int, int]]) -> dict[str, Drawing]:
    from jshape.viz import pictures

    return {
        "plan.png": partial(pictures.plan_figure, found, rois=rois),
        "actions.png": partial(pictures.overlay_figure, found, rois=rois),
        "steps.png": partial(pictures.steps_figure, found),
    }


def _print(found: Plan, said: dict[str, Any], left_out: tuple[Counter[str], ...]) -> None:
    own = f"; of the goal: {said['goal_source']}" if "goal_source" in said else ""
    print(f"bank: {said['bank']}; camera: {said['source']}{own}")
    filled, clamped = found.filled, found.clamped
    now, goal = (f"{n}{said_of(why)}" for n, why in zip(filled, left_out, strict=True))
    print(f"pixels without depth, filled: {now} now, {goal} in the goal; "
          f"beyond the depth range: {clamped[0]} now, {clamped[1]} in the goal")  # fmt: skip
    for note in found.notes:
        print(f"warning: {note}")
    d = found.distances_mm
    along = strokes_mm(found.camera, found.strokes)
    hand = hand_columns(found, {"by (u, v) (mm)": [by_mm(one) for one in along]})
    head = ("step", "action", "u", "v", *hand, "to the goal (mm)", "gain (mm)")
    rows: list[tuple[Any, ...]] = [("", "start", "", "", *("" for _ in hand), f"{d[0]:.3f}", "")]
    for k, name in enumerate(found.actions):
        how = (column[k] for column in hand.values())
        left = f"{d[k + 1]:.3f}", f"{d[k] - d[k + 1]:.3f}"
        rows.append((k + 1, name, *found.camera_positions[k], *how, *left))
    print_table(head, rows)
    spent = f"{said['planner']}, {found.seconds:.2f} s, {found.evaluations} predictions"
    print(f"{found.status.name}: {found.status.meaning} ({spent})")
    if not found.actions and found.status is Status.NO_IMPROVEMENT:
        print("no action of the bank helps at these positions: try a smaller --stride")
