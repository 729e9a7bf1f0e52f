"""`jshape heightmap FRAME [FRAME ...] --out MAP.npz`."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from jshape.cli.names import Preset
from jshape.cli.options import File, Positive, Window, Writes
from jshape.cli.tables import print_table, warn, write_pictures
from jshape.data.fusion import map_report
from jshape.data.looks import MOST_UNLIKE, check_still, taken, together, unlike
from jshape.data.set_up import STEEPEST_DEG
from jshape.errors import BadFile
from jshape.io.cameras import read_bed
from jshape.io.frames import read_looks
from jshape.io.maps import SUFFIX, read_map, write_map


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
        share, far = unlike(one.depths, one.camera)
        if share > MOST_UNLIKE:
            warn(
                f"{one.named}: {share:.0%} of what they show differs between them by more than "
                f"{far:.1f} mm, and is averaged: are they of one resting bed?"
            )
        if stand.tilt_deg > STEEPEST_DEG:
            warn(
                f"{one.named}: the bed is seen {stand.tilt_deg:.0f} degrees from straight above; "
                f"maps were measured up to {STEEPEST_DEG:g}: is it the bed, and no wall?"
            )
    rows, columns = np.shape(found.heights)
    result = {
        "rows": rows,
        "columns": columns,
        "pitch_m": float(found.pitch),
        "origin_m": [float(x) for x in found.origin],
        "frame": found.frame,
        **{name: getattr(report, name) for name in ("seen", "noise_mm", "low_mm", "high_mm")},
        "cameras": [
            {"name": one.named, "camera": one.said} | stand._asdict()
            for one, stand in zip(cameras, report.cameras, strict=True)
        ],
        "out": str(options.out),
    }
    _print(result)
    from jshape.viz.maps import map_figure

    title = f"{report.seen:.1%} seen, nodes {1e3 * float(found.pitch):.3g} mm apart"
    made = write_pictures(options.out.parent, {picture.name: partial(map_figure, found, title)})
    result |= {"picture": str(picture)} if made else {}
    print(f"height map: {options.out}" + f"; picture: {picture}" * bool(made))
    return result


def _print(result: dict[str, Any]) -> None:
    head = ("frames", "camera", "tilt (°)", "distance (mm)", "sees (%)", "noise (mm)")
    rows = []
    for c in result["cameras"]:
        stands = f"{c['tilt_deg']:.1f}", f"{1e3 * c['distance']:.0f}"
        sees = f"{100 * c['seen']:.1f}", f"{c['noise_mm']:.2f}"
        rows.append((c["name"], c["camera"], *stands, *sees))
    if len(rows) > 1:
        sees = f"{100 * result['seen']:.1f}", f"{result['noise_mm']:.2f}"
        rows.append(("together", "", "", "", *sees))
    print_table(head, rows)
    rows, columns, pitch = result["rows"], result["columns"], 1e3 * result["pitch_m"]
    low, high = result["low_mm"], result["high_mm"]
    print(
        f"map: {columns}x{rows} nodes {pitch:.3g} mm apart, {columns * pitch:.0f}x"
        f"{rows * pitch:.0f} mm, {result['seen']:.1%} seen; heights {low:.1f} to {high:.1f} mm "
        f"over the plane: a relief of {high - low:.1f} mm (without the last hundredth at each end)"
    )
