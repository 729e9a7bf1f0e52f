"""What commands that look through a camera share: its options, and opening it."""

import argparse
from pathlib import Path

from jshape.commands import arguments
from jshape.robot.cameras.base import DepthCamera

CAMERA_HELP = "realsense[:SERIAL|:FILE.db3], sim[:SEED], a ROS bag, a recording's folder, a picture"


def window(text: str) -> tuple[int, int, int, int]:
    """A window: "181,46,480x395" is left, top, width and height in pixels."""
    try:
        left, top, size = text.split(",")
        width, height = size.split("x")
        return int(left), int(top), int(width), int(height)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LEFT,TOP,WIDTHxHEIGHT in pixels, such as 181,46,480x395"
        ) from None


def depth_range(text: str) -> tuple[float, float]:
    """Two depths: "0.42,0.47"."""
    try:
        low, high = (arguments.positive(part) for part in text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not two depths in metres, such as 0.42,0.47"
        ) from None
    return low, high


def add_camera(parser: argparse.ArgumentParser) -> None:
    """The camera, and the options that say how to look through it."""
    parser.add_argument("source", metavar="CAMERA", help=CAMERA_HELP)
    parser.add_argument("--camera", type=Path, metavar="FILE",
                        help="camera.json to believe instead of what the camera says")  # fmt: skip
    parser.add_argument("--topic", help="of a bag's depth frames (the only one)")
    parser.add_argument("--depth-range", type=depth_range, metavar="NEAR,FAR",
                        help="metres between which the bed lies (0.42,0.47)")  # fmt: skip
    parser.add_argument("--window", type=window, metavar="LEFT,TOP,WIDTHxHEIGHT",
                        help="the part of the frames to take: the box (all)")  # fmt: skip
    parser.add_argument("--temporal", action="store_true",
                        help="RealSense: the SDK's temporal filter")  # fmt: skip
    parser.add_argument("--fill-holes", action="store_true",
                        help="RealSense: the SDK's hole filling")  # fmt: skip


def opened(options: argparse.Namespace) -> DepthCamera:
    """The camera of the options that `add_camera` added, started."""
    from jshape.robot.cameras.names import open_camera

    return open_camera(
        options.source,
        camera=options.camera,
        topic=options.topic,
        z_range=options.depth_range,
        window=options.window,
        temporal=options.temporal,
        holes=options.fill_holes,
    )
