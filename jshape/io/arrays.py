"""NPY, and NPZ of banks and plans: arrays that are read without trust in what a file says."""

import io
import warnings
import zipfile

import numpy as np

from jshape.errors import BadFile, BadImage, one_line

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


def parse_npy(data: bytes, where: str) -> np.ndarray:
    """An array from its header and bytes: nothing is unpickled, nothing allocated on its word.

    Raises:
      BadImage: not a whole NPY, or one that does not hold numbers.
    """
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings(action="ignore"):
            version = np.lib.format.read_magic(stream)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            else:
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    except Exception as problem:  # NumPy promises no type here: a header is parsed as Python
        raise BadImage(f"{where}: not a readable NPY: {one_line(problem)}") from None
    if dtype.hasobject:
        raise BadImage(f"{where}: the NPY holds Python objects, which are never loaded")
    if dtype.fields is not None or dtype.kind not in "fiub":
        raise BadImage(
            f"{where}: the NPY holds {dtype}; expected float (metres) or uint16 (counts)"
        )
    if len(shape) > 32 or any(type(side) is not int or side < 0 for side in shape):
        raise BadImage(f"{where}: not a readable NPY: its shape is {one_line(shape, 60)}")
    count = int(np.prod(shape, dtype=object)) if shape else 1
    if count == 0:
        raise BadImage(f"{where}: the image is empty (shape {shape})")
    start = stream.tell()
    if len(data) - start < count * dtype.itemsize:
        raise BadImage(f"{where}: the NPY is cut off: {count:,} numbers expected")
    flat = np.frombuffer(data, dtype, count, start)
    return flat.reshape(shape, order="F" if fortran else "C").astype(dtype.newbyteorder("="))
