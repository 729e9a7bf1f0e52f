"""`jshape record CAMERA --out DIR`: depth frames for `jshape dataset segment`."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli import cameras
from jshape.cli.cameras import CAMERA_HELP, Camera, LooksOnce
from jshape.cli.options import Duration, PositiveCount, Writes
from jshape.cli.tables import progress
from jshape.data.depth import check_unit
from jshape.data.missing import only_readings
from jshape.data.missing import said as said_of
from jshape.data.set_up import VALID_LEAST
from jshape.errors import JShapeError
from jshape.io import folders, recordings
from jshape.robot.cameras.base import FRAMES, CameraLost, DepthCamera, EndOfFrames, traits_of


@dataclass(frozen=True, kw_only=True)
class RecordOptions(LooksOnce, Writes):
    """Of `jshape record`."""

    out: Path
    """Folder for the recording."""
    frames: PositiveCount | None = None
    """Number of frames (default: until Ctrl-C)."""
    seconds: Duration | None = None
    """Length of the recording (default: until Ctrl-C)."""
    every: Duration | None = None
    """Time between frames, such as 0.5s (default: all that come)."""


def record(
    camera: Annotated[Camera | None, Parameter(help=CAMERA_HELP)] = None,
    /,
    *,
    options: RecordOptions,
) -> dict[str, Any]:
    """Record until as many frames or seconds as asked, the end of what is played, or Ctrl-C."""
    folders.check_target(options.out, options.overwrite, contents=recordings.CONTENTS)
    problem: JShapeError | None = None
    valid, left_out = 0.0, Counter()
    why = "as many as asked"
    with closing(cameras.opened(camera, options)) as device:
        asked, frames = _frames(device, options)
        started = time.monotonic()
        with recordings.recording_writer(
            options.out, device.camera, device.depth_unit, overwrite=options.overwrite
        ) as add:
            try:
                for counts in progress(frames, asked or 0, "recording"):
                    seen = only_readings(counts, left_out)
                    valid += float((seen > 0).mean())
                    if not add.count:
                        depth = np.float32(device.depth_unit) * seen
                        check_unit(depth, device.camera, device.name, device.depth_unit)
                    add(counts)  # as it came
            except EndOfFrames:
                why = "the end of the recording"
            except KeyboardInterrupt:
                why = "interrupted"
                if not add.count:
                    raise
            except JShapeError as lost:
                problem = lost
                if not add.count:  # nothing to keep
                    raise
        took = time.monotonic() - started
    count, share = add.count, valid / add.count
    if problem is not None:
        raise CameraLost(
            f"{problem}; what came before, {count} frame{'s' * (count > 1)}, is kept in "
            f"{options.out}"
        )
    if not valid:
        raise JShapeError(
            f"{device.name}: no pixel has a reading in {count} frame{'s' * (count > 1)}, kept in "
            f"{options.out} all the same; jshape setup says more"
        )
    result = {
        "out": str(options.out), "camera": device.name, "frames": count, "valid_share": share,
        "seconds": took, "stopped": why, "left_out": left_out,
    }  # fmt: skip
    _print(result, device)
    return result


def _print(result: dict[str, Any], camera: DepthCamera) -> None:
    size, count = camera.camera, result["frames"]
    frames = f"{count} frame{'s' * (count > 1)} of {size.width}x{size.height}"
    took = f"{result['seconds']:.1f} s ({result['stopped']})"
    print(f"{camera.name}: {frames} in {took}: {result['out']}")
    share = result["valid_share"]
    print(f"{share:.1%} of the pixels have a reading{said_of(result['left_out'])}", end="")
    print("" if share >= VALID_LEAST else "; too few: see jshape setup")


def _frames(camera: DepthCamera, options: RecordOptions) -> tuple[int | None, Iterator[np.ndarray]]:
    """How many frames there will be, if that is known; and the frames."""
    live, still, _ = traits_of(camera)
    if not live and (options.seconds or options.every):
        raise JShapeError(
            f"{camera.name}: --seconds and --every are for live cameras; "
            "of a recording, --frames says how many"
        )
    asked = options.frames
    if asked is None and still and not options.seconds:
        asked = 1  # it would go on for ever, all the same
    count = options.frames or (asked if still else None)
    return asked, _take(camera, count, options)


def _take(camera: DepthCamera, count: int | None, options: RecordOptions) -> Iterator[np.ndarray]:
    """The frames to keep.

    Raises:
      CameraLost: as many frames as a look has were the same to the bit.
      EndOfFrames: before there were as many as asked.
    """
    taken = same = 0
    before: np.ndarray | None = None
    start = due = 0.0
    while count is None or taken < count:
        counts = camera.frame()
        now = time.monotonic()
        if before is None:  # the first may take a while to come
            start = due = now
        if options.seconds is not None and now - start > options.seconds:
            return
        alike = not (before is None or traits_of(camera).still) and np.array_equal(counts, before)
        same = same + 1 if alike and counts.any() else 0
        before = counts
        if same + 1 >= FRAMES:
            raise CameraLost(f"{camera.name}: {FRAMES} frames are the same to the bit: it is stuck")
        if options.every is not None:
            if now < due:  # it is read all the same, so that the frame that counts is a new one
                continue
            due = max(due + options.every, now)
        taken += 1
        yield counts
