"""Arrays packed together: the NPZ of banks and plans, read without trust in what it says."""

import io
import zipfile

import numpy as np

from jshape.errors import BadFile, one_line
from jshape.io.formats import parse_npy

MEMBERS = 10_000
"""Most arrays in one NPZ."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_arrays(data: bytes, where: str, limit: int) -> dict[str, np.ndarray]:
    """The arrays of numbers in an NPZ, by name; nothing is unpickled.

    Raises:
      BadFile: it is damaged, unpacks to more bytes than `limit`, or holds something else than
        arrays of numbers.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            unpacked = sum(member.file_size for member in members)
            if len(members) > MEMBERS:
                raise BadFile(f"holds {len(members):,} arrays; at most {MEMBERS:,} are read")
            if unpacked <= limit:
                return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}
    except Exception as problem:  # zipfile promises no type for a damaged archive
        raise BadFile(f"{where}: not a readable NPZ: {one_line(problem)}") from None
    raise BadFile(f"{where}: unpacks to {unpacked:,} bytes; at most {limit:,} are read")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    name = one_line(member.filename, 60)
    if member.compress_type not in _METHODS:
        raise BadFile(f"{name} is packed in a way that NumPy does not use")
    with archive.open(member) as file:
        # With a size: a member that says less than it holds is not unpacked any further.
        return parse_npy(file.read(member.file_size), name)
