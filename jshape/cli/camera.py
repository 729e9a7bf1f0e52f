"""`jshape camera list`; and what commands that look through a camera share."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from jshape.cli.options import CameraFile, Common, Part, Positive
from jshape.cli.tables import print_table
from jshape.errors import BadCamera, JShapeError
from jshape.io.cameras import read_camera
from jshape.robot.cameras import names
from jshape.robot.cameras.base import CameraSettings, DepthCamera
from jshape.robot.cameras.files import FILES
from jshape.robot.registry import usage

CAMERA_HELP = ", ".join([*usage(names.CAMERAS), *(format.help for format in FILES)])
"""All that opens as a camera."""
_WHICH = "which camera? name one, or set camera in jshape.toml"

camera = App(name="camera")


@camera.command(name="list")
def list_cameras(*, options: Common = Common()) -> dict[str, Any]:
    """The RealSense cameras that are connected, and what else opens."""
    from jshape.robot.cameras.realsense import devices

    found = devices()
    if found:
        print_table(("camera", "name"), [(f"realsense:{d.serial}", d.name) for d in found])
    else:
        print("no RealSense camera is connected")
    print("\nwhat opens as a camera:")
    print_table(("name", "what it is"), names.names())
    return {"devices": [{"name": d.name, "serial": d.serial} for d in found]}


if TYPE_CHECKING:
    Camera = str
else:
    Camera = Annotated[Literal[tuple(names.CAMERAS)] | str, Parameter(metavar="CAMERA")]


@dataclass(frozen=True, kw_only=True)
class Looks(Part):
    """How to look through a camera."""

    camera_file: Annotated[Path | None, CameraFile] = None
    """camera.json to use instead of what the camera says of itself."""
    topic: str | None = None
    """Topic of a bag's depth frames (default: the only one)."""
    temporal: Annotated[bool, Parameter(negative="--no-temporal")] = False
    """Temporal filter of a RealSense's SDK."""
    fill_holes: bool = False
    """Hole filling of a RealSense's SDK."""


@dataclass(frozen=True, kw_only=True)
class LooksOnce(Looks):
    """How to look through the one camera that a command is about."""

    depth_unit: Annotated[Positive | None, Parameter(metavar="METRES")] = None
    """Metres per count of a bag's or picture's frames (default: as it says)."""


def every(
    names: Sequence[str], options: Any, depth_unit: float | None = None
) -> Iterator[DepthCamera]:
    """Cameras by their names, each started when asked for; the window is of the first's frames."""
    files = options.camera_file or []
    if not names:
        raise JShapeError(_WHICH)
    if files and len(files) != len(names):
        raise BadCamera(
            f"{len(names)} cameras and {len(files)} camera files; give one --camera-file for each "
            "camera, in their order"
        )
    for k, (name, file) in enumerate(zip(names, files or [None] * len(names), strict=True)):
        yield looking(name, options, file, depth_unit, None if k else options.window)


def opened(camera: str | None, options: LooksOnce) -> DepthCamera:
    """The camera that a command is about, started."""
    if camera is None:
        raise JShapeError(_WHICH)
    return looking(camera, options, options.camera_file, options.depth_unit, options.window)


def looking(
    name: str,
    options: Looks,
    camera_file: Path | None,
    depth_unit: float | None = None,
    window: tuple[int, int, int, int] | None = None,
) -> DepthCamera:
    """A camera by its name, started, and looked through as the options say."""
    if Path(name).suffix.lower() == ".json" and Path(name).is_file():
        raise JShapeError(
            f"{name}: describes a camera and is none: --camera-file takes it; a camera is "
            f"{CAMERA_HELP}"
        )
    settings = CameraSettings(
        None if camera_file is None else read_camera(camera_file, depth_unit),
        options.topic,
        options.depth_range,
        options.temporal,
        options.fill_holes,
        depth_unit,
    )
    return names.open_camera(name, settings, window)
