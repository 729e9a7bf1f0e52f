"""`jshape calibrate POSES --out FILE`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli.names import Preset
from jshape.cli.options import CameraFile, File, Writes
from jshape.cli.tables import print_table, warn
from jshape.io.cameras import described
from jshape.robot import calibration, pose_file
from jshape.robot.calibration import Calibration
from jshape.robot.hand_eye import METHODS, TARGET


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(Writes):
    """Of `jshape calibrate`."""

    out: Annotated[Path, File]
    """File for the camera's pose (JSON)."""
    camera_file: Annotated[Preset | None, CameraFile] = None
    """camera.json or a preset's name, to say errors in its pixels too."""
    name: str = ""
    """Name of the camera (default: that of its file)."""
    method: Annotated[str | None, Parameter(choices=tuple(METHODS), metavar="NAME")] = None
    """Method that finds the pose (default: the one that fits best)."""
    eye_in_hand: bool = False
    """Camera in the gripper, target fixed (default: camera fixed, target in the gripper)."""


def calibrate(poses: Path, /, options: CalibrateOptions) -> dict[str, Any]:
    """Read pose pairs, find the camera, print how well they fit, write its pose.

    Args:
      poses: JSON: pairs of base_gripper and camera_target.
    """
    options.check_new(options.out)
    pairs = pose_file.read_pairs(poses)
    found = calibration.calibrate(
        *pairs,
        eye_in_hand=options.eye_in_hand,
        method=options.method,
        camera=None if options.camera_file is None else described(options.camera_file, 1.0)[0],
    )
    name = options.name or (Path(options.camera_file).name if options.camera_file else "")
    pose = pose_file.pose_of_calibration(found, name)
    pose_file.write_pose(options.out, pose)
    _print(found)
    print(f"pose of the camera: {options.out}")
    return {
        f"T_{pose.parent}_camera": pose.matrix.tolist(),
        "camera": pose.camera,
        "found": pose.found,
        "residuals": pose.residuals,
        "out": str(options.out),
    }


def _print(found: Calibration) -> None:
    set_up = "camera in the hand" if found.eye_in_hand else "fixed camera"
    print(
        f"{len(found.residuals.mm)} pose pairs, {set_up}; turned by {found.turn_deg:.0f}° about "
        "the least-turned axis"
    )
    side = f"{1e3 * TARGET:g} mm square"
    tried = sorted(found.tried_mm.items(), key=lambda item: item[1])
    print(f"mean error of a {side}: " + ", ".join(f"{n} {mm:.3f} mm" for n, mm in tried))
    print(f"T_{'gripper' if found.eye_in_hand else 'base'}_camera by {found.method}, metres:")
    for row in found.pose:
        print("  " + " ".join(f"{x + 0.0:10.6f}" for x in np.round(row, 6)))
    inside, outside = found.residuals, found.left_out
    head = ("", "mean", "max", *(() if outside is None else ("left out: mean", "max")))
    rows = []
    for what, name in (
        ("position (mm)", "mm"),
        ("rotation (°)", "degrees"),
        (f"{side} (mm)", "points_mm"),
        (f"{side} (px)", "pixels"),
    ):
        parts = [getattr(part, name) for part in (inside, outside) if part is not None]
        if parts[0] is None:
            continue
        known = [values[np.isfinite(values)] for values in parts]
        ends = [(f"{x.mean():.3f}", f"{x.max():.3f}") if len(x) else ("-", "-") for x in known]
        rows.append((what, *(x for pair in ends for x in pair)))
    print_table(head, rows)
    for line in found.warnings:
        warn(line)
