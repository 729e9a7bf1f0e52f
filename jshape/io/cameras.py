"""camera.json: the fields of a Camera, and the metres that one count of its frames stands for."""

import itertools
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from jshape.camera import PRESETS, Camera, check_camera, check_pose
from jshape.data.depth import check_depth_unit, unit_that_fits
from jshape.data.missing import only_readings
from jshape.errors import BadCamera, JShapeError, did_you_mean
from jshape.height_map import Frame, as_frame
from jshape.io.files import read_json, write_json
from jshape.io.formats import SUFFIXES, read_array
from jshape.io.records import Numbers, Range, read_record

CAMERA = "camera.json"
"""What describes the camera of the frames beside it."""
DEPTH_UNIT = 0.001
"""Metres per count where no camera.json says it (a guessed camera, a ROS topic): millimetres."""

_OPTIONAL = ("orthographic", "lens", "pose")
_Pixels = Annotated[int, Range(1, 65_535)]
_MEANS = {
    "z_min": "; z_min and z_max are the depths between which the bed lies, metres",
    "u0": "; u0, v0 is the principal point (cx, cy), pixels",
}


@dataclass(frozen=True)
class CameraFile:
    """What a camera.json holds."""

    width: _Pixels
    height: _Pixels
    fx: float
    fy: float
    u0: float
    v0: float
    z_min: float
    z_max: float
    bits: _Pixels = 8
    orthographic: bool = False
    lens: Annotated[np.ndarray, Numbers((8,))] | None = None
    pose: Annotated[np.ndarray, Numbers((4, 4))] | None = None
    depth_unit: Annotated[float, Range(0, above=True)] | None = None
    bed: Annotated[np.ndarray, Numbers((4, 4))] | None = None


class Source(NamedTuple):
    """Where frames come from, as far as it was said or could be guessed."""

    camera: Camera
    depth_unit: float
    """Metres per count."""
    said: str
    """How we know, for people."""
    stated: bool
    """Somebody described the camera; False: a preset, or guessed."""


def read_camera(path: str | os.PathLike, depth_unit: float | None = None) -> tuple[Camera, float]:
    """A camera and its depth unit, metres per count: `depth_unit`, or else the file's own.

    Raises:
      BadFile: the file cannot be read or is not JSON.
      BadCamera: a field is missing, unknown or not a number in its range.  Without `depth_unit`
        the error names the one that would fit a frame beside the file.
    """
    content = read_json(path)
    camera, own = camera_from(content, str(path)), content.get("depth_unit")
    if own is None and depth_unit is None:
        raise BadCamera(
            f"{path}: depth_unit is missing: metres per count of the frames"
            f"{_unit_beside(Path(path), camera)}"
        )
    return camera, check_depth_unit(own if depth_unit is None else depth_unit, str(path))


def _unit_beside(path: Path, camera: Camera) -> str:
    """What a frame beside a camera's file, or one folder below, says of the unit."""
    near = itertools.chain(path.parent.glob("*.*"), path.parent.glob("*/*.*"))
    frames = (file for file in itertools.islice(near, 100) if file.suffix.lower() in SUFFIXES)
    for file in itertools.islice(frames, 3):
        try:
            counts = read_array(file)
        except JShapeError:
            continue
        if counts.dtype == np.uint16 and counts.shape == camera.shape:
            return unit_that_fits(only_readings(counts), camera)
    return ""


def write_camera(
    path: str | os.PathLike, camera: Camera, depth_unit: float, bed: Frame | None = None
) -> None:
    """Write camera.json, atomically; `depth_unit` is metres per count of the frames beside it.

    `bed` is where `jshape setup` found it: (4, 4) from its frame to the one of the camera's pose.

    Raises:
      BadCamera: the camera or the unit makes no sense.
      BadFile: the file cannot be written.
    """
    unit = check_depth_unit(depth_unit, str(path))
    place = {} if bed is None else {"bed": bed}
    write_json(path, camera_fields(camera) | {"depth_unit": unit} | place)


def read_bed(path: str | os.PathLike) -> Frame | None:
    """The bed's frame of a camera.json; None: it has none, or the path is a preset's name.

    Raises BadFile, BadCamera: as `read_camera`; a frame that is none.
    """
    found = read_json(path).get("bed") if Path(path).is_file() else None
    if found is not None:
        check_pose(found, str(path), "bed")
    return None if found is None else as_frame(found)


def camera_fields(camera: Camera) -> dict[str, Any]:
    """The fields of a camera as plain numbers; those that say nothing are left out.

    Raises BadCamera: they make no sense.
    """
    check_camera(camera)
    values = {one.name: getattr(camera, one.name) for one in fields(Camera)}
    whole = ("width", "height", "bits")
    found = {
        name: int(x) if name in whole else _shortest(x)
        for name, x in values.items()
        if name not in _OPTIONAL
    }
    return found | {
        name: values[name] if values[name] is True else np.asarray(values[name], float).tolist()
        for name in _OPTIONAL
        if values[name] not in (None, False)
    }


def camera_from(content: dict[str, Any], where: str) -> Camera:
    """The camera of a dict of fields; `where` names the file in errors.

    Raises BadCamera: a field is missing, unknown or not a number in its range.
    """
    try:
        found = dict(vars(read_record(CameraFile, content, where, error=BadCamera)))
    except BadCamera as problem:
        lacking = " missing " in str(problem)
        means = [text for name, text in _MEANS.items() if lacking and name not in content]
        if not lacking and {"cx", "cy"} & set(content):
            means = ["; did you mean u0, v0?"]
        raise BadCamera(f"{problem}{''.join(means)}") from None
    del found["depth_unit"], found["bed"]
    lens, pose = found["lens"], found["pose"]
    found["lens"] = None if lens is None else tuple(lens.tolist())
    found["pose"] = None if pose is None else tuple(map(tuple, pose.tolist()))
    return check_camera(Camera(**found), where)


def _shortest(value: Any) -> float:
    """A float32 as the shortest decimal that gives it back: 0.42, not 0.41999998688697815."""
    if isinstance(value, int | float):
        return float(value)
    array = np.asarray(value)
    return float(str(array[()])) if array.dtype == np.float32 else float(array)


def described(text: str, depth_unit: float | None = None) -> Source:
    """The camera that a camera.json or the name of a preset describes; `depth_unit` overrides it.

    Raises BadCamera: neither of them, or both.
    """
    if text in PRESETS:
        if Path(text).is_file():
            raise BadCamera(
                f"{text}: is a preset and a file here; write ./{text} for the file, or rename it "
                "for the preset"
            )
        return Source(PRESETS[text], depth_unit or DEPTH_UNIT, f"preset {text}", False)
    if not Path(text).exists():
        what = "no such file" if Path(text).suffix else "neither a camera.json nor a preset"
        near = did_you_mean(text, PRESETS)
        raise BadCamera(f"{text}: {what}; allowed: camera.json, {', '.join(PRESETS)}{near}")
    return Source(*read_camera(text, depth_unit), text, True)


def described_beside(path: Path, depth_unit: float | None = None) -> Source | None:
    """The camera that the camera.json in a recording's folder, or beside a frame, describes."""
    file = (path if path.is_dir() else path.parent) / CAMERA
    if not os.path.lexists(file):  # one that is no file is refused, not passed over
        return None
    return Source(*read_camera(file, depth_unit), str(file), True)
