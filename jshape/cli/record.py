"""`jshape record CAMERA [CAMERA ...] --out DIR`: depth frames for `jshape dataset segment`."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli.camera import CAMERA_HELP, Camera, LooksOnce, every
from jshape.cli.options import Duration, File, PositiveCount, Writes
from jshape.cli.tables import progress
from jshape.data.depth import check_unit
from jshape.data.fusion import check_poses
from jshape.data.missing import only_readings
from jshape.data.missing import said as said_of
from jshape.data.set_up import VALID_LEAST
from jshape.errors import JShapeError
from jshape.io import at_once, folders, recordings
from jshape.robot.cameras.base import FRAMES, CameraLost, DepthCamera, EndOfFrames, traits_of

_CAMERAS = f"{CAMERA_HELP}; several record one bed at once"


@dataclass(frozen=True, kw_only=True)
class RecordOptions(LooksOnce, Writes):
    """Of `jshape record`."""

    out: Path
    """Folder for the recording; of several cameras for that of each: OUT/1, OUT/2 ..."""
    camera_file: Annotated[list[Path] | None, File] = None
    """camera.json to use instead of what the camera says of itself; of several cameras one for
    each, with a pose."""
    frames: PositiveCount | None = None
    """Number of frames (default: until Ctrl-C)."""
    seconds: Duration | None = None
    """Length of the recording (default: until Ctrl-C)."""
    every: Duration | None = None
    """Time between frames, such as 0.5s (default: all that come)."""


def record(
    camera: Annotated[list[Camera] | None, Parameter(help=_CAMERAS)] = None,
    /,
    *,
    options: RecordOptions,
) -> dict[str, Any]:
    """Record until as many frames or seconds as asked, the end of what is played, or Ctrl-C."""
    named = camera or []
    contents = recordings.CONTENTS if len(named) < 2 else at_once.CONTENTS
    folders.check_target(options.out, options.overwrite, contents=contents)
    problem: JShapeError | None = None
    valid = [0.0 for _ in named]
    left_out = [Counter() for _ in named]
    why = "as many as asked"
    with ExitStack() as stack:
        opened = every(named, options, options.depth_unit)
        devices = [stack.enter_context(closing(one)) for one in opened]
        check_poses([one.camera for one in devices], [one.name for one in devices])
        asked, frames = _frames(devices, options)
        started = time.monotonic()
        sources = [(one.camera, one.depth_unit) for one in devices]
        with at_once.writers(options.out, sources, overwrite=options.overwrite) as adders:
            add = adders[-1]  # the last to write a frame
            try:
                for shots in progress(frames, asked or 0, "recording"):
                    for k, (device, counts) in enumerate(zip(devices, shots, strict=True)):
                        seen = only_readings(counts, left_out[k])
                        valid[k] += float((seen > 0).mean())
                        if not adders[k].count:
                            depth = np.float32(device.depth_unit) * seen
                            check_unit(depth, device.camera, device.name, device.depth_unit)
                    for adder, counts in zip(adders, shots, strict=True):
                        adder(counts)  # as it came
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
    count = add.count
    frames_of = f"{count} frame{'s' * (count > 1)}"
    if problem is not None:
        raise CameraLost(f"{problem}; what came before, {frames_of}, is kept in {options.out}")
    for device, share in zip(devices, valid, strict=True):
        if not share:
            raise JShapeError(
                f"{device.name}: no pixel has a reading in {frames_of}, kept in {options.out} all "
                "the same; jshape setup says more"
            )
    results = []
    for k, (device, gaps) in enumerate(zip(devices, left_out, strict=True)):
        out = str(options.out / (str(k + 1) if len(devices) > 1 else ""))
        share = valid[k] / count
        result = {"out": out, "camera": device.name, "frames": count, "valid_share": share}
        results.append(result | {"seconds": took, "stopped": why, "left_out": gaps})
        size = f"{device.camera.width}x{device.camera.height}"
        print(f"{device.name}: {frames_of} of {size} in {took:.1f} s ({why}): {out}")
        hint = "; jshape setup says how many of the bed's have" * (share < VALID_LEAST)
        print(f"{share:.1%} of the pixels have a reading{said_of(gaps)}{hint}")
    return results[0] | ({"others": results[1:]} if results[1:] else {})


def _frames(
    cameras: Sequence[DepthCamera], options: RecordOptions
) -> tuple[int | None, Iterator[list[np.ndarray]]]:
    """How many frames there will be, if that is known; and the frames, one of each camera."""
    for camera in cameras:
        if not traits_of(camera).live and (options.seconds or options.every):
            raise JShapeError(
                f"{camera.name}: --seconds and --every are for live cameras; "
                "of a recording, --frames says how many"
            )
    still = all(traits_of(camera).still for camera in cameras)
    asked = options.frames
    if asked is None and still and not options.seconds:
        asked = 1  # it would go on for ever, all the same
    count = options.frames or (asked if still else None)
    return asked, _take(cameras, count, options)


def _take(
    cameras: Sequence[DepthCamera], count: int | None, options: RecordOptions
) -> Iterator[list[np.ndarray]]:
    """The frames to keep: the next of each camera, which are at most one frame's time apart.

    Raises:
      CameraLost: as many frames as a look has were the same to the bit.
      EndOfFrames: before there were as many as asked.
    """
    taken, same = 0, [0 for _ in cameras]
    before: list[np.ndarray] = []
    start = due = 0.0
    while count is None or taken < count:
        shots = [camera.frame() for camera in cameras]
        now = time.monotonic()
        if not before:  # the first may take a while to come
            start = due = now
        if options.seconds is not None and now - start > options.seconds:
            return
        for k, (camera, last) in enumerate(zip(cameras, before, strict=False)):
            alike = not traits_of(camera).still and np.array_equal(shots[k], last)
            same[k] = same[k] + 1 if alike and shots[k].any() else 0
            if same[k] + 1 >= FRAMES:
                raise CameraLost(
                    f"{camera.name}: {FRAMES} frames are the same to the bit: it is stuck"
                )
        before = shots
        if options.every is not None:
            if now < due:  # it is read all the same, so that the frame that counts is a new one
                continue
            due = max(due + options.every, now)
        taken += 1
        yield shots
