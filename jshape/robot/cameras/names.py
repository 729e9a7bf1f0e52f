"""Cameras by what people write on the command line: one table."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax

from jshape.camera import Camera
from jshape.data.intrinsics import Z_RANGE, same_frames, within
from jshape.errors import BadCamera, JShapeError, did_you_mean, one_line
from jshape.io import bags
from jshape.io.cameras import read_camera
from jshape.io.recordings import CAMERA
from jshape.robot.cameras.bag import bag_camera
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.cameras.folder import folder_camera, picture_camera
from jshape.robot.cameras.realsense import SUFFIXES, RealSense
from jshape.robot.cameras.simulated import levelled_world, simulated_camera
from jshape.robot.cameras.window import Window

PICTURES = (".png", ".npy", ".tif", ".tiff", ".exr")


class Settings(NamedTuple):
    """What a camera is opened with; each kind takes what concerns it."""

    camera: tuple[Camera, float] | None = None
    topic: str | None = None
    z_range: tuple[float, float] | None = None
    temporal: bool = True
    holes: bool = False
    depth_unit: float | None = None


class Kind(NamedTuple):
    """A kind of camera, and how its name looks."""

    example: str
    what: str
    fits: Callable[[str], bool]
    open: Callable[[str, Settings], DepthCamera]


def open_camera(
    text: str,
    *,
    camera: str | Path | None = None,
    topic: str | None = None,
    z_range: tuple[float, float] | None = None,
    window: tuple[int, int, int, int] | None = None,
    temporal: bool = True,
    holes: bool = False,
    depth_unit: float | None = None,
) -> DepthCamera:
    """The camera that a text names, started.

    Args:
      text: as the examples of `KINDS`.
      camera: a camera.json to believe instead of what the device, bag or picture says.
      topic: of a bag's depth frames.
      z_range: depths between which the bed lies, metres; None: the camera's own, or the paper's.
      window: (left, top, width, height) in pixels: the part of the frames to look at.
      temporal: the SDK's temporal filter (RealSense only).
      holes: the SDK's hole filling (RealSense only).
      depth_unit: metres that 1 in the frames of a bag or picture stands for.

    Raises:
      JShapeError: no such kind of camera, a name of two, or as the camera itself says, in one line.
    """
    if camera is not None and not Path(camera).is_file():
        raise BadCamera(f"{camera}: no such file; a {CAMERA} is expected")
    given = None if camera is None else read_camera(camera, depth_unit)
    if given is not None:
        given = within(given[0], z_range), given[1]
    kinds = [kind for kind in KINDS if kind.fits(text)]
    kind = next(iter(kinds), None)
    if kind is not None and kind.open in (_realsense, _sim) and kinds[-1].open is not kind.open:
        raise JShapeError(
            f"{text}: is a camera's name and {kinds[-1].what} here; write ./{text} for what is "
            f"here, or {text}: for the camera"
        )
    if kind is None:
        path = Path(text)
        if path.is_dir():
            what = f"is a folder with neither {CAMERA} (a recording) nor {bags.METADATA} (a bag)"
        else:
            known = path.suffix.lower() in (*bags.SUFFIXES, *PICTURES)
            what = "no such file" if known or "/" in text else "is not a camera"
        allowed = ", ".join(kind.example for kind in KINDS)
        near = did_you_mean(text.partition(":")[0], ("realsense", "sim"))
        raise JShapeError(f"{text}: {what}; allowed: {allowed}{near}")
    opened = kind.open(text, Settings(given, topic, z_range, temporal, holes, depth_unit))
    try:
        opened.camera = within(opened.camera, z_range)
        return Window(opened, *window) if window is not None else opened
    except BaseException:
        opened.close()
        raise


def _realsense(text: str, settings: Settings) -> DepthCamera:
    _refuse_unit(text, settings)
    rest = text.partition(":")[2]
    file = rest if Path(rest).suffix.lower() in SUFFIXES else None
    serial = rest if rest and file is None else None
    opened = RealSense(serial, file=file, temporal=settings.temporal, holes=settings.holes)
    if settings.camera is not None:  # its unit is the device's all the same
        size = (opened.camera.width, opened.camera.height)
        try:
            opened.camera = same_frames(settings.camera[0], size, opened.name)
        except BaseException:
            opened.close()
            raise
    return opened


def _sim(text: str, settings: Settings) -> DepthCamera:
    _refuse(text, settings)
    seed = seed_of(text)
    key = jax.random.fold_in(jax.random.key(seed), 1)
    return simulated_camera(levelled_world(seed), key)


def seed_of(text: str) -> int:
    """The number behind the colon of a name such as "sim:7"; 0 without one.

    Raises:
      JShapeError: it is no seed.
    """
    number = text.partition(":")[2] or "0"
    if not (number.isascii() and number.isdecimal()) or len(number) > 10 or int(number) >= 2**32:
        raise JShapeError(
            f"{one_line(text, 80)}: a seed is a whole number from 0 to {2**32 - 1}, as in sim:7"
        )
    return int(number)


def _bag(text: str, settings: Settings) -> DepthCamera:
    return bag_camera(
        text,
        topic=settings.topic,
        camera=settings.camera,
        z_range=settings.z_range or Z_RANGE,
        depth_unit=settings.depth_unit,
    )


def _folder(text: str, settings: Settings) -> DepthCamera:
    _refuse(text, settings)
    return folder_camera(text)


def _picture(text: str, settings: Settings) -> DepthCamera:
    return picture_camera(
        text, camera=settings.camera, z_range=settings.z_range, depth_unit=settings.depth_unit
    )


def _refuse(text: str, settings: Settings) -> None:
    if settings.camera is not None:
        raise BadCamera(f"{text}: has a camera of its own; --camera is for devices, bags, pictures")
    _refuse_unit(text, settings)


def _refuse_unit(text: str, settings: Settings) -> None:
    if settings.depth_unit is not None:
        raise BadCamera(f"{text}: says its unit itself; --depth-unit is for bags and pictures")


def _named(name: str) -> Callable[[str], bool]:
    return lambda text: text.partition(":")[0] == name


def _file(suffixes: tuple[str, ...]) -> Callable[[str], bool]:
    return lambda text: Path(text).is_file() and Path(text).suffix.lower() in suffixes


def _holds(name: str) -> Callable[[str], bool]:
    return lambda text: (Path(text) / name).is_file()


KINDS = (
    Kind("realsense", "the RealSense that is connected", _named("realsense"), _realsense),
    Kind("realsense:SERIAL", "that one of several", _named("realsense"), _realsense),
    Kind("realsense:FILE.db3", "what the SDK recorded", _named("realsense"), _realsense),
    Kind("sim", "a simulated camera above a levelled bed", _named("sim"), _sim),
    Kind("sim:SEED", "another bed", _named("sim"), _sim),
    Kind("FILE.bag|.db3|.mcap", "a ROS bag", _file(bags.SUFFIXES), _bag),
    Kind("FOLDER", "a ROS 2 bag", _holds(bags.METADATA), _bag),
    Kind("FOLDER", f"a recording with {CAMERA}", _holds(CAMERA), _folder),
    Kind("FILE.png|.npy|.tif|.exr", "a depth picture", _file(PICTURES), _picture),
)
"""Every kind of camera; a new one is a file and a row here."""
