"""camera.json: the fields of a Camera, and the metres that one count of its frames stands for."""

import itertools
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import PRESETS, Camera, check_camera
from jshape.data.depth import unit_that_fits
from jshape.data.missing import only_readings
from jshape.errors import BadCamera, JShapeError, did_you_mean, quoted
from jshape.io.files import read_json, write_json
from jshape.io.formats import COUNTS, read_array

CAMERA = "camera.json"
"""What describes the camera of the frames beside it."""
DEPTH_UNIT = 0.001
"""Metres per count where no camera.json says it (a guessed camera, a ROS topic): millimetres."""

REQUIRED = ("width", "height", "fx", "fy", "u0", "v0", "z_min", "z_max")
OPTIONAL = ("bits",)
_WHOLE = ("width", "height", "bits")
_MOST = 65_535


def read_camera(path: str | os.PathLike, depth_unit: float | None = None) -> tuple[Camera, float]:
    """A camera and its depth unit, metres per count.

    Args:
      path: the file.
      depth_unit: instead of the file's own, which then need not say it.

    Raises:
      BadFile: the file cannot be read or is not JSON.
      BadCamera: a field is missing, unknown or not a number in its range.  Without `depth_unit`
        the error names the one that would fit the frames beside the file.
    """
    fields = read_json(path)
    own = fields.pop("depth_unit", depth_unit)
    camera = camera_from(fields, str(path))
    if own is None:
        raise BadCamera(
            f"{path}: depth_unit is missing: metres per count of 16-bit frames"
            f"{_unit_beside(Path(path), camera)}"
        )
    own = check_depth_unit(own, str(path))
    return camera, own if depth_unit is None else check_depth_unit(depth_unit, str(path))


def _unit_beside(path: Path, camera: Camera) -> str:
    """What the first frames of the camera's size beside its file, or one folder below, say."""
    try:
        found = itertools.chain(path.parent.glob("*.*"), path.parent.glob("*/*.*"))
        near = sorted(itertools.islice(found, 100))
    except OSError:
        return ""
    frames = (file for file in near if file.suffix.lower() in COUNTS)
    for file in itertools.islice(frames, 3):
        try:
            counts = read_array(file)
        except JShapeError:
            continue
        if counts.dtype == np.uint16 and counts.shape == camera.shape:
            return unit_that_fits(only_readings(counts), camera)
    return ""


def write_camera(path: str | os.PathLike, camera: Camera, depth_unit: float) -> None:
    """Write camera.json, atomically.

    Args:
      path: the file.
      camera: whose fields.
      depth_unit: metres per count of the frames that belong to it.

    Raises:
      BadCamera: the camera or the unit makes no sense.
      BadFile: the file cannot be written.
    """
    fields = camera_fields(camera)
    fields["depth_unit"] = check_depth_unit(depth_unit, str(path))
    write_json(path, fields)


def camera_fields(camera: Camera) -> dict[str, int | float]:
    """The fields of a camera as plain numbers.

    Raises:
      BadCamera: they make no sense.
    """
    check_camera(camera)
    return {
        name: int(getattr(camera, name)) if name in _WHOLE else _shortest(getattr(camera, name))
        for name in REQUIRED + OPTIONAL
    }


def camera_from(fields: dict[str, Any], where: str) -> Camera:
    """The camera of a dict of fields; `where` names the file in errors.

    Raises:
      BadCamera: a field is missing, unknown or not a number in its range.
    """
    missing = [name for name in REQUIRED if name not in fields]
    if missing:
        means = {"z_min": "; z_min and z_max are the depths between which the bed lies, metres",
                 "u0": "; u0, v0 is the principal point (cx, cy), pixels"}  # fmt: skip
        said = "".join(text for name, text in means.items() if name in missing)
        raise BadCamera(f"{where}: missing {', '.join(missing)}{said}")
    unknown = [name for name in fields if name not in REQUIRED + OPTIONAL]
    if unknown:
        raise BadCamera(
            f"{where}: unknown {', '.join(map(repr, unknown))}; "
            f"allowed: {', '.join(REQUIRED + OPTIONAL)}, depth_unit"
        )
    for name, value in fields.items():
        if name in _WHOLE:
            if type(value) is not int or not 0 < value <= _MOST:
                raise BadCamera(
                    f"{where}: {name} is {quoted(value)}; "
                    f"it must be a positive whole number, at most {_MOST:,}"
                )
        elif not _is_number(value):
            raise BadCamera(f"{where}: {name} is {quoted(value)}; it must be a finite number")
    numbers: dict[str, Any] = {n: v if n in _WHOLE else float(v) for n, v in fields.items()}
    return check_camera(Camera(**numbers), where)


def check_depth_unit(value: Any, where: str) -> float:
    """The depth unit (metres per count) itself, if it is a positive number.

    Raises:
      BadCamera: it is not.
    """
    number = value.item() if isinstance(value, np.number) else value
    if not _is_number(number) or number <= 0:
        raise BadCamera(
            f"{where}: depth_unit is {quoted(value)}; "
            "it must be a positive number (metres per count)"
        )
    return float(number)


def _is_number(value: Any) -> bool:
    # Not "433", which float() takes, nor an integer that no float can hold.
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) if isinstance(value, float) else abs(value) < 1e300


def _shortest(value: Any) -> float:
    """A float32 as the shortest decimal that gives it back: 0.42, not 0.41999998688697815."""
    if isinstance(value, int | float):
        return float(value)
    array = np.asarray(value)
    return float(str(array[()])) if array.dtype == np.float32 else float(array)


def described(text: str, depth_unit: float | None = None) -> tuple[Camera, float, bool]:
    """The camera that a camera.json or the name of a preset describes; `depth_unit` overrides it.

    Returns:
      The camera, metres per count, and whether somebody described it (False: a preset).

    Raises:
      BadCamera: neither of them, or both.
    """
    if text in PRESETS:
        if Path(text).is_file():
            raise BadCamera(
                f"{text}: is a preset and a file here; write ./{text} for the file, or rename it "
                "for the preset"
            )
        return PRESETS[text], depth_unit or DEPTH_UNIT, False
    if not Path(text).exists():
        raise BadCamera(
            f"{text}: neither a camera.json nor a preset ({', '.join(PRESETS)}) that describes a "
            f"camera{did_you_mean(text, PRESETS)}"
        )
    return *read_camera(text, depth_unit), True
