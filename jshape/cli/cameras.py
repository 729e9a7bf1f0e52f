"""What commands that look through a camera share: its options, and opening it."""

import argparse
from pathlib import Path
from typing import Any

from jshape.cli import arguments
from jshape.errors import JShapeError, quoted
from jshape.robot.cameras import names
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.cameras.files import FILES
from jshape.robot.registry import usage

CAMERA_HELP = ", ".join([*usage(names.CAMERAS), *(format.help for format in FILES)])
"""All that opens as a camera."""


def window(text: str) -> tuple[int, int, int, int]:
    """A window: "181,46,480x395" is left, top, width and height in pixels."""
    try:
        left, top, size = text.split(",")
        width, height = size.split("x")
        return int(left), int(top), int(width), int(height)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{quoted(text)} is not LEFT,TOP,WIDTHxHEIGHT in pixels, such as 181,46,480x395"
        ) from None


def depth_range(text: str) -> tuple[float, float]:
    """Two depths: "0.42,0.47"."""
    try:
        low, high = (arguments.positive(part) for part in text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"{quoted(text)} is not two depths in metres, such as 0.42,0.47"
        ) from None
    return low, high


def add_camera(parser: argparse.ArgumentParser) -> None:
    """The camera, and the options that say how to look through it."""
    source: Any = parser.add_argument("source", nargs="?", metavar="CAMERA", help=CAMERA_HELP)
    source.setting = "camera"  # its key in a configuration file
    parser.add_argument("--camera-file", "--camera", dest="camera", type=Path, metavar="FILE",
                        help="camera.json to believe instead of what the camera says")  # fmt: skip
    unit: Any = parser.add_argument(
        "--depth-unit", type=arguments.positive, metavar="METRES",
        help="what 1 stands for in a bag's or picture's frames (as it says)",
    )  # fmt: skip
    unit.setting = ""  # that of a configuration file is of images
    add_looking(parser, temporal=False)


def add_part(parser: argparse.ArgumentParser) -> None:
    """Which part of the frames is the bed."""
    parser.add_argument("--depth-range", type=depth_range, metavar="NEAR,FAR",
                        help="metres between which the bed lies (camera.json's, or 0.42,0.47)"
                        )  # fmt: skip
    parser.add_argument("--window", type=window, metavar="LEFT,TOP,WIDTHxHEIGHT",
                        help="the part of the frames to take: the box (all)")  # fmt: skip


def add_looking(parser: argparse.ArgumentParser, *, temporal: bool) -> None:
    """How to look through a camera; `temporal` says whether the SDK's filter is usually on."""
    parser.add_argument("--topic", help="of a bag's depth frames (the only one)")
    add_part(parser)
    parser.add_argument("--temporal", action=argparse.BooleanOptionalAction, default=temporal,
                        help=f"RealSense: the SDK's temporal filter ({'on' if temporal else 'off'})"
                        )  # fmt: skip
    parser.add_argument("--fill-holes", action="store_true",
                        help="RealSense: the SDK's hole filling")  # fmt: skip


def opened(options: argparse.Namespace) -> DepthCamera:
    """The camera of the options that `add_camera` added, started."""
    if options.source is None:
        raise JShapeError("which camera? name one, or set camera in jshape.toml")
    return looking(options.source, options.camera, options, options.depth_unit)


def looking(
    name: str,
    camera_file: Path | None,
    options: argparse.Namespace,
    depth_unit: float | None = None,
) -> DepthCamera:
    """A camera by its name, started, and looked through as `add_looking`'s options say.

    Raises:
      JShapeError: as for `open_camera`; a camera.json is no camera.
    """
    if Path(name).suffix.lower() == ".json" and Path(name).is_file():
        raise JShapeError(
            f"{name}: describes a camera and is none: --camera-file takes it; a camera is "
            f"{CAMERA_HELP}"
        )
    return names.open_camera(
        name,
        camera=camera_file,
        topic=options.topic,
        z_range=options.depth_range,
        window=options.window,
        temporal=options.temporal,
        holes=options.fill_holes,
        depth_unit=depth_unit,
    )
