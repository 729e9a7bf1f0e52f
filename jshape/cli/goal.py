"""`jshape goal BED`."""

import argparse
import math
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape import sim
from jshape.camera import Camera, window_of
from jshape.cli import arguments
from jshape.cli.cameras import add_part
from jshape.cli.goal_sources import NAMES, wanted_of
from jshape.data.intrinsics import within
from jshape.data.missing import said as said_of
from jshape.data.simulate import DEPTH_UNIT
from jshape.errors import BadCamera, BadImage, quoted
from jshape.goals import Goal, Limits, bed_map, make_goal, report
from jshape.goals.goal import BALANCES
from jshape.io import banks, cameras, drawings, files, folders, formats, images
from jshape.io.frames import Source, frame_of, source_of
from jshape.io.simulated import material_of
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK
from jshape.sim.material import MATERIALS, Material
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


def goal(options: argparse.Namespace) -> dict[str, Any]:
    """Make a goal, print and write."""
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
    material = material_of(options.material)
    bank = banks.load_bank(options.bank or DEFAULT_BANK)
    now = _bed(options, bank)
    at = window_of(bank.camera, now.camera)
    window = None if at is None else (*at, bank.camera.width, bank.camera.height)
    bed = bed_map(
        now.depth, now.camera, window=window, max_missing=options.max_missing, where=options.bed
    )
    wanted = wanted_of(options, bed, now.camera, now.source, bank)
    limits = Limits(
        steepest=_steepest(options, material, wanted.stands),
        floor=options.floor_mm / 1e3,
        reach=_reach(options.reachable, now.camera),
    )
    made = make_goal(bed, wanted.change, limits, balance=options.balance, like=wanted.frame)
    result = {
        "made_from": wanted.name,
        "bed": options.bed,
        "camera": now.source.said,
        "assumed": wanted.assumed,
        "size_mm": wanted.size_mm,
        "at": wanted.at,
        "material": material.name,
        "window": None if window is None else list(window),
        "level_m": bed.level,
        "filled": bed.filled,
        "left_out": now.left_out,
        **report(made, material),
    }
    if options.out is not None:
        result |= _write(options, now, made, result)
    if not options.json:
        _print(result)
        if options.out is not None:
            print(f"goal, bed and picture: {options.out}; plan for it with\n  {result['next']}")
    return result


def _bed(options: argparse.Namespace, bank: Bank) -> GoalFrame:
    """The frame of the bed: a file's, or a simulated level one.

    Raises:
      BadFile, BadImage, BadCamera: as for `jshape plan`.
    """
    path = Path(options.bed)
    if options.bed == FLAT and not path.exists():
        if options.camera is not None:
            raise BadCamera("a simulated bed (flat) is the bundled camera's; leave --camera out")
        depth = np.asarray(sim.render(sim.flat_bed(), bank.camera))
        raw = images.to_counts(depth, DEPTH_UNIT)
        said = "the bundled bank's, above a simulated level bed"
        source = Source(bank.camera, DEPTH_UNIT, said, True)
        return GoalFrame(raw, raw * np.float32(DEPTH_UNIT), bank.camera, source, Counter())
    raw = formats.read_array(path)
    source = source_of(path, raw.shape, options.camera, bank, options.depth_unit)
    left_out: Counter[str] = Counter()
    # A goal may lie at any height.
    depth = frame_of(path, source, reproject=True, raw=raw, left_out=left_out)
    camera = within(source.camera, options.depth_range)
    if options.window:
        left, top, width, height = options.window
        camera = camera.crop(left, top, width, height)
        raw, depth = (x[top : top + height, left : left + width] for x in (raw, depth))
    return GoalFrame(raw, depth, camera, source, left_out)


def _steepest(options: argparse.Namespace, material: Material, stands: bool) -> float:
    """Rise over run that the goal may have: as asked for, or as the material holds it.

    A drawing is loose material at its angle of repose; what a camera saw or a hand pressed
    stands steeper, since it sticks.
    """
    if options.slope is not None:
        return math.tan(math.radians(options.slope))
    return float(material.steepest) if stands else math.tan(float(material.repose))


def _reach(path: Path | None, camera: Camera) -> np.ndarray | None:
    """Pixels of the frame that the hand can reach; None: all."""
    if path is None:
        return None
    mask = drawings.read_drawing(path)
    if mask.shape != camera.shape:
        raise BadImage(f"{path}: has {mask.shape} (rows, columns); the camera makes {camera.shape}")
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{path}: has pixels that are NaN or infinite")
    return np.ma.filled(mask, 0) != 0


