"""A plan as poses of the tool, for a controller that is not ours; JSON or YAML, read by people too.

Every action becomes its six operations on the surface that is predicted before it, so that later
actions touch what the earlier ones leave.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape._typing import Float
from jshape.actions import PAPER_Z
from jshape.errors import BadFile, BadPosition, JShapeError, UnknownName, needs, quoted
from jshape.io.files import write_atomic, write_json
from jshape.planning.plan import Plan
from jshape.robot.procedure import Hand, Operation, surface_point
from jshape.robot.rigid import BadPose, Pose, check_rigid, quaternion_of

with needs("robot", "a hand or waypoint file"):
    import yaml

FORMAT = "jshape-waypoints"
VERSION, WITH_PATHS = 1, 2
"""Of files whose operations all go straight to their pose; of those where some follow a path."""
ENDINGS = (".json", ".yaml", ".yml")
"""Of the files that can be written."""

UNITS = {
    "_m": "metres",
    "_m_s": "metres per second",
    "_s": "seconds",
    "_Nm": "newton metres",
    "_rad": "radians",
    "_px": "pixels (u, v): column, row, from 0, in the image of the plan's camera",
    "quaternion_xyzw": "x, y, z, w of the tool's rotation in the frame",
    "matrix": "4 rows: the tool's pose in the frame, rotation and metres",
    "strength": "times as deep as the trained action",
    "length": "times as long as the path of the trained action",
}
"""What the ends of names stand for; a part of every file."""

_CAMERA_AXES = "x right in the image, y down the image, z away from the camera"
_READING = {
    "tool": "the point of the hand that meets the bed, tool_in_flange_m in the flange's frame "
    f"with the flange's axes; at yaw 0 its axes are the camera's: {_CAMERA_AXES}",
    "operation": "move the tool to the pose in a straight line at the speed, then give the hand "
    "the posture; a contact effort above effort_Nm ends it, and the next one begins",
    "path": "the poses that the tool goes to in straight lines one after the other instead; the "
    "last is the operation's own",
    "no pose": "the tool stays; for clear, the arm goes home, out of the camera's view",
    "surface_m": "the place; its height is the bed's as it is predicted to be before the action, "
    "where the hand goes down: under the place, or where a path begins",
    "hard_effort_Nm": "a contact effort above it stops the arm for good",
}


_FRAMES = {
    "base": "the base of the arm",
    "camera": f"the camera that took the frames, NOT the arm: {_CAMERA_AXES}",
    "cameras": "that of the poses in the files of the map's cameras (of one camera without a "
    f"pose, its own: {_CAMERA_AXES}); the arm's base only if they are in it",
}


def waypoints_of(
    plan: Plan,
    hand: Hand,
    base_camera: Float[np.ndarray, "4 4"] | None = None,
    *,
    place_depth: float = PAPER_Z,
) -> dict[str, Any]:
    """The poses of all operations of a plan, as a file of it says them: plain values.

    `frame` says whose all poses are; each of `actions` has its place, the height of the surface and
    its six operations, with the tool's pose in metres, several along a `path`, or none.

    Args:
      plan: with its images: they say how high the surface will be.
      hand: procedures and limits.
      base_camera: pose of the camera that took the frames in the arm's base frame, metres; None
        gives poses in that camera's frame.  Of a plan on height maps whose cameras have poses: of
        the frame that they share.
      place_depth: depth from the plan's camera at which its places are meant, metres (Hypothesis
        3); 0.45 for the bundled banks.

    Raises:
      JShapeError: the plan has no actions, or was stored without its images.
      UnknownName: an action without a procedure.
      BadPosition: a place depth beyond the range of the plan's camera.
      PoseRefused: an operation leaves the hand's limits.
      BadPose: base_camera is not rigid, not in metres, or turns the bed upside down.
    """
    if len(plan) == 0:
        raise JShapeError("the plan has no actions: there is nothing to export")
    if plan.initial is None:
        raise JShapeError(
            "the plan was stored without its images, which say how high the surface is; plan again"
        )
    camera, missing = plan.camera, [a for a in plan.actions if a not in hand.procedures]
    if missing:
        raise UnknownName("action", missing[0], hand.procedures)
    if not float(camera.z_min) <= place_depth <= float(camera.z_max):
        raise BadPosition(
            f"places are meant at {place_depth:g} m, beyond the range of the plan's camera, "
            f"{float(camera.z_min):g} to {float(camera.z_max):g} m; say at which depth "
            "(place_depth, --place-depth)"
        )
    own = np.eye(4) if base_camera is None else check_rigid(base_camera, "T_base_camera")
    change = own if plan.view is None else own @ plan.view.to_source
    seen_as_it_is = plan.view is None or plan.view.window is not None
    on_map = plan.camera.orthographic and plan.camera.pose is not None and seen_as_it_is
    if on_map:  # from there to the frame that its cameras share
        change = own @ np.array(plan.camera.pose)
    if on_map and base_camera is not None and change[2, 2] > 0:
        raise BadPose(
            "T_base_camera: the bed of the plan's map would hang upside down in the base frame; "
            "are the poses of its cameras in that frame already? then leave --base out"
        )
    frame = ("cameras" if on_map else "camera") if base_camera is None else "base"
    actions = []
    for k, act in enumerate(plan):
        procedure = hand.procedures[act.action]
        depth = np.asarray(camera.depth(metric.unweigh(plan.images[k], camera)))
        at = {"place_depth": place_depth, "beside": procedure.begins(act.yaw, act.length)}
        point = surface_point(depth, camera, act.position, **at)
        seen = procedure.poses(hand.limits, point, act.strength, act.yaw, act.length)
        action = {
            "number": k + 1,
            "action": act.action,
            "position_px": _numbers(act.position),
            "strength": round(act.strength, 6),
            "yaw_rad": round(act.yaw, 6),
            "length": round(act.length, 6),
            "surface_m": _numbers(change[:3, :3] @ point + change[:3, 3]),
            "tool_in_flange_m": _numbers(procedure.tool[:3, 3]),
            "predicted_distance_mm": round(float(plan.distances_mm[k + 1]), 6),
            "operations": [
                _operation(one, [change @ pose for pose in poses]) for one, poses in seen
            ],
        }
        actions.append(action)
    paths = any("path" in one for action in actions for one in action["operations"])
    return {
        "format": FORMAT,
        "version": WITH_PATHS if paths else VERSION,
        "frame": frame,
        "frame_is": _FRAMES[frame],
        "units": dict(UNITS),
        "reading": dict(_READING),
        "T_base_camera": None if base_camera is None else _numbers(own),
        "place_depth_m": float(place_depth),
        "hard_effort_Nm": float(hand.limits.effort_nm),
        "actions": actions,
    }


class _Dumper(yaml.SafeDumper):
    """Plain values only; numbers of a list stand on one line."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _sequence(dumper: yaml.SafeDumper, values: list) -> yaml.Node:
    flow = all(isinstance(value, int | float) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _sequence)


