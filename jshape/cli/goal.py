"""`jshape goal BED`."""

import math
import shlex
from functools import partial
from typing import Any

import numpy as np

from jshape.camera import window_of
from jshape.cli.goal_frame import GoalFrame, frame_to_change
from jshape.cli.goal_options import GoalOptions
from jshape.cli.goal_sources import NAMES, wanted_of
from jshape.cli.options import spelled
from jshape.cli.reachable import base_of, reachable
from jshape.data.missing import missing
from jshape.data.missing import said as said_of
from jshape.data.simulate import DEPTH_UNIT
from jshape.data.view import View, above, tilt_deg
from jshape.errors import JShapeError
from jshape.goals import Goal, Limits, bed_map, make_goal, report
from jshape.height_map import ABOVE
from jshape.io import banks, cameras, files, folders, images
from jshape.io.simulated import material_of
from jshape.planning.options import DEFAULT_BANK
from jshape.sim.material import Material
from jshape.viz.style import drawn

LACKING_CM3 = 10.0
"""Where more is missing the plan is told of a stock: a fifth of a handful."""
CONTENTS = (
    *("report.json", "goal.png", "goal.npy", "now.png", "now.npy", "camera.json"),
    "picture.png",
)
"""Files of a goal's folder."""


def goal(bed: str, /, options: GoalOptions = GoalOptions()) -> dict[str, Any]:
    """Make a goal, print and write.

    Args:
      bed: Depth image now, a height map (NPZ), or `flat`: a simulated level bed.
    """
    if not set(NAMES) & set(options.given):
        raise JShapeError(f"what is the goal made from? give one of {spelled(*NAMES)}")
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
    material = material_of(options.material)
    bank = banks.load_bank(options.bank or DEFAULT_BANK)
    now = frame_to_change(bed, options, bank)
    at = window_of(bank.camera, now.camera)
    window = None if at is None else (*at, bank.camera.width, bank.camera.height)
    surface = bed_map(
        now.depth,
        now.camera,
        window=window,
        max_missing=options.max_missing,
        where=bed,
    )
    wanted = wanted_of(options, bed, surface, now, bank)
    view = now.view or View(now.camera, now.camera, (0, 0))
    mask = reachable(options.reachable, view, lambda: now.depth, base_of(view.source))
    limits = Limits(
        steepest=_steepest(options, material, wanted.stands),
        floor=options.floor_mm / 1e3,
        reach=mask,
    )
    made = make_goal(surface, wanted.change, limits, balance=options.balanced, like=wanted.frame)
    result = {
        "made_from": wanted.name,
        "bed": bed,
        "camera": now.source.said,
        "assumed": [*_seen_as(now), *wanted.assumed],
        "size_mm": wanted.size_mm,
        "at": wanted.at,
        "material": material.name,
        "window": None if window is None else list(window),
        "level_m": surface.level,
        "filled": surface.filled,
        "seen": float(surface.seen.sum() / surface.inside.sum()),
        "left_out": now.left_out,
        **report(made, material),
    }
    if options.out is not None:
        result |= _write(options, now, made, result)
    _print(result)
    if options.out is not None:
        print(f"goal, bed and picture: {options.out}; plan for it with\n  {result['next']}")
    return result


def _seen_as(now: GoalFrame) -> list[str]:
    """What is said of a bed that is seen from above."""
    if now.view is None or now.taken is None:
        return []
    tilt, pixel = tilt_deg(now.taken, now.view.source), 1e3 / float(now.camera.scale(ABOVE)[0])
    return [
        f"the bed is tilted by {tilt:.1f} degrees: now and goal are seen from straight above, "
        f"{now.camera.width}x{now.camera.height} pixels of {pixel:.2g} mm"
    ]


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
    names = (str(out / f"{name}.{suffix}") for name in ("now", "goal"))
    words, lacking = ["jshape", "plan", *names, "--out", "my-plan"], said["transport"]["stock_cm3"]
    if lacking > LACKING_CM3:
        words += ["--bank", "moving-flour-robot", "--stock-cm3", str(math.ceil(lacking))]
    added = {"out": str(out), "next": shlex.join(words)}
    with folders.atomic_folder(out, options.overwrite, contents=CONTENTS) as folder:
        # From above, what nobody saw is not made up: it does not count.
        unseen = missing(now.depth) & above(now.camera)
        goal = np.where(unseen, np.nan, made.depth)
        for name, depth in (("now", now.depth), ("goal", goal)):
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
    if said["seen"] < 1:
        print(f"{said['seen']:.1%} of the bed was seen; the rest does not count")
    for line in (*said["assumed"], *said["says"], *said["transport"]["says"]):
        print(line)
    for line in said["warnings"]:
        print(f"warning: {line}")
