"""The index that an MCAP's summary should hold, made from the file itself where it does not.

rosbags believes a summary that has chunks: without their channels it finds no topics, without the
places of messages none of them, and without chunks it refuses topics that were not written in turn.
"""

import struct
from typing import Any

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_OF_CHUNK, _DATA_END = 0x06, 0x0F
_NO_TYPE = "__schemaless__"


def scan_where_no_index(reader: Any) -> None:
    """Let an open reader of rosbags find all that is in its MCAP files, read from end to end.

    Raises:
      Exception: of any type, where a file is damaged.
    """
    storage = getattr(reader, "storage", None)
    for part in getattr(storage, "storages", [storage]):
        if hasattr(part, "meta_scan") and not _indexed(part):
            part.chunks.clear()
            part.connections.clear()
            part.meta_scan()
            counts = part.statistics.channel_message_counts
            part.connections[:] = [c._replace(msgcount=counts[c.id]) for c in part.connections]
            part.chunks[:] = _chunks(part, counts)


def _indexed(part: Any) -> bool:
    counts = part.statistics.channel_message_counts
    known = {c.id for c in part.connections if c.msgtype != _NO_TYPE}
    return bool(
        known
        and known >= counts.keys()
        and sum(counts.values()) == part.statistics.message_count
        and part.chunks
        and all(chunk.channel_count for chunk in part.chunks)
    )


def _chunks(part: Any, counts: dict[int, int]) -> list[Any]:
    from rosbags.rosbag2.storage_mcap import ChunkInfo

    found, at, file = [], part.data_start, part.bio
    while at < part.data_end:
        file.seek(at)
        kind, size = _HEAD.unpack(file.read(_HEAD.size))
        if kind == _DATA_END:
            break
        if kind == _OF_CHUNK:
            first, last, whole, _, name = _CHUNK.unpack(file.read(_CHUNK.size))
            how = file.read(name).decode()
            (packed,) = struct.unpack("<Q", file.read(8))
            length = _HEAD.size + size
            found.append(ChunkInfo(first, last, at, length, {}, 0, how, packed, whole, counts))
        at += _HEAD.size + size
    return found
