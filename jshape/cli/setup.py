"""`jshape setup CAMERA --out camera.json`: how a camera stands over its bed, and its file."""

from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli.camera import CAMERA_HELP, Camera, LooksOnce, opened
from jshape.cli.options import File, PositiveCount, Writes
from jshape.cli.tables import progress, write_pictures
from jshape.data import set_up
from jshape.data.missing import said as said_of
from jshape.data.view import plannable
from jshape.errors import BadFile
from jshape.height_map import as_frame
from jshape.io.cameras import camera_fields, write_camera
from jshape.robot.cameras.base import EndOfFrames, next_frame, traits_of
from jshape.robot.pose_file import read_base_camera


@dataclass(frozen=True, kw_only=True)
class SetupOptions(LooksOnce, Writes):
    """Of `jshape setup`."""

    out: Annotated[Path | None, Parameter(metavar="camera.json")] = None
    """The camera's file to write, for --camera-file; a picture, camera.setup.png, beside it."""
    base: Annotated[Path | None, File] = None
    """Pose of the camera from `jshape calibrate`, to keep in its file: for two cameras."""
    frames: PositiveCount = 30
    """Number of frames to look at."""

    def exit_code(self, result: Mapping[str, Any]) -> int:
        """1 where something is to be mended."""
        return int(not result["good"])


def setup(
    camera: Annotated[Camera | None, Parameter(help=CAMERA_HELP)] = None,
    /,
    options: SetupOptions = SetupOptions(),
) -> dict[str, Any]:
    """Look at a levelled, resting bed, say what to improve, write the camera's file."""
    picture = None
    if options.out is not None:
        if options.out.suffix != ".json":
            raise BadFile(f"{options.out}: a camera's file ends in .json")
        # Not camera.png: left.json describes what left.png shows.
        picture = options.picture_beside(options.out, (), ".setup.png")
    frames, left_out = [], Counter()
    # The file is of whole frames, wherever the bed is in them.
    with closing(opened(camera, replace(options, window=None))) as device:
        still = traits_of(device).still
        try:
            count = 1 if still else options.frames
            for _ in progress(range(count), count, "looking"):
                frames.append(next_frame(device, left_out))
        except EndOfFrames:  # a recording may be shorter
            if not frames:
                raise
    own = device.camera
    if options.base is not None:
        own = replace(own, pose=as_frame(read_base_camera(options.base)))
    found = set_up.measure(
        np.stack(frames), own, device.depth_unit, window=options.window, still=still,
        keep_range=options.depth_range is not None, where=device.name,
    )  # fmt: skip
    own = found.look.camera
    said = set_up.verdict(found, in_base=options.base is not None)
    if all(fine for fine, _ in said):  # else that is to be mended first
        refused = plannable(found.look.depth, own)
        said += [] if refused is None else [(False, refused)]
    arrays = "look", "map", "bed"
    measured = {name: x for name, x in found._asdict().items() if name not in arrays}
    result = {
        "camera": device.name,
        "fields": camera_fields(own) | {"depth_unit": device.depth_unit, "bed": found.map.frame},
        **{name: None if x != x else x for name, x in measured.items()},  # JSON has no NaN
        "seen": float(found.map.mask.mean()),
        "fills": float(found.bed.mean()),
        "left_out": left_out,
        "good": all(fine for fine, _ in said),
        "verdict": [{"good": fine, "says": sentence} for fine, sentence in said],
    }
    _print(result)
    if options.out is None or picture is None:
        return result
    write_camera(options.out, own, device.depth_unit, found.map.frame)
    result["out"] = str(options.out)
    from jshape.viz.maps import setup_figure

    draw = partial(setup_figure, found.look.depth, found.bed, found.map, device.name)
    made = write_pictures(picture.parent, {picture.name: draw})
    result |= {"picture": str(picture)} if made else {}
    print(f"camera file: {options.out}" + f"; picture: {picture}" * bool(made))
    return result


def _print(result: dict[str, Any]) -> None:
    c = result["fields"]
    print(f"{result['camera']}: {c['width']}x{c['height']} pixels, fx {c['fx']:g}, fy {c['fy']:g}, "
          f"u0 {c['u0']:g}, v0 {c['v0']:g}, {c['z_min']:g} to {c['z_max']:g} m; "
          f"{c['depth_unit']:g} m per count; {result['frames']} frame"
          f"{'s' * (result['frames'] > 1)}")  # fmt: skip
    if gaps := sum(result["left_out"].values()):
        print(f"pixels without depth in all frames: {gaps}{said_of(result['left_out'])}")
    for line in result["verdict"]:
        print(f"  {'ok ' if line['good'] else 'BAD'} {line['says']}")
    bad = sum(not line["good"] for line in result["verdict"])
    print(f"not good enough: {bad} of {len(result['verdict'])} to mend" if bad else "good enough")
