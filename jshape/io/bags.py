"""Depth frames in ROS bags: ROS 1, ROS 2 (SQLite) and MCAP, and librealsense's bare .db3.

Frames are (H, W) uint16 counts, 0 = no reading.  Only images and their intrinsics are unpacked, by
the message definitions that rosbags brings: those in the bag are never turned into code.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import check_numbers, check_shape
from jshape.data.intrinsics import FLOAT_UNIT, Z_RANGE, counts_of, same_frames
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError, one_line
from jshape.io.bag_cameras import INFO, camera_of, stated
from jshape.io.bag_images import COMPRESSED, IMAGE, decode, encoding_of
from jshape.io.bag_messages import METADATA as METADATA
from jshape.io.bag_messages import SUFFIXES as SUFFIXES
from jshape.io.bag_messages import Messages, shown
from jshape.io.cameras import DEPTH_UNIT

_PACKED = ("/compressed", "/compressedDepth")
"""What image_transport puts behind a topic's name for the same frames, packed."""
_SDK = "/device_0/"
"""What topics of librealsense's recordings start with."""
_LISTED = 8


@dataclass
class DepthBag:
    """An open bag, of which one topic's frames are read one at a time."""

    path: Path
    topic: str
    camera: Camera
    number_unit: float
    """Metres that 1 in a frame stands for."""
    stated: bool
    """Whether somebody said so, so that it is not to be doubted."""
    metres: bool
    """Frames are floating point."""
    info: str | None
    """The topic of the CameraInfo that `camera` was made of."""
    _messages: "Messages"

    @property
    def depth_unit(self) -> float:
        """Metres per count of `frames`."""
        return FLOAT_UNIT if self.metres else self.number_unit

    def frames(self) -> Iterator[np.ndarray]:
        """The frames (H, W) uint16 in the order of their time.

        Raises:
          BadFile: the bag is damaged from here on.
          BadImage: a frame has another size or encoding than the first, or its numbers make sense
            in another unit only.
          BadCamera: what the CameraInfo says changes here.
        """
        number, first, sure = 0, None, self.stated
        for message in self._messages.of(self.topic, self.info):
            if message.__msgtype__ == INFO:
                said = stated(message)
                first = said if first is None else first
                if not all(map(np.array_equal, said, first)):
                    raise BadCamera(
                        f"{self.path}: CameraInfo on {shown(str(self.info))} is another one from "
                        f"frame {number} on; --camera FILE says what holds for all"
                    )
                continue
            where = f"{self.path}: frame {number} of {shown(self.topic)}"
            raw = _decoded(message, where)
            if (raw.dtype.kind == "f") != self.metres:
                raise BadImage(f"{where}: has another encoding than the first")
            check_shape(raw, self.camera, where)
            sure = sure or check_numbers(raw, self.number_unit, self.camera, where)
            yield counts_of(raw * self.number_unit) if self.metres else raw
            number += 1

    def close(self) -> None:
        """Let go of the file; a second time does nothing."""
        self._messages.close()


def open_bag(
    path: str | os.PathLike,
    *,
    topic: str | None = None,
    camera: tuple[Camera, float] | None = None,
    z_range: tuple[float, float] = Z_RANGE,
    depth_unit: float | None = None,
) -> DepthBag:
    """Open a bag and find the depth frames in it.

    16UC1 is counts of 0.001 m, as ROS has it (or of the unit that librealsense states beside its
    frames, or of the camera given); 32FC1 is metres, and becomes counts of 0.0001 m.  Numbers that
    make sense in another unit only are refused, unless `depth_unit` says what they are.

    Args:
      path: a file, or the folder of a ROS 2 bag.
      topic: of the frames; None if there is only one depth topic.
      camera: intrinsics and metres per count instead of what the bag says.
      z_range: depths between which the bed lies, metres, where `camera` does not say.
      depth_unit: see above.

    Raises:
      JShapeError: rosbags is not installed.
      BadFile: no such bag, one that is damaged or cut off, no depth topic or several.
      BadCamera: no CameraInfo, or one that makes no sense or belongs to frames of another size.
      BadImage: the first frame is not a depth image, or not in this unit.
    """
    path = Path(path)
    messages = Messages(path)
    try:
        topic = _choose(messages, topic)
        where = f"{path}: {shown(topic)}"
        first = _decoded(messages.first(topic), where)
        metres, size = first.dtype.kind == "f", (first.shape[1], first.shape[0])
        info, sdk = None, _sdk_unit(messages, topic)
        if camera is not None:
            seen, unit = same_frames(camera[0], size, where), camera[1]
        else:
            info = _info_beside(messages, topic)
            said = f"{path}: CameraInfo on {shown(info)}"
            seen = camera_of(messages.first(info), topic, size, z_range, said)
            unit = sdk or DEPTH_UNIT
        unit = depth_unit or (1.0 if metres else unit)
        stated = depth_unit is not None or (unit == sdk and not metres)
        if not stated:
            check_numbers(first, unit, seen, where)
        return DepthBag(path, topic, seen, unit, stated, metres, info, messages)
    except BaseException:
        messages.close()
        raise


