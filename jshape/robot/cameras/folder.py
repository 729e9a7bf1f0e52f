"""Cameras over files: a recording's folder, and one depth picture."""

import itertools
import os
from pathlib import Path

import numpy as np

from jshape.camera import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.depth import to_metres, wrong_shape
from jshape.data.intrinsics import FLOAT_UNIT, check_numbers, counts_of, within
from jshape.errors import BadCamera, BadImage
from jshape.io.cameras import DEPTH_UNIT, read_camera
from jshape.io.formats import read_array
from jshape.io.recordings import CAMERA, open_recording
from jshape.robot.cameras.played import Played


def folder_camera(folder: str | os.PathLike) -> Played:
    """The frames of a recording: a folder with `camera.json` and numbered 16-bit frames.

    Numbers may be missing: what was dropped does not matter to who looks.

    Raises:
      BadDataset, BadCamera: as for `store.recordings.open_recording`.
    """
    found = open_recording(folder, allow_gaps=True)
    return Played(
        Path(folder).name or str(folder),
        found.camera,
        found.depth_unit,
        found.frames(),
        count=len(found),
    )


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
