"""NPY, and NPZ of banks, maps and plans: arrays that are read without trust in what a file says."""

import io
import warnings
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from jshape.errors import BadFile, BadImage, one_line


def npz_bytes(arrays: Mapping[str, Any]) -> bytes:
    """The content of an NPZ with these arrays."""
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def read_arrays(data: bytes, where: str, limit: int) -> dict[str, np.ndarray]:
    """The arrays of numbers in an NPZ, by name; nothing is unpickled.

    Raises BadFile: it is damaged, unpacks to more bytes than `limit`, or holds something else than
    arrays of numbers.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            unpacked = sum(member.file_size for member in members)
            if unpacked <= limit:
                return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}
    except Exception as problem:  # zipfile promises no type for a damaged archive
        raise BadFile(f"{where}: not a readable NPZ: {one_line(problem)}") from None
    raise BadFile(f"{where}: unpacks to {unpacked:,} bytes; at most {limit:,} are read")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as file:
        # With a size: a member that says less than it holds is not unpacked any further.
        return parse_npy(file.read(member.file_size), one_line(member.filename, 60))


def parse_npy(data: bytes, where: str) -> np.ndarray:
    """The array of an NPY's bytes; nothing is unpickled.

    Raises BadImage: not a whole NPY, or one that does not hold numbers.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            found = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except Exception as problem:  # NumPy promises no type here: a header is parsed as Python
        raise BadImage(f"{where}: not a readable NPY: {one_line(problem)}") from None
    if found.dtype.kind not in "fiub":
        raise BadImage(
            f"{where}: the NPY holds {found.dtype}; expected float (metres) or uint16 (counts)"
        )
    if found.size == 0:
        raise BadImage(f"{where}: the image is empty (shape {found.shape})")
    return found.astype(found.dtype.newbyteorder("="))
