"""Poses on disk: pairs for hand-eye calibration, and where a camera is.

Both are JSON.  Pairs are a list, or an object with the list as `poses`; each pose is a 4x4 matrix
in metres, or `{"xyz_mm": [x, y, z], "quat": [x, y, z, w]}`:

    [{"base_gripper": ..., "camera_target": ...}, ...]

A camera's pose has `format`, `version` and `T_base_camera` or `T_gripper_camera`; who writes one by
hand may leave out the rest.
"""

import os
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.errors import BadFile
from jshape.io.files import JSON_LIMIT, parse_json, read_bytes, read_json, write_json
from jshape.io.records import Numbers, check_format, read_record, read_value
from jshape.robot.calibration import MOST, NEAR_HAND, Calibration
from jshape.robot.hand_eye import PAIR_TOLERANCE, TARGET, Residuals
from jshape.robot.rigid import (
    TOLERANCE,
    BadPose,
    check_far,
    check_rigid,
    pose_at,
    quaternion_of,
)

FORMAT = "jshape-pose"
VERSION = 1
PARENTS = ("base", "gripper")
"""Frames that a camera's pose may be in."""


_Matrix = Annotated[np.ndarray, Numbers((4, 4))]


@dataclass(frozen=True, eq=False)
class _Position:
    """A pose that is no matrix; metres go into one."""

    xyz_mm: Annotated[np.ndarray, Numbers((3,))]
    quat: Annotated[np.ndarray, Numbers((4,))]


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
      BadFile: it cannot be read, or is no list of pairs.
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
        np.array([_pose_in(one, name, f"{where}: pair {k}") for k, one in enumerate(pairs, 1)])
        for name in PosePairs._fields
    )
    return PosePairs(hands, targets)


def read_gripper(path: str | os.PathLike) -> Float[np.ndarray, "4 4"]:
    """T_base_gripper of a file with `{"base_gripper": POSE}`, metres; raises as `read_pairs`."""
    pose = _pose_in(read_json(path), "base_gripper", str(path))
    check_far(pose, NEAR_HAND, f"{path}: base_gripper: the gripper", "the base")
    return pose


def write_pose(path: str | os.PathLike, pose: CameraPose) -> None:
    """Write where a camera is, atomically.

    Raises:
      BadPose: the matrix is not rigid, or not in metres.
      BadFile: it cannot be written.
    """
    name = f"T_{read_value(Literal[PARENTS], pose.parent, f'{path}: parent')}_camera"
    matrix = check_rigid(pose.matrix, f"{path}: {name}")
    write_json(
        path,
        {
            "format": FORMAT,
            "version": VERSION,
            "camera": pose.camera,
            "units": "metres; points of the camera's frame times the matrix are in the "
            f"{pose.parent}'s frame; quaternion x, y, z, w",
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
    where, content = str(path), read_json(path)
    check_format(content, FORMAT, VERSION, where)
    there = [parent for parent in PARENTS if f"T_{parent}_camera" in content]
    if len(there) != 1:
        raise BadFile(f"{where}: has {len(there)} of T_base_camera, T_gripper_camera; expected one")
    parent = there[0]
    kinds = {"camera": str, "found": dict, "residuals": dict}
    said = {n: read_value(kinds[n], content[n], f"{where}: {n}") for n in kinds if n in content}
    matrix = _matrix(content[f"T_{parent}_camera"], f"{where}: T_{parent}_camera")
    if parent == "base" and matrix[:3, 3].any():  # a camera's frame may be taken for the base
        check_far(matrix, NEAR_HAND, f"{where}: T_base_camera: the camera", "the base")
    return CameraPose(matrix, parent, **said)


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
        found.pose,
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
        return _matrix(value, where, PAIR_TOLERANCE)
    read = read_record(_Position, value, where)
    length = float(np.linalg.norm(read.quat))
    if abs(length - 1) > 1e-2:
        raise BadPose(f"{where}: quat has length {length:.4g}; a rotation has 1")
    return check_rigid(pose_at(read.xyz_mm / 1e3, read.quat), where)


def _matrix(value: Any, where: str, tolerance: float = TOLERANCE) -> np.ndarray:
    return check_rigid(read_value(_Matrix, value, where), where, tolerance)
