"""Cameras over files: a ROS bag, a recording's folder, one depth picture."""

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.depth import check_numbers, to_metres, wrong_shape
from jshape.data.intrinsics import FLOAT_UNIT, Z_RANGE, counts_of, within
from jshape.errors import BadCamera, BadImage, JShapeError, one_line
from jshape.io import bags
from jshape.io.cameras import DEPTH_UNIT, read_camera
from jshape.io.formats import read_array
from jshape.io.recordings import CAMERA, open_recording
from jshape.robot.cameras.base import CameraSettings
from jshape.robot.cameras.played import Played

PICTURES = (".png", ".npy", ".tif", ".tiff", ".exr")


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
    """The camera over what is at a path.

    Raises:
      JShapeError: nothing that opens as a camera, or damaged.
    """
    found = format_of(path)
    if found is None:
        raise JShapeError(f"{path}: is none of {', '.join(one.help for one in FILES)}")
    return found.open(Path(path), settings)


def bag_camera(
    path: str | os.PathLike,
    *,
    topic: str | None = None,
    camera: tuple[Camera, float] | None = None,
    z_range: tuple[float, float] = Z_RANGE,
    depth_unit: float | None = None,
) -> Played:
    """The depth frames of a ROS 1, ROS 2 or MCAP bag, as fast as they are asked for.

    Args:
      path: a file, or the folder of a ROS 2 bag.
      topic: of the frames; None if there is only one depth topic.
      camera: intrinsics and metres per count instead of the bag's own.
      z_range: depths between which the bed lies, metres, where `camera` does not say.
      depth_unit: metres that 1 in the frames stands for, whatever else says it.

    Raises:
      JShapeError: as for `jshape.io.bags.open_bag`.
    """
    bag = bags.open_bag(path, topic=topic, camera=camera, z_range=z_range, depth_unit=depth_unit)
    name = one_line(f"{bag.path.name} {bag.topic}", 120)
    count = bag.count or None
    return Played(name, bag.camera, bag.depth_unit, bag.frames(), count=count, close=bag.close)


def folder_camera(folder: str | os.PathLike) -> Played:
    """The frames of a recording: a folder with `camera.json` and numbered 16-bit frames.

    Numbers may be missing: what was dropped does not matter to who looks.

    Raises:
      BadDataset, BadCamera: as for `jshape.io.recordings.open_recording`.
    """
    found = open_recording(folder, allow_gaps=True)
    name = Path(folder).name or str(folder)
    return Played(name, found.camera, found.depth_unit, found.frames(), count=len(found))


def picture_camera(
    path: str | os.PathLike,
    *,
    camera: tuple[Camera, float] | None = None,
    z_range: tuple[float, float] | None = None,
    depth_unit: float | None = None,
) -> Played:
    """One depth picture, again and again: 16-bit PNG or TIFF (counts), NPY or EXR (metres).

    Args:
      path: the picture.
      camera: whose it is, and metres per count; None: what `camera.json` beside it says, else the
        paper's camera if the size is its.
      z_range: depths between which the bed lies, metres; None: as its camera has it.
      depth_unit: metres that 1 in the picture stands for, whatever else says it.

    Raises:
      BadFile, BadImage: it cannot be read, is no depth picture, has another size, or numbers that
        make sense in another unit only.
      BadCamera: nothing says whose it is.
    """
    path = Path(path)
    raw = read_array(path)
    if raw.dtype == np.uint8:
        raise BadImage(f"{path}: holds luminance (8 bits); a camera's frames are 16-bit or metres")
    if camera is None:
        camera = _beside(path, raw.shape, depth_unit)
    made_by, unit = within(camera[0], z_range), camera[1]
    if raw.shape != made_by.shape:
        raise BadImage(wrong_shape(str(path), raw.shape, made_by))
    whole = raw.dtype == np.uint16
    unit = depth_unit or (unit if whole else 1.0)
    if depth_unit is None:
        check_numbers(raw, unit, made_by, str(path))
    if whole:
        counts = np.ma.filled(raw, 0)
    else:
        counts, unit = counts_of(to_metres(raw, unit, str(path)) * unit), FLOAT_UNIT
    again = (counts.copy() for _ in itertools.repeat(None))
    return Played(path.name, made_by, unit, again, still=True)


def _beside(path: Path, shape: tuple[int, ...], depth_unit: float | None) -> tuple[Camera, float]:
    if os.path.lexists(path.parent / CAMERA):
        return read_camera(path.parent / CAMERA, depth_unit)
    for known in (PAPER_BOX, D435_BAZAR):
        if known.shape == shape:
            return known, DEPTH_UNIT
    raise BadCamera(
        f"{path}: nothing says what its camera is; give --camera FILE, or put a {CAMERA} beside it"
    )


def _bag(path: Path, given: CameraSettings) -> Played:
    z_range = given.z_range or Z_RANGE
    return bag_camera(
        path,
        topic=given.topic,
        camera=given.camera,
        z_range=z_range,
        depth_unit=given.depth_unit,
    )


def _folder(path: Path, given: CameraSettings) -> Played:
    given.check_own(str(path))
    return folder_camera(path)


def _picture(path: Path, given: CameraSettings) -> Played:
    return picture_camera(
        path, camera=given.camera, z_range=given.z_range, depth_unit=given.depth_unit
    )


def _suffix(suffixes: tuple[str, ...]) -> Callable[[Path], bool]:
    return lambda path: path.is_file() and path.suffix.lower() in suffixes


FILES = (
    Format("FILE.bag|.db3|.mcap", "a ROS bag", _suffix(bags.SUFFIXES), _bag),
    Format("FOLDER", "a ROS 2 bag", lambda path: (path / bags.METADATA).is_file(), _bag),
    Format("FOLDER", f"a recording with {CAMERA}", lambda path: (path / CAMERA).is_file(), _folder),
    Format("FILE.png|.npy|.tif|.exr", "a depth picture", _suffix(PICTURES), _picture),
)
"""What opens as a camera by its path; a new format is a function and a row here."""
