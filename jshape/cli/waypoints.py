"""`jshape waypoints PLAN --out FILE`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from jshape.actions import PAPER_Z
from jshape.cli.options import File, Positive, Writes, plan_file
from jshape.cli.tables import print_table
from jshape.errors import BadFile
from jshape.planning.plan import Plan
from jshape.robot import pose_file as poses
from jshape.robot import procedure_file as procedures
from jshape.robot.waypoints import check_ending, waypoints_of, write_waypoints


@dataclass(frozen=True, kw_only=True)
class WaypointsOptions(Writes):
    """Of `jshape waypoints`."""

    out: Annotated[Path, File]
    """File to write: .json, .yaml or .yml."""
    base: Annotated[Path | None, Parameter(metavar="POSE")] = None
    """Pose of the camera from `jshape calibrate` (default: poses in the camera's frame, or in the
    one that several cameras of a map share)."""
    gripper: Annotated[Path | None, Parameter(metavar="POSE")] = None
    """Pose of the gripper when the camera looked, for a camera in the hand (JSON: base_gripper)."""
    hand: Annotated[Path | None, Parameter(metavar="FOLDER")] = None
    """Folder of the hand's limits.yaml and ACTION.yaml (default: the bundled one)."""
    place_depth: Positive = PAPER_Z
    """Depth from the bank's camera at which the plan's positions are meant, metres."""


def waypoints(plan: Path, /, options: WaypointsOptions) -> dict[str, Any]:
    """Read a plan, make the poses of its operations, print where they are, write them.

    Args:
      plan: plan.json, or the folder of `jshape plan --out`.
    """
    options.check_new(check_ending(options.out))
    if options.base is None and options.gripper is not None:
        raise BadFile("--gripper goes with --base, the pose of a camera in the hand")
    base_camera = None
    if options.base is not None:
        base_camera = poses.read_base_camera(options.base, options.gripper)
    hand = procedures.load_hand(options.hand)
    made = Plan.from_json(plan_file(plan))
    ways = waypoints_of(made, hand, base_camera, place_depth=options.place_depth)
    write_waypoints(options.out, ways)
    _print(ways)
    print(f"waypoints: {options.out}")
    return ways | {"out": str(options.out)}


def _print(ways: dict[str, Any]) -> None:
    what = {
        "base": "the arm's base",
        "camera": "the camera (no --base was given)",
        "cameras": "that of the poses of the map's cameras",
    }
    print(f"frame: {what[ways['frame']]}; the tool at the end of the act, mm")
    head = ("step", "action", "strength", "x", "y", "z", "surface z", "poses")
    rows = []
    for one in ways["actions"]:
        moves = [move for move in one["operations"] if move["matrix"]]
        ends = [move["position_m"] for move in moves if move["operation"] == "act"]
        at = [f"{1e3 * x:.1f}" for x in ends[0]] if ends else [""] * 3
        poses = sum(len(move.get("path", [move])) for move in moves)
        name = one["number"], one["action"], f"{one['strength']:.2f}"
        rows.append((*name, *at, f"{1e3 * one['surface_m'][2]:.1f}", poses))
    print_table(head, rows)
