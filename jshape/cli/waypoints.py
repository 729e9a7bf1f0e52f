"""`jshape waypoints PLAN --out FILE`."""

import argparse
from pathlib import Path
from typing import Any

from jshape.actions import PAPER_Z
from jshape.cli import arguments
from jshape.cli.calibrate import check_new
from jshape.cli.tables import print_table
from jshape.errors import BadFile
from jshape.planning.plan import Plan
from jshape.robot import pose_file as poses
from jshape.robot import procedure_file as procedures
from jshape.robot import waypoint_file as waypoints
from jshape.robot.waypoints import Waypoints, waypoints_of


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Read a plan, make the poses of its operations, print where they are, write them."""
    check_new(waypoints.check_ending(options.out), options.overwrite)
    if options.base is None and options.gripper is not None:
        raise BadFile("--gripper goes with --base, the pose of a camera in the hand")
    base_camera = None
    if options.base is not None:
        base_camera = poses.read_base_camera(options.base, options.gripper)
    hand = procedures.load_hand(options.hand)
    path = options.plan / "plan.json" if options.plan.is_dir() else options.plan
    ways = waypoints_of(Plan.from_json(path), hand, base_camera, place_depth=options.place_depth)
    waypoints.write_waypoints(options.out, ways)
    if not options.json:
        _print(ways)
        print(f"waypoints: {options.out}")
    return waypoints.waypoint_fields(ways) | {"out": str(options.out)}


def _print(ways: Waypoints) -> None:
    what = "the arm's base" if ways.frame == "base" else "the camera (no --base was given)"
    print(f"frame: {what}; the tool at the end of the act, mm")
    head = ("step", "action", "strength", "x", "y", "z", "surface z", "poses")
    rows = []
    for k, path in enumerate(ways.actions):
        act = next(one for one in path.waypoints if one.operation == "act")
        at = ("", "", "") if act.pose is None else act.pose[:3, 3] * 1e3
        rows.append(
            (
                k + 1,
                path.action,
                f"{path.strength:.2f}",
                *(x if x == "" else f"{x:.1f}" for x in at),
                f"{1e3 * path.surface[2]:.1f}",
                sum(one.pose is not None for one in path.waypoints),
            )
        )
    print_table(head, rows)


def add(commands: Any) -> None:
    """The parser of `jshape waypoints`."""
    parser = arguments.command(commands, "waypoints", run)
    parser.add_argument("plan", type=Path, help="plan.json, or the folder of jshape plan --out")
    parser.add_argument("--out", type=Path, required=True, help="file: .json, .yaml or .yml")
    parser.add_argument(
        "--base",
        type=Path,
        metavar="POSE",
        help="pose of the camera from jshape calibrate (default: poses in the camera's frame)",
    )
    parser.add_argument(
        "--gripper",
        type=Path,
        metavar="POSE",
        help="JSON with base_gripper when the camera looked, for a camera in the hand",
    )
    parser.add_argument(
        "--hand", type=Path, metavar="FOLDER", help="procedures and limits (default: the bundled)"
    )
    parser.add_argument(
        "--place-depth",
        type=arguments.positive,
        default=PAPER_Z,
        metavar="METRES",
        help=f"depth from the bank's camera at which its places are meant (default: {PAPER_Z})",
    )
