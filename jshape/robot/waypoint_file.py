"""Waypoints on disk: JSON or YAML with the same content, read by people and by any controller."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadFile, JShapeError, quoted
from jshape.io.files import write_atomic, write_json
from jshape.robot.rigid import quaternion_of
from jshape.robot.waypoints import ActionPath, Waypoint, Waypoints

try:
    import yaml
except ImportError:
    raise JShapeError("hands and waypoints need PyYAML: pip install 'jshape[robot]'") from None

FORMAT = "jshape-waypoints"
VERSION = 1
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
}
"""What the ends of names stand for; a part of every file."""

_CAMERA_AXES = "x right in the image, y down the image, z away from the camera"
_READING = {
    "tool": "the point of the hand that meets the bed, tool_in_flange_m in the flange's frame "
    f"with the flange's axes; at yaw 0 its axes are the camera's: {_CAMERA_AXES}",
    "operation": "move the tool to the pose in a straight line at the speed, then give the hand "
    "the posture; a contact effort above effort_Nm ends it, and the next one begins",
    "no pose": "the tool stays; for clear, the arm goes home, out of the camera's view",
    "surface_m": "the bed under the place as it is predicted to be before the action",
    "hard_effort_Nm": "a contact effort above it stops the arm for good",
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
    """The path, if waypoints can be written there.

    Raises:
      BadFile: it ends in something else than .json, .yaml and .yml.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise BadFile(f"{path}: ends in {quoted(path.suffix)}; allowed: {', '.join(ENDINGS)}")
    return path


def write_waypoints(path: str | os.PathLike, ways: Waypoints) -> None:
    """Write waypoints as JSON or YAML, whichever the path ends in, whole or not at all.

    Raises:
      BadFile: another ending, or it cannot be written.
    """
    path, fields = check_ending(path), waypoint_fields(ways)
    if path.suffix.lower() == ".json":
        write_json(path, fields)
    else:
        dumped = {"Dumper": _Dumper, "sort_keys": False, "default_flow_style": False, "width": 100}
        write_atomic(path, yaml.dump(fields, **dumped))


def waypoint_fields(ways: Waypoints) -> dict[str, Any]:
    """What waypoints say, as plain values that JSON and YAML can hold."""
    where = {
        "base": "the base of the arm",
        "camera": f"the camera that took the frames, NOT the arm: {_CAMERA_AXES}",
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "frame": ways.frame,
        "frame_is": where[ways.frame],
        "units": dict(UNITS),
        "reading": dict(_READING),
        "T_base_camera": None if ways.base_camera is None else _numbers(ways.base_camera),
        "place_depth_m": float(ways.place_depth),
        "hard_effort_Nm": float(ways.hard_effort),
        "actions": [_action(k, path) for k, path in enumerate(ways.actions)],
    }


def _action(index: int, path: ActionPath) -> dict[str, Any]:
    return {
        "number": index + 1,
        "action": path.action,
        "position_px": _numbers(path.position),
        "strength": round(path.strength, 6),
        "yaw_rad": round(path.yaw, 6),
        "surface_m": _numbers(path.surface),
        "tool_in_flange_m": _numbers(path.tool),
        "predicted_distance_mm": round(path.distance_mm, 6),
        "operations": [_operation(one) for one in path.waypoints],
    }


def _operation(one: Waypoint) -> dict[str, Any]:
    pose = one.pose
    fields: dict[str, Any] = {
        "operation": one.operation,
        "position_m": None if pose is None else _numbers(pose[:3, 3]),
        "quaternion_xyzw": None if pose is None else _numbers(quaternion_of(pose)),
        "matrix": None if pose is None else _numbers(pose),
        "speed_m_s": one.speed,
        "effort_Nm": one.effort,
        "posture": one.posture,
        "posture_s": None if one.posture is None else one.seconds,
    }
    return fields


def _numbers(values: Any) -> list:
    """Lists of plain numbers to 1e-12, so that a rounded zero is 0.0 and not -6e-17."""
    return (np.round(np.asarray(values, np.float64), 12) + 0.0).tolist()
