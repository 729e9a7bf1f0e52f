"""`jshape plan INITIAL.npz DESIRED.npz`: on two height maps, which need no camera."""

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jshape.actions import by_mm
from jshape.cli.options import spelled
from jshape.cli.reachable import base_of, reachable
from jshape.cli.search_options import search_of
from jshape.cli.tables import print_table, warn
from jshape.data.view import View
from jshape.errors import BadFile, JShapeError
from jshape.height_map import places_on
from jshape.io import banks, files, folders
from jshape.io.maps import SUFFIX, read_map
from jshape.planning import plan_file as plans
from jshape.planning.api import plan
from jshape.planning.maps import bank_for, check_frames
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.planning.plan import Plan
from jshape.viz.style import Drawing, drawn

OF_FRAMES = ("camera_file", "depth_unit", "depth_range", "window", "reproject")
"""Options that say how frames are seen; a map has been seen."""


def are_maps(initial: Path, desired: Path) -> bool:
    """Whether both are height maps, by their names.

    Raises:
      BadFile: one is, and the other is not.
    """
    first, second = (path.suffix.lower() == SUFFIX for path in (initial, desired))
    if first == second:
        return first
    one, other = (initial, desired) if first else (desired, initial)
    makes = shlex.join(
        ["jshape", "heightmap", str(other), "--like", str(one), "--out", f"MAP{SUFFIX}"]
    )
    raise BadFile(f"{other}: is no height map, and {one} is; give two of a kind: {makes} makes one")


def plan_maps(
    initial: Path,
    desired: Path,
    options: Any,
    contents: Sequence[str],
    pictures: Callable[[Plan, dict[str, tuple[int, int]]], dict[str, Drawing]],
) -> dict[str, Any]:
    """Read two maps, plan, print and write.

    Args:
      initial: of the bed now.
      desired: of the bed wanted.
      options: of `jshape plan`.
      contents: files of a plan's folder.
      pictures: what draws those of a plan, by their names.

    Raises:
      JShapeError: a file that is no map, an option of frames, and as `jshape.plan`.
    """
    search = search_of(options)
    wrong = [name for name in OF_FRAMES if options.given.get(name) == "cli"]
    if wrong:
        raise JShapeError(f"{spelled(*wrong)}: for frames; a height map has been seen already")
    name = options.bank or DEFAULT_BANK
    bank = banks.load_bank(name)
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=contents)
    now, wanted = read_map(initial), read_map(desired)
    frameless = [path for path, one in ((initial, now), (desired, wanted)) if one.frame is None]
    how = f"jshape heightmap FRAME --like {shlex.quote(str(initial))}"
    check_frames(now, wanted, f"{initial} and {desired}", how)
    above = now.camera()
    base, surface = base_of(above) if now.frame else None, partial(now.depth, above)
    mask = reachable(options.reachable, View(above, above, (0, 0)), surface, base)
    found = plan(now, wanted, bank=bank, **keywords(search, reachable=mask))
    known = 1.0 if found.seen is None else float(found.seen.mean())
    said = {"bank": str(name), "source": str(initial), "planner": options.planner, "known": known}
    result = said | plans.plan_fields(found)
    if options.out is not None:
        with folders.atomic_folder(options.out, options.overwrite, contents=contents) as folder:
            found.to_json(folder / "plan.json")
        rois = bank_for(bank, found.camera).rois
        for file, picture in drawn(partial(pictures, found, rois)).items():
            files.write_atomic(options.out / file, picture)
        result["out"] = str(options.out)
    print(f"bank: {name}; on height maps: {initial}, {known:.1%} of it known in both")
    if len(frameless) == 1:
        warn(f"{frameless[0]}: has no frame; that of the other map is taken for its own")
    for note in found.notes:
        warn(note)
    _print(found, options.planner)
    if options.out is not None:
        print(f"plan and pictures: {options.out}")
    return result


def hand_columns(found: Plan, strokes: dict[str, list[str]]) -> dict[str, list[str]]:
    """What a plan's hand does, column by column; one of zeros or ones says nothing.

    `strokes` is the last column, by its head.
    """
    columns = {"strength": [f"{strength:.2f}" for strength in found.strengths]}
    if found.yaws.any():
        columns["yaw (°)"] = [f"{yaw:.0f}" for yaw in np.degrees(found.yaws)]
    if (found.lengths != 1).any():
        columns["length"] = [f"{length:.2f}" for length in found.lengths]
    return columns | (strokes if found.strokes.any() else {})


def _print(found: Plan, planner: str) -> None:
    d, on_map = found.distances_mm, 1e3 * places_on(found.camera, found.exact_positions)
    ends = 1e3 * places_on(found.camera, found.exact_positions + found.strokes)
    hand = hand_columns(found, {"by (x, y) (mm)": [by_mm(one) for one in ends - on_map]})
    places = "step", "action", "u", "v", "x (mm)", "y (mm)"
    head = (*places, *hand, "to the goal (mm)", "gain (mm)")
    rows: list[tuple[Any, ...]] = [
        ("", "start", *("" for _ in range(4 + len(hand))), f"{d[0]:.3f}", "")
    ]
    for k, name in enumerate(found.actions):
        place = *found.positions[k], *(f"{at:.1f}" for at in on_map[k])
        how = (column[k] for column in hand.values())
        rows.append((k + 1, name, *place, *how, f"{d[k + 1]:.3f}", f"{d[k] - d[k + 1]:.3f}"))
    print_table(head, rows)
    spent = f"{planner}, {found.seconds:.2f} s, {found.evaluations} predictions"
    print(f"{found.status.name}: {found.status.meaning} ({spent})")