def _decoded(message: Any, where: str) -> np.ndarray:
    try:
        return decode(message, where)
    except JShapeError:
        raise
    except Exception as problem:  # fields of any content: a step of 0, a header cut off
        raise BadImage(f"{where}: not a depth image: {one_line(problem)}") from None


def _choose(messages: Messages, topic: str | None) -> str:
    """The depth topic: the one that is named, or the only one."""
    if topic is not None:
        if topic not in messages.types:
            raise BadFile(
                f"{messages.path}: has no topic {shown(topic)}; {_listed(messages.types)}"
            )
        if messages.types[topic] not in (IMAGE, COMPRESSED):
            kind = shown(messages.types[topic])
            raise BadFile(f"{messages.path}: {shown(topic)} is {kind}, not an image")
        return topic
    depths = []
    for name, kind in messages.types.items():
        message = next(messages.of(name), None) if kind in (IMAGE, COMPRESSED) else None
        if message is not None and encoding_of(message, name) is not None:
            depths.append(name)
    # The same frames twice: packed ones are left where they are there as they were, too.
    best: dict[str, str] = {}
    for name in sorted(depths, key=lambda d: [d.endswith(end) for end in _PACKED]):
        best.setdefault(_unpacked(name), name)
    plain = sorted(best.values())
    if len(plain) == 1:
        return plain[0]
    if plain:
        raise BadFile(
            f"{messages.path}: has {len(plain)} depth topics: "
            f"{', '.join(shown(d) for d in plain[:_LISTED])}; choose one with --topic"
        )
    raise BadFile(f"{messages.path}: has no depth topic; {_listed(messages.types)}")


def _listed(types: dict[str, str]) -> str:
    named = [shown(f"{topic} ({kind.split('/')[-1]})") for topic, kind in sorted(types.items())]
    more = f" and {len(named) - _LISTED} more" if len(named) > _LISTED else ""
    return f"topics: {', '.join(named[:_LISTED]) or '(none)'}{more}"


def _info_beside(messages: Messages, topic: str) -> str:
    """The topic of the CameraInfo beside a topic of frames."""
    base = _unpacked(topic).rpartition("/")[0]
    beside = f"{base}/camera_info"
    if messages.types.get(beside) == INFO and next(messages.of(beside), None) is not None:
        return beside
    others = [t for t, kind in messages.types.items() if kind == INFO]
    found = f"; there is {', '.join(shown(t) for t in others[:3])}" if others else ""
    raise BadCamera(
        f"{messages.path}: has no CameraInfo on {shown(beside)}{found}; "
        "say with --camera FILE what the camera is"
    )


def _unpacked(topic: str) -> str:
    return next((topic.removesuffix(end) for end in _PACKED if topic.endswith(end)), topic)


def _sdk_unit(messages: Messages, topic: str) -> float | None:
    """Metres per count of librealsense's recordings: an option of the sensor, as text."""
    option = "/".join(topic.split("/")[:3]) + "/option/Depth_Units/value"
    if not topic.startswith(_SDK) or messages.types.get(option) != "std_msgs/msg/String":
        return None
    try:
        unit = float(messages.first(option).data)
    except ValueError:
        return None
    return unit if 0 < unit < 1 else None
