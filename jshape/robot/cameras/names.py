"""Cameras by what people write on the command line: `NAME`, `NAME:ADDRESS` or a path."""

from pathlib import Path

from jshape.data.intrinsics import within
from jshape.errors import JShapeError, did_you_mean
from jshape.io import bags
from jshape.io.recordings import CAMERA
from jshape.robot.cameras.base import AS_THEY_SAY, CameraSettings, DepthCamera
from jshape.robot.cameras.files import FILES, format_of, open_file
from jshape.robot.cameras.played import windowed
from jshape.robot.cameras.realsense import open_realsense
from jshape.robot.cameras.simulated import open_simulated
from jshape.robot.registry import DeviceKind, open_device, usage

CAMERAS: dict[str, DeviceKind[CameraSettings, DepthCamera]] = {
    "realsense": DeviceKind(
        open_realsense,
        "a connected RealSense, one of several, or what its SDK recorded",
        "[:SERIAL|:FILE.db3]",
    ),
    "sim": DeviceKind(open_simulated, "a simulated camera above a levelled bed", "[:SEED]"),
    "file": DeviceKind(open_file, "a file or folder, as below; its PATH alone will do", ":PATH"),
}
"""Every kind of camera; a new one is a file and a row here, a new file format a row in `FILES`."""


def names() -> list[tuple[str, str]]:
    """How each camera is named, and what it is: all that `open_camera` takes."""
    named = [(text, row.help) for text, row in zip(usage(CAMERAS), CAMERAS.values(), strict=True)]
    return [*named, *((one.example, one.help) for one in FILES)]


def open_camera(
    text: str,
    settings: CameraSettings = AS_THEY_SAY,
    window: tuple[int, int, int, int] | None = None,
) -> DepthCamera:
    """The camera that `NAME`, `NAME:ADDRESS` or the path of one of `FILES` names, started.

    `window` is the part of its frames to look at: (left, top, width, height), pixels.

    Raises:
      JShapeError: no such camera, a name of two, or as the camera itself says, in one line.
    """
    if settings.camera is not None:
        camera, unit = settings.camera
        settings = settings._replace(camera=(within(camera, settings.z_range), unit))
    here, name = format_of(text), text.partition(":")[0]
    if here is not None and name in CAMERAS:
        raise JShapeError(
            f"{text}: is a camera's name and {here.help} here; write ./{text} for what is here, or "
            f"{text}: for the camera"
        )
    if here is not None:
        opened = open_file(text, settings)
    elif name in CAMERAS:
        opened = open_device(text, CAMERAS, settings, "a camera")
    else:
        raise JShapeError(_no_camera(text))
    try:
        opened.camera = within(opened.camera, settings.z_range)
        return windowed(opened, *window) if window is not None else opened
    except BaseException:
        opened.close()
        raise


def _no_camera(text: str) -> str:
    path = Path(text)
    if path.is_dir():
        what = f"is a folder with neither {CAMERA} (a recording) nor {bags.METADATA} (a bag)"
    else:
        lacking = not path.exists() and (path.suffix or "/" in text)
        what = "no such file" if lacking else "is not a camera"
    allowed = ", ".join(dict.fromkeys(name for name, _ in names()))
    return f"{text}: {what}; allowed: {allowed}{did_you_mean(text.partition(':')[0], CAMERAS)}"
