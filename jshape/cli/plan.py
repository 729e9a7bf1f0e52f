"""`jshape plan INITIAL DESIRED`."""

import argparse
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape.camera import differing
from jshape.cli import arguments
from jshape.cli.cameras import add_part
from jshape.cli.tables import print_table
from jshape.data.intrinsics import within
from jshape.data.missing import said as said_of
from jshape.data.view import View, view_of
from jshape.errors import BadImage, BadPosition, JShapeError
from jshape.io import banks, drawings, files, folders, formats
from jshape.io.frames import Source, bank_over, frame_of, goal_source, source_of
from jshape.models.bank import Bank
from jshape.planning import plan_file as plans
from jshape.planning.api import DEFAULT_BANK, Plan, plan_depth
from jshape.planning.devices import over_devices
from jshape.planning.search.base import Status
from jshape.viz.style import Drawing, drawn

POSITIONS = "21x15"
"""Where actions are tried unless one says otherwise."""

CONTENTS = ("plan.json", "plan.png", "actions.png", "steps.png")
"""Files of a plan's folder."""


def plan(options: argparse.Namespace) -> dict[str, Any]:
    """Read two images, plan, print and write."""
    how = over_devices(options.devices)  # first of all: what loads a bank starts JAX
    bank_name = options.bank or DEFAULT_BANK
    bank = banks.load_bank(bank_name)
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=CONTENTS)
    if options.reproject and (options.window or options.depth_range):
        raise JShapeError(
            "--reproject looks as the bank's camera would, --window and --depth-range plan on the "
            "frames as they are; give one or the other"
        )
    raw = formats.read_array(options.initial)
    source = source_of(options.initial, raw.shape, options.camera, bank, options.depth_unit)
    if raw.dtype == np.uint8:
        near, far = float(source.camera.z_min), float(source.camera.z_max)
        light = f"8 bits are luminance: white is {near:g} m away, black {far:g} m"
        source = source._replace(said=f"{source.said}; {light}")
    left_out: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    again = options.reproject
    first = frame_of(options.initial, source, reproject=again, raw=raw, left_out=left_out[0])
    wanted = goal_source(options.desired, source, options.initial.parent)
    goal = frame_of(options.desired, wanted, reproject=again, left_out=left_out[1])
    if options.window or options.depth_range:
        own = within(source.camera, options.depth_range)
        bank = bank_over(bank, own.crop(*options.window) if options.window else own, first, own)
        source, wanted = (
            one._replace(camera=within(one.camera, (float(own.z_min), float(own.z_max))))
            for one in (source, wanted)
        )
    found = plan_depth(
        first,
        goal,
        bank=bank,
        camera=(source.camera, wanted.camera),
        reproject=options.reproject,
        planner=options.planner,
        **_tried(options),
        clip=options.clip,
        max_steps=options.max_steps,
        min_gain=options.min_gain_mm / float(metric.to_mm(1.0, bank.camera)),
        tolerance=options.tolerance_mm / float(metric.to_mm(1.0, bank.camera)),
        caution=options.caution,
        reach=_reach(options, source, bank, first),
        clearance_mm=options.clearance_mm,
        most=dict(options.most),
        seconds=options.time,
        evaluations=options.evaluations,
        seed=options.seed,
        how=how,
        max_missing=options.max_missing,
        names=(str(options.initial), str(options.desired)),
    )
    said = {"bank": str(bank_name), "source": source.said, "planner": options.planner}
    if wanted.said != source.said:
        said["goal_source"] = wanted.said
        if options.reproject and differing(wanted.camera, source.camera, ""):
            said["goal_source"] += " (the middles of both beds are taken to be equally high)"
    result = said | plans.plan_fields(found) | {"left_out": left_out}
    if options.out is not None:
        with folders.atomic_folder(options.out, options.overwrite, contents=CONTENTS) as folder:
            found.to_json(folder / "plan.json")
        for name, picture in drawn(partial(_pictures, found, bank.rois)).items():
            files.write_atomic(options.out / name, picture)
        result["out"] = str(options.out)
    if not options.json:
        _print(found, said, left_out)
        if options.out is not None:
            print(f"plan and pictures: {options.out}")
    return result


def _tried(options: argparse.Namespace) -> dict[str, Any]:
    """Where, how deep and in which directions actions are tried, as `jshape.plan` takes it."""
    if options.stride is None:
        usual: tuple[float, ...] = (1.0,)
        where: dict[str, Any] = {"positions": _positions(options.positions or POSITIONS)}
    else:
        usual, where = arguments.STRENGTHS, {"stride": options.stride}
    return where | {"strengths": options.strengths or usual, "yaws": options.yaws}


