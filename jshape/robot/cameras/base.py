"""What a depth camera is, and how a look is made of its frames."""

from collections import Counter
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jshape._typing import Float, Num
from jshape.camera import Camera
from jshape.data.depth import check_unit
from jshape.data.missing import only_readings
from jshape.errors import BadCamera, JShapeError

FRAMES = 15
"""Frames of a look: half a second of a D435."""
TIMEOUT = 5.0
"""Seconds after which a camera that sends nothing is silent."""


class CameraLost(JShapeError):
    """A camera that is not there, or sends nothing any more, or the same frame over and over."""


class EndOfFrames(CameraLost):
    """A recording that is at its end."""


@runtime_checkable
class DepthCamera(Protocol):
    """A source of depth frames, started; `contextlib.closing` closes it at the end of a block.

    It may have the attributes of `CameraTraits` too.
    """

    name: str
    """What people call it: model and serial number, or the file's name."""
    camera: Camera
    """Of the frames: size and intrinsics as the device says."""
    depth_unit: float
    """Metres per count, as the device says."""

    def frame(self) -> Num[np.ndarray, "H W"]:
        """The next frame: counts of `depth_unit`, 0 = no reading.

        Raises:
          CameraLost: nothing came within `TIMEOUT`.
          EndOfFrames: a recording has no more.
        """
        ...

    def close(self) -> None:
        """Let go of the device; a second time does nothing."""
        ...


class CameraSettings(NamedTuple):
    """What people say of a camera beside its name; each kind takes what concerns it."""

    camera: tuple[Camera, float] | None = None
    """Intrinsics and metres per count to believe instead of what the camera says."""
    topic: str | None = None
    """Of a bag's depth frames."""
    z_range: tuple[float, float] | None = None
    """Depths between which the bed lies, metres."""
    temporal: bool = True
    """The RealSense SDK's temporal filter."""
    holes: bool = False
    """The RealSense SDK's hole filling."""
    depth_unit: float | None = None
    """Metres that 1 in the frames stands for."""

    def check_own(self, name: str, unit_only: bool = False) -> None:
        """BadCamera if intrinsics or a unit were given for a camera that says its own."""
        if self.camera is not None and not unit_only:
            raise BadCamera(
                f"{name}: has a camera of its own; --camera-file is for devices, bags, pictures"
            )
        if self.depth_unit is not None:
            raise BadCamera(f"{name}: says its unit itself; --depth-unit is for bags and pictures")


AS_THEY_SAY = CameraSettings()
"""Nothing beside the name."""


def next_frame(camera: DepthCamera, left_out: Counter[str] | None = None) -> np.ndarray:
    """The next frame (H, W) of counts, 0 where there is no reading; why is added to `left_out`.

    Whatever a device or a driver of somebody's own writes for "no reading" ends here.

    Raises:
      CameraLost, EndOfFrames: as `DepthCamera.frame`.
    """
    return only_readings(camera.frame(), left_out)


def look(camera: DepthCamera, frames: int = FRAMES) -> Float[np.ndarray, "H W"]:
    """Depth in metres: of each pixel the median of its readings over some frames.

    A pixel counts where at least half of the frames have a reading; elsewhere it is 0.

    Args:
      camera: to look with.
      frames: how many frames, from 1.

    Raises:
      CameraLost: nothing came, or all frames but the first are copies of it: a frozen stream.
      BadImage: another unit would bring the depths into the camera's range.
    """
    stack = np.stack([next_frame(camera) for _ in range(frames)])
    if frames > 2 and stack[0].any() and (stack == stack[0]).all() and not traits_of(camera).still:
        raise CameraLost(f"{camera.name}: {frames} frames are the same to the bit: a frozen stream")
    seen = (stack > 0).sum(0)
    # Sorted, the readings stand behind the zeros: four times as fast as a masked median.
    stack.sort(axis=0)
    first = frames - seen
    middle = sum(
        np.take_along_axis(stack, np.minimum(first + half, frames - 1)[None], 0)[0].astype(float)
        for half in ((seen - 1).clip(0) // 2, seen // 2)
    )
    enough = 2 * seen >= frames
    depth = (np.where(enough, middle / 2, 0.0) * camera.depth_unit).astype(np.float32)
    return check_unit(depth, camera.camera, camera.name, camera.depth_unit)


class CameraTraits(NamedTuple):
    """What a camera may say of itself besides, as attributes of these names; else the defaults."""

    live: bool = False
    """Its frames are of now, not of a recording."""
    still: bool = False
    """The same frame again is no fault: a picture, a simulation without noise."""
    whole: Camera | None = None
    """The camera whose frames it cuts its own out of."""


def traits_of(camera: object) -> CameraTraits:
    """What a camera says of itself."""
    return CameraTraits(*(getattr(camera, *one) for one in CameraTraits._field_defaults.items()))
