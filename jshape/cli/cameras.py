"""What commands that look through a camera share: its options, and opening it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from jshape.cli.options import CameraFile, Part, Positive
from jshape.errors import JShapeError
from jshape.robot.cameras import names
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.cameras.files import FILES
from jshape.robot.registry import usage

CAMERA_HELP = ", ".join([*usage(names.CAMERAS), *(format.help for format in FILES)])
"""All that opens as a camera."""


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


def opened(camera: str | None, options: LooksOnce) -> DepthCamera:
    """The camera that a command is about, started."""
    if camera is None:
        raise JShapeError("which camera? name one, or set camera in jshape.toml")
    return looking(camera, options, options.camera_file, options.depth_unit, options.window)


def looking(
    name: str,
    options: Looks,
    camera_file: Path | None,
    depth_unit: float | None = None,
    window: tuple[int, int, int, int] | None = None,
) -> DepthCamera:
    """A camera by its name, started, and looked through as the options say.

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
        window=window,
        temporal=options.temporal,
        holes=options.fill_holes,
        depth_unit=depth_unit,
    )
