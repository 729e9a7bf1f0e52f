"""`jshape mold DESIRED`: look, plan, act, look again, until the bed is as wanted."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape.camera import check_camera
from jshape.commands import arguments
from jshape.commands.plan import Source, source_of
from jshape.commands.robot import (
    add_robot,
    add_run,
    asking,
    draw,
    may_move,
    resumed,
    robot_of,
    tell,
)
from jshape.data.view import image_of_depth, view_of
from jshape.devices import over_devices
from jshape.errors import BadFile
from jshape.planning import DEFAULT_BANK
from jshape.predict.bank import Bank
from jshape.robot.loop import HEAD
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from jshape.store import banks, formats, points


def mold(options: argparse.Namespace) -> dict[str, Any]:
    """Mold what the camera sees into what is wanted."""
    how = over_devices(options.devices)
    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    if options.resume == (options.desired is not None):
        raise BadFile("give either the image DESIRED, or --resume to go on with the run in --out")
    session = resumed(options, say) if options.resume else None
    bank_name = options.bank or (session.run.meta["bank"] if session else DEFAULT_BANK)
    bank = banks.load_bank(bank_name)
    confirm = asking(options)
    with robot_of(options, bank, say) as robot:
        if session is None:
            goal = goal_of(options.desired, robot, bank, options)
            meta = {
                "what": "mold", "bank": str(bank_name), "arm": options.arm,
                "camera": robot.eye.name, "goal": str(options.desired), "planner": options.planner,
            }  # fmt: skip
            session = Session.start(options.out, goal, meta, overwrite=options.overwrite, say=say)
        may_move(options)
        say(HEAD)
        per_mm = 1.0 / float(metric.to_mm(1.0, bank.camera))
        summary = session.mold(
            robot, bank, planner=options.planner, max_steps=options.max_steps, confirm=confirm,
            blind=options.arm == "dry", draw=draw(bank.rois),
            stride=options.stride, strengths=options.strengths, yaws=options.yaws,
            min_gain=options.min_gain_mm * per_mm, tolerance=options.tolerance_mm * per_mm,
            caution=options.caution, seconds=options.time, seed=options.seed,
            max_missing=options.max_missing, how=how,
        )  # fmt: skip
    if not options.json:
        tell(summary)
    return summary


def goal_of(path: Path, robot: Robot, bank: Bank, options: argparse.Namespace) -> np.ndarray:
    """The image (H, W) that is wanted, from a file of any camera that can be known.

    Raises:
      BadFile, BadImage, BadCamera: as for `jshape plan`.
    """
    if path.suffix.lower() in points.SUFFIXES:
        source = Source(robot.eye.camera, robot.eye.depth_unit, robot.eye.name, True)
    else:
        shape = formats.read_array(path).shape
        source = source_of(path, shape, options.camera_file, bank, options.depth_unit)
    depth = points.read_goal(
        path, check_camera(source.camera), source.depth_unit,
        check_range=source.stated or not options.reproject,
    )  # fmt: skip
    return image_of_depth(
        depth, bank.camera, max_missing=options.max_missing, where=str(path),
        view=view_of(source.camera, bank.camera, depth, reproject=options.reproject),
    ).image  # fmt: skip


def add(commands: Any) -> None:
    """The parser of `jshape mold`."""
    parser = arguments.command(commands, "mold", mold)
    parser.add_argument("desired", type=Path, nargs="?", help="depth image wanted, or a PLY or PCD")
    add_robot(parser)
    add_run(parser)
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument("--depth-unit", type=arguments.positive, help="metres per count of DESIRED")
    parser.add_argument(
        "--stride", type=arguments.positive_count, default=arguments.STRIDE, metavar="PIXELS",
        help=f"between places where actions are tried ({arguments.STRIDE})",
    )  # fmt: skip
    parser.add_argument(
        "--strengths", type=arguments.positives, default=list(arguments.STRENGTHS),
        metavar="S,S,...", help="how many times as deep as trained actions are tried",
    )  # fmt: skip
    parser.add_argument(
        "--yaws", type=arguments.positive_count, default=1, metavar="N",
        help="directions of the hand over half a turn (1)",
    )  # fmt: skip
    arguments.add_search(parser)
    parser.add_argument(
        "--time", type=arguments.duration, metavar="TIME", help="for each plan: 5s, 500ms, 2min"
    )
    parser.add_argument("--seed", type=arguments.seed, default=0, help="for searches that draw")
    parser.add_argument(
        "--max-steps", type=arguments.positive_count, default=16, help="most actions (16)"
    )
    parser.add_argument(
        "--min-gain-mm", type=arguments.nonnegative, default=0.01,
        help="an action must help by more than this (0.01: below it noise decides)",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance-mm", type=arguments.nonnegative, default=0.0,
        help="stop when the goal is this near",
    )  # fmt: skip
    parser.add_argument(
        "--caution", type=arguments.nonnegative, default=0.0, metavar="X",
        help="an action must also gain more than X times its usual error (0)",
    )  # fmt: skip
    parser.add_argument(
        "--max-missing", type=arguments.share, default=0.1,
        help="largest share of pixels without depth to fill (0.1)",
    )  # fmt: skip
