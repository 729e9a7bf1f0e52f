"""Depth frames in ROS bags: ROS 1, ROS 2 (SQLite) and MCAP, and librealsense's bare .db3.

Frames are (H, W) uint16 counts, 0 = no reading.  Only images and their intrinsics are unpacked, by
the message definitions that rosbags brings: those in the bag are never turned into code.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import check_numbers, wrong_shape
from jshape.data.intrinsics import FLOAT_UNIT, Z_RANGE, counts_of, same_frames
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError, one_line
from jshape.io.bag_cameras import INFO, camera_of, stated
from jshape.io.bag_images import COMPRESSED, IMAGE, decode, encoding_of
from jshape.io.cameras import DEPTH_UNIT
from jshape.io.mcap_index import scan_where_no_index

SUFFIXES = (".bag", ".db3", ".mcap")
"""Bags that are one file; a folder with `METADATA` is one too."""
METADATA = "metadata.yaml"
"""What marks the folder of a ROS 2 bag."""

_SDK = "/device_0/"
_PACKED = ("/compressed", "/compressedDepth")
"""What image_transport puts behind a topic's name for the same frames, packed."""
_MENDERS = {".mcap": "mcap recover", ".bag": "rosbag reindex"}
"""Programs of others that mend what a killed recorder left."""
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
    _messages: "_Messages"

    @property
    def depth_unit(self) -> float:
        """Metres per count of `frames`."""
        return FLOAT_UNIT if self.metres else self.number_unit

    @property
    def count(self) -> int:
        """Frames, as the bag's index says."""
        return self._messages.count(self.topic)

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
                        f"{self.path}: CameraInfo on {_shown(str(self.info))} is another one from "
                        f"frame {number} on; --camera FILE says what holds for all"
                    )
                continue
            where = f"{self.path}: frame {number} of {_shown(self.topic)}"
            raw = _decoded(message, where)
            if (raw.dtype.kind == "f") != self.metres:
                raise BadImage(f"{where}: has another encoding than the first")
            if raw.shape != self.camera.shape:
                raise BadImage(wrong_shape(where, raw.shape, self.camera))
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
    messages = _Messages(path)
    try:
        topic = _choose(messages, topic)
        where = f"{path}: {_shown(topic)}"
        first = _decoded(messages.first(topic), where)
        metres, size = first.dtype.kind == "f", (first.shape[1], first.shape[0])
        info, sdk = None, _sdk_unit(messages, topic)
        if camera is not None:
            seen, unit = same_frames(camera[0], size, where), camera[1]
        else:
            info = _info_beside(messages, topic)
            said = f"{path}: CameraInfo on {_shown(info)}"
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