def check_ending(path: str | os.PathLike) -> Path:
    """The path, if waypoints can be written there; else BadFile."""
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise BadFile(f"{path}: ends in {quoted(path.suffix)}; allowed: {', '.join(ENDINGS)}")
    return path


def write_waypoints(path: str | os.PathLike, ways: dict[str, Any]) -> None:
    """Write `waypoints_of` as JSON or YAML, whichever the path ends in, whole or not at all."""
    path = check_ending(path)
    if path.suffix.lower() == ".json":
        write_json(path, ways)
    else:
        dumped = {"Dumper": _Dumper, "sort_keys": False, "default_flow_style": False, "width": 100}
        write_atomic(path, yaml.dump(ways, **dumped))


def _operation(one: Operation, poses: Sequence[Pose]) -> dict[str, Any]:
    written = [_pose(pose) for pose in poses]
    end = written[-1] if written else dict.fromkeys(_pose(np.eye(4)))
    return {
        "operation": one.name,
        **end,
        **({"path": written} if len(written) > 1 else {}),
        "speed_m_s": one.speed_mm_s / 1e3,
        "effort_Nm": float(one.effort_nm),
        "posture": one.posture,
        "posture_s": None if one.posture is None else float(one.seconds),
    }


def _pose(pose: Pose) -> dict[str, Any]:
    return {
        "position_m": _numbers(pose[:3, 3]),
        "quaternion_xyzw": _numbers(quaternion_of(pose)),
        "matrix": _numbers(pose),
    }


def _numbers(values: Any) -> list:
    """Lists of plain numbers to 1e-12, so that a rounded zero is 0.0 and not -6e-17."""
    return (np.round(np.asarray(values, np.float64), 12) + 0.0).tolist()
