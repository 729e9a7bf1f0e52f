"""`jshape goal BED`."""

import math
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape import sim
from jshape.camera import Camera, window_of
from jshape.cli.goal_options import GoalOptions
from jshape.cli.goal_sources import NAMES, wanted_of
from jshape.cli.options import spelled
from jshape.cli.search_options import read_mask
from jshape.data.intrinsics import within
from jshape.data.missing import said as said_of
from jshape.data.simulate import DEPTH_UNIT
from jshape.errors import BadCamera, JShapeError
from jshape.goals import Goal, Limits, bed_map, make_goal, report
from jshape.io import banks, cameras, files, folders, formats, images
from jshape.io.frames import Source, frame_of, source_of
from jshape.io.simulated import material_of
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK
from jshape.sim.material import Material
from jshape.viz.style import drawn

FLAT = "flat"
"""The word for a simulated level bed, instead of a file."""
CONTENTS = (
    *("report.json", "goal.png", "goal.npy", "now.png", "now.npy", "camera.json"),
    "picture.png",
)
"""Files of a goal's folder."""


class GoalFrame(NamedTuple):
    """The frame that a goal is made for."""

    raw: np.ndarray
    """As it is stored."""
    depth: np.ndarray
    """(H, W) metres, NaN: no reading."""
    camera: Camera
    """Of `raw`, which may be a part of the frame."""
    source: Source
    """Of the whole frame."""
    left_out: Counter[str]
    """Why pixels are no readings."""


def goal(bed: str, /, options: GoalOptions = GoalOptions()) -> dict[str, Any]:
    """Make a goal, print and write.

    Args:
      bed: Depth image now, or `flat`: a simulated level bed.
    """
    if not set(NAMES) & set(options.given):
        raise JShapeError(f"what is the goal made from? give one of {spelled(*NAMES)}")
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
    material = material_of(options.material)
    bank = banks.load_bank(options.bank or DEFAULT_BANK)
    now = _bed(bed, options, bank)
    at = window_of(bank.camera, now.camera)
    window = None if at is None else (*at, bank.camera.width, bank.camera.height)
    surface = bed_map(
        now.depth, now.camera, window=window, max_missing=options.max_missing, where=bed
    )
    wanted = wanted_of(options, bed, surface, now.camera, now.source, bank)
    mask = options.reachable
    limits = Limits(
        steepest=_steepest(options, material, wanted.stands),
        floor=options.floor_mm / 1e3,
        reach=mask and read_mask(mask, {"the camera": now.camera.shape}),
    )
    made = make_goal(surface, wanted.change, limits, balance=options.balanced, like=wanted.frame)
    result = {
        "made_from": wanted.name,
        "bed": bed,
        "camera": now.source.said,
        "assumed": wanted.assumed,
        "size_mm": wanted.size_mm,
        "at": wanted.at,
        "material": material.name,
        "window": None if window is None else list(window),
        "level_m": surface.level,
        "filled": surface.filled,
        "left_out": now.left_out,
        **report(made, material),
    }
    if options.out is not None:
        result |= _write(options, now, made, result)
    _print(result)
    if options.out is not None:
        print(f"goal, bed and picture: {options.out}; plan for it with\n  {result['next']}")
    return result


def _bed(bed: str, options: GoalOptions, bank: Bank) -> GoalFrame:
    """The frame of the bed: a file's, or a simulated level one.

    Raises:
      BadFile, BadImage, BadCamera: as for `jshape plan`.
    """
    path = Path(bed)
    if bed == FLAT and not path.exists():
        if options.camera_file is not None:
            raise BadCamera("a simulated bed (flat) is the bundled camera's; leave --camera out")
        depth = np.asarray(sim.render(sim.flat_bed(), bank.camera))
        raw = images.to_counts(depth, DEPTH_UNIT)
        said = "the bundled bank's, above a simulated level bed"
        source = Source(bank.camera, DEPTH_UNIT, said, True)
        return GoalFrame(raw, raw * np.float32(DEPTH_UNIT), bank.camera, source, Counter())
    raw = formats.read_array(path)
    source = source_of(path, raw.shape, options.camera_file, bank, options.depth_unit)
    left_out: Counter[str] = Counter()
    # A goal may lie at any height.
    depth = frame_of(path, source._replace(stated=False), raw=raw, left_out=left_out)
    camera = within(source.camera, options.depth_range)
    if options.window:
        left, top, width, height = options.window
        camera = camera.crop(left, top, width, height)
        raw, depth = (x[top : top + height, left : left + width] for x in (raw, depth))
    return GoalFrame(raw, depth, camera, source, left_out)


def _steepest(options: GoalOptions, material: Material, stands: bool) -> float:
    """Rise over run that the goal may have: as asked for, or as the material holds it.

    A drawing is loose material at its angle of repose; what a camera saw or a hand pressed
    stands steeper, since it sticks.
    """
    if options.slope is not None:
        return math.tan(math.radians(options.slope))
    return float(material.steepest) if stands else math.tan(float(material.repose))


def _write(
    options: GoalOptions, now: GoalFrame, made: Goal, said: dict[str, Any]
) -> dict[str, Any]:
    """The folder; returns where it is and how to plan for it."""
    from jshape.goals.picture import goal_figure

    counts = now.raw.dtype.kind == "u"
    # 8 bits are luminance: both frames become counts, finer than its levels.
    unit = now.source.depth_unit if now.raw.dtype != np.uint8 else DEPTH_UNIT
    suffix = "png" if counts else "npy"
    out = options.out
    assert out is not None
    names = f"{out / f'now.{suffix}'} {out / f'goal.{suffix}'}"
    added = {"out": str(out), "next": f"jshape plan {names} --out my-plan"}
    with folders.atomic_folder(out, options.overwrite, contents=CONTENTS) as folder:
        for name, depth in (("now", now.depth), ("goal", made.depth)):
            if counts:
                images.write_depth_png(folder / f"{name}.png", depth, unit)
            else:
                np.save(folder / f"{name}.npy", depth.astype(np.float32), allow_pickle=False)
        cameras.write_camera(folder / "camera.json", now.camera, unit)
        files.write_json(folder / "report.json", said | {"next": added["next"]})
    title = f"{said['made_from']}: {said['says'][0]}"
    for name, picture in drawn({"picture.png": partial(goal_figure, made, title)}).items():
        files.write_atomic(out / name, picture)
    return added


def _print(said: dict[str, Any]) -> None:
    print(f"goal: {said['made_from']}; camera: {said['camera']}")
    if said["size_mm"] is not None:
        (w, h), (u, v) = said["size_mm"], said["at"]
        print(f"{w:.0f} x {h:.0f} mm around ({u:g}, {v:g})")
    if said["filled"]:
        print(
            f"{said['filled']} pixels of the bed without depth, filled{said_of(said['left_out'])}"
        )
    for line in (*said["assumed"], *said["says"]):
        print(line)
    for line in said["warnings"]:
        print(f"warning: {line}")
