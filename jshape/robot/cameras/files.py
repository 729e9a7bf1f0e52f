"""Cameras over files: a ROS bag, a recording's folder, one depth picture."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.depth import check_numbers, check_shape, to_metres
from jshape.data.intrinsics import FLOAT_UNIT, Z_RANGE, counts_of, within
from jshape.errors import BadCamera, BadImage, JShapeError, one_line
from jshape.io import bags
from jshape.io.cameras import DEPTH_UNIT, described_beside
from jshape.io.formats import SUFFIXES, read_array
from jshape.io.recordings import CAMERA, open_recording
from jshape.robot.cameras.base import AS_THEY_SAY, CameraSettings
from jshape.robot.cameras.played import Played, calls


class Format(NamedTuple):
    """A kind of file that opens as a camera."""

    example: str
    """How its path looks."""
    help: str
    """What it is."""
    fits: Callable[[Path], bool]
    """Whether a path is one."""
    open: Callable[[Path, CameraSettings], Played]


def format_of(path: str | os.PathLike) -> Format | None:
    """The format of what is at a path; None: nothing that opens as a camera."""
    return next((one for one in FILES if one.fits(Path(path))), None)


def open_file(path: str, settings: CameraSettings) -> Played:
    """The camera over what is at a path; JShapeError: nothing that opens as one, or damaged."""
    found = format_of(path)
    if found is None:
        raise JShapeError(f"{path}: is none of {', '.join(one.help for one in FILES)}")
    return found.open(Path(path), settings)


def bag_camera(path: str | os.PathLike, given: CameraSettings = AS_THEY_SAY) -> Played:
    """The depth frames of a ROS 1, ROS 2 or MCAP bag, as fast as they are asked for.

    Raises:
      JShapeError: as for `jshape.io.bags.open_bag`.
    """
    bag = bags.open_bag(
        path,
        topic=given.topic,
        camera=given.camera,
        z_range=given.z_range or Z_RANGE,
        depth_unit=given.depth_unit,
    )
    name = one_line(f"{bag.path.name} {bag.topic}", 120)
    return Played(name, bag.camera, bag.depth_unit, bag.frames(), close=bag.close)


def folder_camera(folder: str | os.PathLike, given: CameraSettings = AS_THEY_SAY) -> Played:
    """The frames of a recording: a folder with `camera.json` and numbered 16-bit frames.

    Numbers may be missing: what was dropped does not matter to who looks.

    Raises:
      BadDataset, BadCamera: as for `jshape.io.recordings.open_recording`.
    """
    given.check_own(str(folder))
    found = open_recording(folder, allow_gaps=True)
    return Played(Path(folder).name or str(folder), found.camera, found.depth_unit, found.frames())


def picture_camera(path: str | os.PathLike, given: CameraSettings = AS_THEY_SAY) -> Played:
    """One depth picture, again and again: 16-bit PNG or TIFF (counts), NPY or float TIFF (metres).

    Without a camera given it is that of `camera.json` beside it, else the paper's if the size is.

    Raises:
      BadFile, BadImage: it cannot be read, is no depth picture, has another size, or numbers that
        make sense in another unit only.
      BadCamera: nothing says whose it is.
    """
    path = Path(path)
    raw = read_array(path)
    if raw.dtype == np.uint8:
        raise BadImage(f"{path}: holds luminance (8 bits); a camera's frames are 16-bit or metres")
    camera, unit = given.camera or _beside(path, raw.shape, given.depth_unit)
    camera = within(camera, given.z_range)
    check_shape(raw, camera, str(path))
    whole = raw.dtype == np.uint16
    unit = given.depth_unit or (unit if whole else 1.0)
    if given.depth_unit is None:
        check_numbers(raw, unit, camera, str(path))
    if whole:
        counts = np.ma.filled(raw, 0)
    else:
        counts, unit = counts_of(to_metres(raw, unit, str(path)) * unit), FLOAT_UNIT
    return Played(path.name, camera, unit, calls(counts.copy), still=True)


def _beside(path: Path, shape: tuple[int, ...], depth_unit: float | None) -> tuple[Camera, float]:
    if (found := described_beside(path, depth_unit)) is not None:
        return found.camera, found.depth_unit
    for known in (PAPER_BOX, D435_BAZAR):
        if known.shape == shape:
            return known, DEPTH_UNIT
    raise BadCamera(
        f"{path}: nothing says what its camera is; give --camera FILE, or put a {CAMERA} beside it"
    )


def _suffix(suffixes: tuple[str, ...]) -> Callable[[Path], bool]:
    return lambda path: path.is_file() and path.suffix.lower() in suffixes


FILES = (
    Format("FILE.bag|.db3|.mcap", "a ROS bag", _suffix(bags.SUFFIXES), bag_camera),
    Format("FOLDER", "a ROS 2 bag", lambda path: (path / bags.METADATA).is_file(), bag_camera),
    Format(
        *("FOLDER", f"a recording with {CAMERA}"),
        *(lambda path: (path / CAMERA).is_file(), folder_camera),
    ),
    Format("FILE.png|.npy|.tif", "a depth picture", _suffix(SUFFIXES), picture_camera),
)
"""What opens as a camera by its path; a new format is a function and a row here."""