def _reach(
    options: argparse.Namespace, source: Source, bank: Bank, first: np.ndarray
) -> np.ndarray | None:
    """Pixels of the bank's image that the hand can reach; None: all.

    A mask of the size of the frames is looked at as they are, else it is the bank's image.
    """
    if options.reach is None:
        return None
    mask = drawings.read_drawing(options.reach)
    if mask.dtype.kind == "f" and not np.isfinite(mask).all():
        raise BadImage(f"{options.reach}: has pixels that are NaN or infinite")
    if mask.shape == source.camera.shape:
        view = view_of(source.camera, bank.camera, first, reproject=options.reproject)
        return _seen(np.ma.filled(mask, 0) != 0, view)
    if mask.shape == bank.camera.shape:
        return np.ma.filled(mask, 0) != 0
    raise BadImage(
        f"{options.reach}: has {mask.shape} (rows, columns); the camera makes "
        f"{source.camera.shape}, the bank's {bank.camera.shape}"
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
    d = found.distances_mm
    head = ("step", "action", "u", "v", "strength", "yaw (°)", "to the goal (mm)", "gain (mm)")
    rows: list[tuple[Any, ...]] = [("", "start", "", "", "", "", f"{d[0]:.3f}", "")]
    for k, name in enumerate(found.actions):
        hand = f"{found.strengths[k]:.2f}", f"{np.degrees(found.yaws[k]):.0f}"
        left = f"{d[k + 1]:.3f}", f"{d[k] - d[k + 1]:.3f}"
        rows.append((k + 1, name, *found.camera_positions[k], *hand, *left))
    if not found.yaws.any():  # a column of zeros says nothing
        head, *rows = (row[:5] + row[6:] for row in (head, *rows))
    print_table(head, rows)
    spent = f"{said['planner']}, {found.seconds:.2f} s, {found.evaluations} predictions"
    print(f"{found.status.name}: {found.status.meaning} ({spent})")
    if not found.actions and found.status is Status.NO_IMPROVEMENT:
        print("nothing of the bank helps at these places: try more of them with --positions "
              "or --stride")  # fmt: skip


def add(commands: Any) -> None:
    """The parser of `jshape plan`."""
    parser = arguments.command(commands, "plan", plan, at_once=True)
    parser.add_argument("initial", type=Path, help="depth image now: 16-bit PNG, TIFF, NPY, EXR")
    parser.add_argument("desired", type=Path, help="the same wanted, or a point cloud (PLY, PCD)")
    parser.add_argument(
        "--camera-file",
        "--camera",
        dest="camera",
        metavar="FILE",
        help="camera.json, or a preset's name (default: camera.json beside INITIAL, else the "
        "bank's); of DESIRED too, unless its own folder has one",
    )
    parser.add_argument(
        "--reproject",
        action="store_true",
        help="see the frames of another camera or height as the bank's camera would",
    )
    add_part(parser)
    parser.add_argument(
        "--depth-unit", type=arguments.positive, help="metres per count of 16-bit images"
    )
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--positions",
        metavar="CxR|FILE",
        help=f"a grid of places for each action (default: {POSITIONS}), or a JSON file with "
        "positions",
    )
    where.add_argument(
        "--stride",
        type=arguments.positive_count,
        metavar="PIXELS",
        help="instead: places so many pixels apart, the best of them moved further (8 is good)",
    )
    deep = ",".join(f"{x:g}" for x in arguments.STRENGTHS)
    parser.add_argument(
        "--strengths",
        type=arguments.positives,
        metavar="S,S,...",
        help="how many times as deep as trained actions are tried "
        f"(default: 1; with --stride {deep})",
    )
    parser.add_argument(
        "--yaws",
        type=arguments.positive_count,
        default=1,
        metavar="N",
        help="directions of the hand over half a turn (default: 1, the trained one)",
    )
    arguments.add_search(parser)
    parser.add_argument(
        "--time",
        type=arguments.duration,
        metavar="TIME",
        help="stop the search after 5s, 500ms or 2min with the best it has; compiling not counted",
    )
    parser.add_argument(
        "--evaluations",
        type=arguments.positive_count,
        metavar="N",
        help="stop the search after so many predictions with the best it has",
    )
    parser.add_argument("--seed", type=arguments.seed, default=0, help="for searches that draw")
    parser.add_argument(
        "--reach",
        type=Path,
        metavar="MASK",
        help="image that is not 0 where the hand may be placed, of INITIAL's size or the bank's",
    )
    parser.add_argument(
        "--clearance-mm",
        type=arguments.nonnegative,
        default=0.0,
        metavar="MM",
        help="least distance of places to the image's edge and to what --reach leaves out",
    )
    parser.add_argument(
        "--most",
        type=arguments.use,
        action="append",
        default=[],
        metavar="ACTION=N",
        help="use an action at most so often; may be given again for another",
    )
    parser.add_argument(
        "--caution",
        type=arguments.nonnegative,
        default=0.0,
        metavar="X",
        help="an action must also gain more than X times its usual error (default: 0)",
    )
    parser.add_argument(
        "--clip",
        default="refuse",
        choices=("refuse", "shift", "drop"),
        help="what to do with a place whose ROI leaves the image",
    )
    parser.add_argument(
        "--max-steps", type=arguments.count, default=16, help="most actions (default: 16)"
    )
    parser.add_argument(
        "--min-gain-mm",
        type=arguments.nonnegative,
        default=0.005,
        help="an action must help by more than this (default: 0.005)",
    )
    parser.add_argument(
        "--tolerance-mm",
        type=arguments.nonnegative,
        default=0.0,
        help="stop when the goal is this near",
    )
    parser.add_argument(
        "--max-missing",
        type=arguments.share,
        default=0.1,
        help="largest share of pixels without depth to fill (0.1)",
    )
    parser.add_argument("--out", type=Path, help="folder for plan.json and pictures")