def _write(
    options: argparse.Namespace, now: GoalFrame, made: Goal, said: dict[str, Any]
) -> dict[str, Any]:
    """The folder; returns where it is and how to plan for it."""
    from jshape.goals.picture import goal_figure

    counts = now.raw.dtype.kind == "u"
    # 8 bits are luminance: both frames become counts, finer than its levels.
    unit = now.source.depth_unit if now.raw.dtype != np.uint8 else DEPTH_UNIT
    suffix = "png" if counts else "npy"
    out = Path(options.out)
    names = f"{out / f'now.{suffix}'} {out / f'goal.{suffix}'}"
    # What is written is the part that was asked for.
    part = options.window or options.depth_range
    own = f" --window 0,0,{now.camera.width}x{now.camera.height}" if part else " --reproject"
    reproject = own if said["window"] is None else ""
    added = {"out": str(out), "next": f"jshape plan {names}{reproject} --out my-plan"}
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


def _place(text: str) -> tuple[float, float]:
    """A pixel "U,V"."""
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        u = v = math.nan
    if not (math.isfinite(u) and math.isfinite(v)):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a place like 240,197")
    return u, v


def _degrees(text: str) -> float:
    """A turn."""
    try:
        turn = float(text)
    except ValueError:
        turn = math.nan
    if not abs(turn) <= 360:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a turn from -360 to 360 degrees")
    return turn


def _slope(text: str) -> float:
    """A slope that a surface can have."""
    slope = arguments.positive(text)
    if slope > 85:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a slope from 0 to 85 degrees")
    return slope


def add(commands: Any) -> None:
    """The parser of `jshape goal`."""
    parser = arguments.command(commands, "goal", goal)
    parser.add_argument(
        "bed", metavar="BED", help=f"depth image now, or {FLAT!r}: a simulated level bed"
    )
    what = parser.add_mutually_exclusive_group(required=True)
    helps = {
        "text": ("WORD", "letters, sunk or raised"),
        "mask": ("FILE", "a drawing, bright on dark: what to sink or raise"),
        "height_map": ("FILE", "grey levels between --depth-mm and --raise-mm, or metres (NPY)"),
        "mesh": ("FILE", "STL, OBJ or PLY, or a point cloud (PLY, PCD), seen from above"),
        "frame": ("FILE", "another depth image of the same camera"),
        "actions": ("LIST", "what the bank predicts of 'knock 240,197; grasp 312,91x1.5@30' "
                            "(u,v x strength @ degrees), of a JSON file or of a plan.json"),
    }  # fmt: skip
    for name in NAMES:
        where, text = helps[name]
        parser_name = f"--{name.replace('_', '-')}"
        what.add_argument(parser_name, metavar=where, help=text)
    parser.add_argument("--out", type=Path, help="folder for goal, bed, camera.json and picture")
    parser.add_argument(
        "--depth-mm", type=arguments.positive, metavar="MM", help="sunk so deep (text, mask: 8)"
    )
    parser.add_argument("--raise-mm", type=arguments.positive, metavar="MM", help="raised so high")
    parser.add_argument(
        "--at", type=_place, metavar="U,V", help="pixel of its middle (default: of the view)"
    )
    parser.add_argument(
        "--size-mm", type=arguments.positive, metavar="MM",
        help="its longer side (default: six tenths of what fits; a mesh: its own)",
    )  # fmt: skip
    parser.add_argument(
        "--turn", type=_degrees, default=0.0, metavar="DEG", help="clockwise as the camera sees it"
    )
    parser.add_argument("--invert", action="store_true", help="a drawing that is dark on bright")
    parser.add_argument(
        "--mesh-unit", choices=("m", "cm", "mm", "inch"), help="of the mesh (default: guessed)"
    )
    parser.add_argument(
        "--mesh-up", choices=("x", "y", "z"), default="z", help="its axis that points up (z)"
    )
    parser.add_argument(
        "--material", default="flour",
        help=f"{', '.join(MATERIALS)} or FILE.toml: slopes are at most its angle of repose, "
        "and of frames and actions what it holds when pressed (default: flour)",
    )  # fmt: skip
    parser.add_argument("--slope", type=_slope, metavar="DEG", help="steepest slope instead")
    parser.add_argument(
        "--floor-mm", type=arguments.positive, default=1e3 * sim.DEPTH, metavar="MM",
        help=f"how deep the material is (default: {1e3 * sim.DEPTH:g})",
    )  # fmt: skip
    parser.add_argument(
        "--balance", nargs="?", choices=BALANCES, const=BALANCES[0],
        help="as much in as out: spread the rest around it (the default), or move the level",
    )  # fmt: skip
    parser.add_argument(
        "--reachable",
        type=Path,
        metavar="MASK",
        help="image that is not 0 where the bed may change",
    )
    parser.add_argument(
        "--camera-file",
        "--camera",
        dest="camera",
        metavar="FILE",
        help="camera.json, or a preset's name (default: camera.json beside BED, else the bank's)",
    )
    parser.add_argument(
        "--depth-unit", type=arguments.positive, help="metres per count of 16-bit images"
    )
    add_part(parser)
    parser.add_argument("--bank", default=None, help="name or folder, for --actions")
    parser.add_argument(
        "--max-missing", type=arguments.share, default=0.1,
        help="largest share of pixels without depth to fill (0.1)",
    )  # fmt: skip