class _Messages:
    """The messages of an open bag, by topic; whatever rosbags raises becomes one line."""

    def __init__(self, path: Path):
        try:
            from rosbags import rosbag1, rosbag2
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise JShapeError(
                f"{path}: bags are read by rosbags: pip install 'jshape[ros]' (what a RealSense "
                f"recorded also plays as realsense:{path.name})"
            ) from None
        if not path.exists():
            raise BadFile(f"{path}: no such file")
        if path.is_dir() and not (path / METADATA).is_file():
            parts = any(file.suffix in SUFFIXES for file in path.iterdir())
            hint = "; ros2 bag reindex writes it" * parts
            raise BadFile(f"{path}: has no {METADATA}, so it is not a ROS 2 bag{hint}")
        old = path.suffix.lower() == ".bag" and path.is_file()
        if path.is_file() and path.suffix not in SUFFIXES and not old:
            raise BadFile(f"{path}: is not a bag; allowed: {', '.join(SUFFIXES)}, in small letters")
        self.path = path
        store = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
        self._unpack = store.deserialize_ros1 if old else store.deserialize_cdr
        self._open = False
        with self._readable():
            self._reader: Any = rosbag1.Reader(path) if old else rosbag2.Reader(path)
            self._reader.open()
            self._open = True
            scan_where_no_index(self._reader)
            # Several publishers of one topic are several connections.
            self.types = {c.topic: c.msgtype for c in self._reader.connections}

    def count(self, topic: str) -> int:
        return sum(c.msgcount for c in self._reader.connections if c.topic == topic)

    def of(self, *topics: str | None) -> Iterator[Any]:
        """The messages of some topics in the order of their time."""
        if not self._open:
            raise BadFile(f"{self.path}: the bag was closed")
        with self._readable():
            chosen = [c for c in self._reader.connections if c.topic in topics]
            messages = self._reader.messages(connections=chosen)
        last: dict[str, int] = {}
        while True:
            with self._readable():
                found = next(messages, None)
                if found is None:
                    return
                connection, time, raw = found
                if time < last.setdefault(connection.topic, time):
                    raise BadFile(
                        f"{self.path}: {_shown(connection.topic)} goes back in time: {METADATA} "
                        "lists the bag's files in another order; ros2 bag reindex mends it"
                    )
                last[connection.topic] = time
                message = self._unpack(raw, connection.msgtype)
            yield message

    def first(self, topic: str) -> Any:
        found = next(self.of(topic), None)
        if found is None:
            raise BadFile(f"{self.path}: {_shown(topic)}: has no messages")
        return found

    def close(self) -> None:
        if self._open:
            self._open = False
            with self._readable():
                self._reader.close()

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except JShapeError:
            raise
        except Exception as problem:  # rosbags, SQLite, LZ4, YAML: no common type
            reason = one_line(problem, 120) or type(problem).__name__
            mender = _MENDERS.get(self.path.suffix)
            hint = f"; {mender} may save what is whole of it" if mender else ""
            if self.path.is_file() and (self.path.parent / METADATA).is_file():
                hint = f"; it may be packed as a part of the bag {self.path.parent}"
            if self.path.suffix == ".bag" and any(t.startswith(_SDK) for t in self._topics()):
                hint = f"; it looks recorded by a RealSense: try realsense:{self.path.name}"
            what = "the bag is cut off or damaged"
            if "rofile is not ros2" in reason:
                what, hint = "the MCAP is not one of ROS 2", ""
            raise BadFile(f"{self.path}: cannot be read: {what} ({reason}){hint}") from None

    def _topics(self) -> list[str]:
        return list(getattr(self, "types", ()))


def _choose(messages: _Messages, topic: str | None) -> str:
    """The depth topic: the one that is named, or the only one."""
    if topic is not None:
        if topic not in messages.types:
            raise BadFile(
                f"{messages.path}: has no topic {_shown(topic)}; {_listed(messages.types)}"
            )
        if messages.types[topic] not in (IMAGE, COMPRESSED):
            kind = _shown(messages.types[topic])
            raise BadFile(f"{messages.path}: {_shown(topic)} is {kind}, not an image")
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
            f"{', '.join(_shown(d) for d in plain[:_LISTED])}; choose one with --topic"
        )
    raise BadFile(f"{messages.path}: has no depth topic; {_listed(messages.types)}")


def _shown(name: str) -> str:
    """A name out of a bag, which may hold anything, for an error of one line."""
    return one_line(name, 100)


def _listed(types: dict[str, str]) -> str:
    named = [_shown(f"{topic} ({kind.split('/')[-1]})") for topic, kind in sorted(types.items())]
    more = f" and {len(named) - _LISTED} more" if len(named) > _LISTED else ""
    return f"topics: {', '.join(named[:_LISTED]) or '(none)'}{more}"


def _info_beside(messages: _Messages, topic: str) -> str:
    """The topic of the CameraInfo beside a topic of frames."""
    base = _unpacked(topic).rpartition("/")[0]
    beside = f"{base}/camera_info"
    if messages.types.get(beside) == INFO and next(messages.of(beside), None) is not None:
        return beside
    others = [t for t, kind in messages.types.items() if kind == INFO]
    found = f"; there is {', '.join(_shown(t) for t in others[:3])}" if others else ""
    raise BadCamera(
        f"{messages.path}: has no CameraInfo on {_shown(beside)}{found}; "
        "say with --camera FILE what the camera is"
    )


def _unpacked(topic: str) -> str:
    return next((topic.removesuffix(end) for end in _PACKED if topic.endswith(end)), topic)


def _sdk_unit(messages: _Messages, topic: str) -> float | None:
    """Metres per count of librealsense's recordings: an option of the sensor, as text."""
    option = "/".join(topic.split("/")[:3]) + "/option/Depth_Units/value"
    if not topic.startswith(_SDK) or messages.types.get(option) != "std_msgs/msg/String":
        return None
    try:
        unit = float(messages.first(option).data)
    except ValueError:
        return None
    return unit if 0 < unit < 1 else None
