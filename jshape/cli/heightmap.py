"""`jshape heightmap FRAME [FRAME ...] --out MAP.npz`."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli.names import Preset
from jshape.cli.options import File, Positive, Window, Writes
from jshape.cli.tables import print_table, warn
from jshape.data.fusion import MapReport, map_report
from jshape.data.looks import check_still, taken, together
from jshape.data.set_up import STEEPEST_DEG
from jshape.errors import BadFile
from jshape.height_map import HeightMap
from jshape.io import files
from jshape.io.cameras import read_bed
from jshape.io.frames import CameraFrames, read_looks
from jshape.io.maps import SUFFIX, read_map, write_map
from jshape.viz.style import drawn


@dataclass(frozen=True, kw_only=True)
class HeightmapOptions(Writes):
    """Of `jshape heightmap`."""

    out: Annotated[Path, Parameter(metavar="MAP.npz")]
    """The map; a picture of the same name comes beside it."""
    camera_file: Annotated[
        list[Preset] | None, Parameter(metavar="FILE", consume_multiple=True)
    ] = None
    """camera.json, or a preset's name (default: camera.json beside the frames): one for all frames,
    or one for each, with a pose."""
    depth_unit: Positive | None = None
    """Metres per count of 16-bit images (default: as camera.json says)."""
    window: Window | None = None
    """The part of the first camera's frames that holds the bed (default: its largest surface)."""
    pitch_mm: Positive | None = None
    """Between nodes, at most 1024 a side (default: a pixel of the first camera, if so many do)."""
    like: Annotated[Path | None, File] = None
    """A map of an earlier look: the new one has its frame and nodes."""


def heightmap(frame: Path, /, *frames: Path, options: HeightmapOptions) -> dict[str, Any]:
    """Find the bed's plane, see it from straight above, print how well it was seen, write it.

    Args:
      frame: Depth image, or folder of a recording.
      frames: More of the resting bed: they are averaged; or one of each other camera.
    """
    if options.out.suffix.lower() != SUFFIX:
        raise BadFile(f"{options.out}: a height map's file ends in {SUFFIX}")
    picture = options.picture_beside(options.out, (frame, *frames))
    if options.like is not None:
        options.refuse(("pitch_mm",), ": the map of --like has its own")
    like = None if options.like is None else read_map(options.like)
    cameras = read_looks((frame, *frames), options.camera_file or (), options.depth_unit)
    depths, where = [one.depths for one in cameras], cameras[0].named
    names = [f"{one.named} of {one.said}" for one in cameras]
    pitch = None if options.pitch_mm is None else options.pitch_mm / 1e3
    of = [one.camera for one in cameras]
    looks = taken(depths, of, window=options.window, where=where, names=names)
    bed = read_bed(cameras[0].said) if like is None else None
    how = {"like": like, "frame": bed, "pitch": pitch, "where": where, "before": str(options.like)}
    found, target, each = together(looks, **how)
    if bed is not None:
        level = replace(found, heights=np.zeros_like(found.heights), seen=None)
        check_still(found, level, where, f"{cameras[0].said} (bed)")
    report = map_report(looks, [len(one.depths) for one in cameras], found, target, each)
    write_map(options.out, found)
    for one, stand in zip(cameras, report.cameras, strict=True):
        if stand.tilt_deg > STEEPEST_DEG:
            warn(
                f"{one.named}: the bed is seen {stand.tilt_deg:.0f} degrees from straight above; "
                f"maps were measured up to {STEEPEST_DEG:g}: is it the bed, and no wall?"
            )
    result = _fields(found, report, cameras) | {"out": str(options.out)}
    _print(found, report, cameras)
    from jshape.viz.maps import map_figure

    title = f"{report.seen:.1%} seen, nodes {1e3 * float(found.pitch):.3g} mm apart"
    made = drawn({str(picture): partial(map_figure, found, title)})
    for content in made.values():
        files.write_atomic(picture, content)
        result["picture"] = str(picture)
    print(f"height map: {options.out}" + f"; picture: {picture}" * bool(made))
    return result


def _fields(found: HeightMap, report: MapReport, cameras: list[CameraFrames]) -> dict[str, Any]:
    rows, columns = np.shape(found.heights)
    return {
        "rows": rows,
        "columns": columns,
        "pitch_m": float(found.pitch),
        "origin_m": [float(x) for x in found.origin],
        "frame": found.frame,
        **{name: getattr(report, name) for name in ("seen", "noise_mm", "low_mm", "high_mm")},
        "cameras": [
            {"name": one.name, "camera": one.said} | stand._asdict()
            for one, stand in zip(cameras, report.cameras, strict=True)
        ],
    }


def _print(found: HeightMap, report: MapReport, cameras: list[CameraFrames]) -> None:
    head = ("frames", "camera", "tilt (°)", "distance (mm)", "sees (%)", "noise (mm)")
    rows = []
    for one, stand in zip(cameras, report.cameras, strict=True):
        rows.append(
            (
                one.named,
                one.said,
                f"{stand.tilt_deg:.1f}",
                f"{1e3 * stand.distance:.0f}",
                f"{100 * stand.seen:.1f}",
                f"{stand.noise_mm:.2f}",
            )
        )
    if len(rows) > 1:
        rows.append(("together", "", "", "", f"{100 * report.seen:.1f}",
                     f"{report.noise_mm:.2f}"))  # fmt: skip
    print_table(head, rows)
    rows_, columns = np.shape(found.heights)
    pitch = 1e3 * float(found.pitch)
    print(
        f"map: {columns}x{rows_} nodes {pitch:.3g} mm apart, {columns * pitch:.0f}x"
        f"{rows_ * pitch:.0f} mm, {report.seen:.1%} seen; heights {report.low_mm:.1f} to "
        f"{report.high_mm:.1f} mm over the plane: a relief of "
        f"{report.high_mm - report.low_mm:.1f} mm (without the last hundredth at each end)"
    )
