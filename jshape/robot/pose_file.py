"""Poses on disk: pairs for hand-eye calibration, and where a camera is.

Both are JSON.  Pairs are a list, or an object with the list as `poses`; each pose is a 4x4 matrix
in metres, or `{"xyz_mm": [x, y, z], "quat": [x, y, z, w]}`:

    [{"base_gripper": ..., "camera_target": ...}, ...]

A camera's pose has `format`, `version` and `T_base_camera` or `T_gripper_camera`; who writes one by
hand may leave out the rest.
"""

import os
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.errors import BadFile, one_line, quoted
from jshape.io.files import JSON_LIMIT, parse_json, read_bytes, read_json, write_json
from jshape.robot.calibration import MOST, NEAR_HAND, PAIR_TOLERANCE, TARGET, Calibration, Residuals
from jshape.robot.rigid import (
    BadPose,
    check_far,
    check_rigid,
    nearest_rigid,
    pose_at,
    quaternion_of,
)

FORMAT = "jshape-pose"
VERSION = 1
PARENTS = ("base", "gripper")
"""Frames that a camera's pose may be in."""


class PosePairs(NamedTuple):
    """What a calibration is made from."""

    base_gripper: Float[np.ndarray, "N 4 4"]
    """Of the gripper in the arm's base frame, metres."""
    camera_target: Float[np.ndarray, "N 4 4"]
    """Of the target in the camera's frame, metres."""


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Where a camera is."""

    matrix: Float[np.ndarray, "4 4"]
    """T_base_camera or T_gripper_camera, metres."""
    parent: str = "base"
    """base; gripper for a camera in the hand."""
    camera: str = ""
    """What people call the camera."""
    found: dict[str, Any] = field(default_factory=dict)
    """How it was found: anything that JSON can hold."""
    residuals: dict[str, Any] = field(default_factory=dict)
    """How well it fits, likewise."""


def read_pairs(path: str | os.PathLike) -> PosePairs:
    """The pose pairs of a file.

    Raises:
      BadFile: the file cannot be read, or is no list of pairs.
      BadPose: a pose that is not rigid, or not in metres.
    """
    where = str(path)
    data = read_bytes(path, limit=JSON_LIMIT).removeprefix(b"\xef\xbb\xbf")
    if data.lstrip().startswith(b"["):
        data = b'{"poses": ' + data + b"}"
    pairs = parse_json(data, where).get("poses")
    if not isinstance(pairs, list) or not pairs:
        raise BadFile(f'{where}: expected [{{"base_gripper": ..., "camera_target": ...}}, ...]')
    if len(pairs) > MOST:
        raise BadFile(f"{where}: holds {len(pairs)} pairs; at most {MOST} are taken")
    hands, targets = (
        np.array([_pose_in(pair, name, f"{where}: pair {k + 1}") for k, pair in enumerate(pairs)])
        for name in ("base_gripper", "camera_target")
    )
    return PosePairs(hands, targets)


def read_gripper(path: str | os.PathLike) -> Float[np.ndarray, "4 4"]:
    """T_base_gripper of a file that holds `{"base_gripper": POSE}`, metres.

    Raises:
      BadFile: the file cannot be read, or holds no such pose.
      BadPose: a pose that is not rigid, or not in metres.
    """
    pose = _pose_in(read_json(path), "base_gripper", str(path))
    check_far(pose, NEAR_HAND, f"{path}: base_gripper: the gripper", "the base")
    return pose


def write_pose(path: str | os.PathLike, pose: CameraPose) -> None:
    """Write where a camera is, atomically.

    Raises:
      BadPose: the matrix is not rigid, or not in metres.
      BadFile: it cannot be written.
    """
    name = _name(pose.parent, str(path))
    matrix = check_rigid(pose.matrix, f"{path}: {name}")
    write_json(
        path,
        {
            "format": FORMAT,
            "version": VERSION,
            "camera": pose.camera,
            "units": "metres; points of the camera's frame times the matrix are in the "
            + f"{pose.parent}'s frame; quaternion x, y, z, w",
            name: matrix,
            "position_m": matrix[:3, 3],
            "quaternion_xyzw": quaternion_of(matrix),
            "found": pose.found,
            "residuals": pose.residuals,
        },
    )


def read_pose(path: str | os.PathLike) -> CameraPose:
    """Where a camera is.  Only the matrix counts: position and quaternion are for people.

    Raises:
      BadFile: not such a file, or from a newer version.
      BadPose: the matrix is not rigid (1e-4), or not in metres.
    """
    where, fields = str(path), read_json(path)
    if fields.get("format") != FORMAT:
        raise BadFile(f"{where}: format is {quoted(fields.get('format'))}; expected {FORMAT!r}")
    version = fields.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise BadFile(f"{where}: version is {quoted(version)}; this program reads up to {VERSION}")
    there = [parent for parent in PARENTS if _name(parent, where) in fields]
    if len(there) != 1:
        raise BadFile(f"{where}: has {len(there)} of T_base_camera, T_gripper_camera; expected one")
    parent = there[0]
    for name, kind, word in (
        ("camera", str, "text"), ("found", dict, "an object"), ("residuals", dict, "an object"),
    ):  # fmt: skip
        if not isinstance(fields.get(name, kind()), kind):
            raise BadFile(f"{where}: {name} is {quoted(fields[name])}; expected {word}")
    matrix = _matrix(fields[_name(parent, where)], f"{where}: {_name(parent, where)}")
    if parent == "base" and matrix[:3, 3].any():  # a camera's frame may be taken for the base
        check_far(matrix, NEAR_HAND, f"{where}: T_base_camera: the camera", "the base")
    return CameraPose(
        matrix,
        parent,
        **{name: fields[name] for name in ("camera", "found", "residuals") if name in fields},
    )


def read_base_camera(
    path: str | os.PathLike, gripper: str | os.PathLike | None = None
) -> Float[np.ndarray, "4 4"]:
    """T_base_camera of a file, metres.

    Args:
      path: where the camera is.
      gripper: file with T_base_gripper when the camera looked, if it is in the hand.

    Raises:
      BadFile: the files cannot be read; the camera is in the hand and `gripper` is missing, or the
        other way round.
      BadPose: a matrix that is not rigid, or not in metres.
    """
    pose = read_pose(path)
    if (pose.parent == "gripper") != (gripper is not None):
        raise BadFile(
            f"{path}: is T_{pose.parent}_camera; "
            + (
                "the pose of the gripper in which the camera looked is needed too (--gripper)"
                if gripper is None
                else "a fixed camera needs no pose of the gripper"
            )
        )
    return pose.matrix if gripper is None else read_gripper(gripper) @ pose.matrix


def pose_of_calibration(found: Calibration, camera: str = "") -> CameraPose:
    """A calibration as a file keeps it."""
    residuals: dict[str, Any] = {"pairs": _residual_fields(found.residuals)}
    if found.left_out is not None:
        residuals["left_out"] = _residual_fields(found.left_out)
    return CameraPose(
        nearest_rigid(found.pose),
        "gripper" if found.eye_in_hand else "base",
        camera,
        {
            "how": "hand-eye calibration",
            "set_up": "eye-in-hand" if found.eye_in_hand else "eye-to-hand",
            "method": found.method,
            "pairs": len(found.residuals.mm),
            "turn_deg": found.turn_deg,
            "tried_mm": found.tried_mm,
            "warnings": list(found.warnings),
        },
        residuals | {"square_m": TARGET},
    )


def _residual_fields(residuals: Residuals) -> dict[str, Any]:
    """Mean, largest and all; null where a pair has none."""
    fields = {}
    for name, values in residuals._asdict().items():
        if values is None:
            continue
        ok = values[np.isfinite(values)]
        fields[name] = {
            "mean": float(ok.mean()) if len(ok) else None,
            "max": float(ok.max()) if len(ok) else None,
            "each": [float(x) if np.isfinite(x) else None for x in values],
        }
    return fields


def _pose_in(fields: Any, name: str, where: str) -> np.ndarray:
    """A pose that is a matrix, or a position in mm and a quaternion."""
    if not isinstance(fields, dict) or name not in fields:
        raise BadFile(f"{where}: has no {name}")
    where, value = f"{where}: {name}", fields[name]
    if not isinstance(value, dict):
        return nearest_rigid(_matrix(value, where, PAIR_TOLERANCE))
    if set(value) != {"xyz_mm", "quat"}:
        raise BadFile(
            f"{where}: has {one_line(', '.join(map(repr, value)), 60) or 'nothing'}; "
            "expected 'xyz_mm' and 'quat' (x, y, z, w); metres go into a 4x4 matrix"
        )
    position, quaternion = (
        _numbers(value[part], count, f"{where}: {part}")
        for part, count in (("xyz_mm", 3), ("quat", 4))
    )
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > 1e-2:
        raise BadPose(f"{where}: quat has length {length:.4g}; a rotation has 1")
    return check_rigid(pose_at(position / 1e3, quaternion), where)


def _matrix(value: Any, where: str, tolerance: float | None = None) -> np.ndarray:
    if not isinstance(value, list) or len(value) != 4:
        raise BadFile(f"{where}: is {quoted(value)}; expected 4 rows of 4 numbers")
    rows = np.array([_numbers(row, 4, f"{where}: row {k + 1}") for k, row in enumerate(value)])
    return check_rigid(rows, where) if tolerance is None else check_rigid(rows, where, tolerance)


def _numbers(value: Any, count: int, where: str) -> np.ndarray:
    """So many numbers; JSON's true is none, nor is a whole number that no float holds."""
    if (
        not isinstance(value, list)
        or len(value) != count
        or any(type(x) not in (int, float) or abs(x) > 1e300 for x in value)
    ):
        raise BadFile(f"{where} is {quoted(value)}; expected {count} numbers")
    return np.array(value, np.float64)


def _name(parent: str, where: str) -> str:
    if parent not in PARENTS:
        raise BadFile(f"{where}: parent is {quoted(parent)}; allowed: {', '.join(PARENTS)}")
    return f"T_{parent}_camera"
