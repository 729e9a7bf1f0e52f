"""`jshape camera check` and `jshape camera list`."""

import math
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import App, Parameter

from jshape.cli import cameras
from jshape.cli.cameras import CAMERA_HELP, Camera, LooksOnce
from jshape.cli.options import Common, File, PositiveCount, Writes
from jshape.cli.tables import print_table, progress
from jshape.data import camera_check
from jshape.data.missing import said as said_of
from jshape.data.view import plannable
from jshape.io import files
from jshape.io.cameras import camera_fields
from jshape.robot.cameras.base import EndOfFrames, next_frame, traits_of
from jshape.viz.style import drawn

camera = App(name="camera")


@dataclass(frozen=True, kw_only=True)
class CameraOptions(LooksOnce, Writes):
    """Of `jshape camera check`."""

    out: Annotated[Path | None, File] = None
    """Picture to write of what was measured."""
    frames: PositiveCount = 60
    """Number of frames to measure."""


@camera.command
def check(
    camera: Annotated[Camera | None, Parameter(help=CAMERA_HELP)] = None,
    /,
    options: CameraOptions = CameraOptions(),
) -> dict[str, Any]:
    """Look at a levelled, resting bed and say whether the set-up is good enough."""
    if options.out is not None:
        options.check_new(options.out)
    frames, left_out = [], Counter()
    with closing(cameras.opened(camera, options)) as device:
        try:
            for _ in progress(range(options.frames), options.frames, "looking"):
                frames.append(next_frame(device, left_out))
        except EndOfFrames:  # a recording may be shorter
            if not frames:
                raise
    measured = camera_check.measure(
        np.stack(frames), device.camera, device.depth_unit, still=traits_of(device).still
    )
    said = camera_check.verdict(measured.setup, device.camera)
    if all(fine for fine, _ in said):  # else that is to be mended first
        taken = plannable(measured.depth, device.camera)
        said += [] if taken is None else [(False, taken)]
    good = all(fine for fine, _ in said)
    result = {
        "camera": device.name,
        "intrinsics": camera_fields(device.camera) | {"depth_unit": device.depth_unit},
        **{name: _plain(value) for name, value in measured.setup._asdict().items()},
        "left_out": left_out,
        "good": good,
        "verdict": [{"good": fine, "says": sentence} for fine, sentence in said],
    }
    _print(result)
    if options.out is not None:
        from jshape.viz.camera_check import check_figure

        seen = measured.depth, measured.noise, measured.off
        name = str(options.out)
        for picture in drawn({name: partial(check_figure, *seen, device.name)}).values():
            files.write_atomic(options.out, picture)
            result["out"] = name
            print(f"picture: {name}")
    return result


def _plain(value: Any) -> Any:
    """NaN has no place in JSON."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _print(result: dict[str, Any]) -> None:
    c = result["intrinsics"]
    print(f"{result['camera']}: {c['width']}x{c['height']} pixels, fx {c['fx']:g}, fy {c['fy']:g}, "
          f"u0 {c['u0']:g}, v0 {c['v0']:g}; {c['depth_unit']:g} m per count; "
          f"{result['frames']} frame{'s' * (result['frames'] > 1)}")  # fmt: skip
    if gaps := sum(result["left_out"].values()):
        print(f"pixels without depth in all frames: {gaps}{said_of(result['left_out'])}")
    for line in result["verdict"]:
        print(f"  {'ok ' if line['good'] else 'BAD'} {line['says']}")
    bad = sum(not line["good"] for line in result["verdict"])
    fine = "good enough to record and to plan with"
    print(f"not good enough: {bad} of {len(result['verdict'])} to mend" if bad else fine)


@camera.command(name="list")
def list_cameras(*, options: Common = Common()) -> dict[str, Any]:
    """The RealSense cameras that are connected, and what else opens."""
    from jshape.robot.cameras.names import names
    from jshape.robot.cameras.realsense import devices

    found = devices()
    if found:
        print_table(("camera", "name"), [(f"realsense:{d.serial}", d.name) for d in found])
    else:
        print("no RealSense camera is connected")
    print("\nwhat opens as a camera:")
    print_table(("name", "what it is"), names())
    return {"devices": [{"name": d.name, "serial": d.serial} for d in found]}
