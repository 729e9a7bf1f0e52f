"""The messages of a bag, by topic, as rosbags reads them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jshape.errors import BadFile, JShapeError, needs, one_line

SUFFIXES = (".bag", ".db3", ".mcap")
"""Bags that are one file; a folder with `METADATA` is one too."""
METADATA = "metadata.yaml"
"""What marks the folder of a ROS 2 bag."""
_HINTS = {
    ".bag": "; a RealSense's own plays as realsense:{}",
    ".mcap": "; `mcap recover` makes one that is whole, with its index",
}


class Messages:
    """The messages of an open bag, by topic; whatever rosbags raises becomes one line."""

    def __init__(self, path: Path):
        hint = f"a bag (a RealSense's own also plays as realsense:{path.name})"
        with needs("ros", f"{path}: {hint}"):
            from rosbags import rosbag1, rosbag2
            from rosbags.typesys import Stores, get_typestore
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
            # Several publishers of one topic are several connections.
            self.types = {c.topic: c.msgtype for c in self._reader.connections}

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
                        f"{self.path}: {shown(connection.topic)} goes back in time: {METADATA} "
                        "lists the bag's files in another order; ros2 bag reindex mends it"
                    )
                last[connection.topic] = time
                message = self._unpack(raw, connection.msgtype)
            yield message

    def first(self, topic: str) -> Any:
        """The first message of a topic; BadFile: it has none."""
        found = next(self.of(topic), None)
        if found is None:
            raise BadFile(f"{self.path}: {shown(topic)}: has no messages")
        return found

    def close(self) -> None:
        """Let go of the file; a second time does nothing."""
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
            hint = _HINTS.get(self.path.suffix, "").format(self.path.name)
            raise BadFile(
                f"{self.path}: cannot be read: the bag is cut off or damaged, or not one of ROS "
                f"({reason}){hint}"
            ) from None


def shown(name: str) -> str:
    """A name out of a bag, which may hold anything, for an error of one line."""
    return one_line(name, 100)
