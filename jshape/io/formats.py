"""One image file to one array, by what the bytes say and not by the file's name.

PNG, TIFF and EXR are decoded by OpenCV, which prints what it dislikes: so a PNG is checked and
reduced to its pixels first, and OpenCV's own log is off while the others are decoded.  It also
brings what is not a plain grey image into another form without a word (16-bit grey with alpha
becomes 8 bits, three bands one, 12 bits 16): so what a file holds is read from its header first.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadImage, one_line, quoted
from jshape.io.files import read_bytes

FILE_LIMIT = 512 * 2**20
"""Largest image file that is read, bytes."""
PIXEL_LIMIT = 2**26
"""Most pixels of an image: 67 million."""

ALLOWED = "PNG, TIFF, EXR or NPY"
_PNG = b"\x89PNG\r\n\x1a\n"
_NPY = b"\x93NUMPY"
_EXR = b"v/1\x01"
_EXR_SIZE = b"dataWindow\0box2i\0"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_OTHERS = {
    b"\xff\xd8\xff": "a JPEG, which cannot hold a depth image",
    b"GIF8": "a GIF, which cannot hold a depth image",
    b"BM": "a BMP, which cannot hold a depth image",
    b"PK\x03\x04": "a ZIP or NPZ archive",
    b"\x1f\x8b": "packed by gzip; unpack it",
    b"\x28\xb5\x2f\xfd": "packed by Zstandard; unpack it",
    b"ply": "a point cloud (PLY), not an image",
}
_COLOURS = {2: "colour (RGB)", 3: "colour (palette)", 4: "grey with alpha", 6: "colour (RGBA)"}


def read_array(path: str | os.PathLike, *, turned: bool = False) -> np.ndarray:
    """The array of an image file as it is stored, whatever its type: (H, W), one channel.

    A masked array where the file says which value is no data (GDAL's NODATA in a TIFF, the
    transparent grey of a PNG).  A TIFF of several pages gives its first.

    Raises:
      BadFile: the file is missing, a folder, empty, too large or unreadable.
      BadImage: it is not a whole PNG, TIFF, EXR or NPY, has more than one channel, or says that it
        lies turned (unless `turned`: then a TIFF is made upright, a PNG is as it is stored).
    """
    path = Path(path)
    data = read_bytes(path, limit=FILE_LIMIT)
    if not turned and (how := orientation(data)) != 1:
        raise BadImage(
            f"{path}: says that it lies turned (EXIF orientation {how}); a depth image lies as its "
            "camera saw it: save it without the orientation"
        )
    if data.startswith(_PNG):
        image = read_png(path, data)
    elif data.startswith(_NPY):
        image = parse_npy(data, str(path))
    elif data.startswith(_EXR):
        image = _decode(path, _exr_of_one_channel(path, data), "EXR")
    elif data.startswith(_TIFF):
        image = _read_tiff(path, data)
    else:
        what = next((w for magic, w in _OTHERS.items() if data.startswith(magic)), "not an image")
        raise BadImage(f"{path}: {what}; allowed: {ALLOWED}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 3 and image.shape[2] in (2, 3, 4):
        raise BadImage(
            f"{path}: has {image.shape[2]} channels (a colour image); a depth image has one"
        )
    if image.ndim != 2:
        raise BadImage(f"{path}: has shape {image.shape}; a depth image is (rows, columns)")
    _check_size(path, image.shape[1], image.shape[0])
    return image


def orientation(data: bytes) -> int:
    """How a PNG or TIFF says that it lies: 1 is upright, up to 8 as EXIF counts."""
    if not (data.startswith(_TIFF) or data.startswith(_PNG) and b"eXIf" in data):
        return 1
    import io
    import warnings

    from PIL import ExifTags, Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=("PNG", "TIFF")) as image:
                found = image.getexif().get(ExifTags.Base.Orientation, 1)
    except Exception:  # Pillow promises no type; what is damaged fails where it is decoded
        return 1
    return found if found in range(1, 9) else 1


def encode_png(counts: np.ndarray) -> bytes:
    """The bytes of a 16-bit single-channel PNG of counts (H, W) uint16.

    Raises:
      BadImage: not such an array, or it is empty.
    """
    if counts.dtype != np.uint16 or counts.ndim != 2 or counts.size == 0:
        raise BadImage(
            f"counts have shape {counts.shape} and type {counts.dtype}; expected "
            "(rows, columns) of uint16"
        )
    import cv2

    return cv2.imencode(".png", np.ascontiguousarray(counts))[1].tobytes()


def _check_size(path: Path, width: int, height: int) -> None:
    if width <= 0 or height <= 0:
        raise BadImage(f"{path}: the image is empty ({width}x{height} pixels)")
    if width * height > PIXEL_LIMIT:
        raise BadImage(f"{path}: {width}x{height} pixels; at most {PIXEL_LIMIT:,} are read")


def read_png(path: Path, data: bytes) -> np.ndarray:
    """A grey PNG of 8 or 16 bits; checked so far that the decoder finds nothing to print."""
    broken = BadImage(f"{path}: the PNG is cut off or damaged")
    header, body, clear, at = b"", [], None, len(_PNG)
    while True:
        if at + 12 > len(data):
            raise broken
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        if at + 12 + size > len(data):
            raise broken
        content = data[at + 8 : at + 8 + size]
        (check,) = struct.unpack(">I", data[at + 8 + size : at + 12 + size])
        if kind in (b"IHDR", b"IDAT", b"tRNS") and zlib.crc32(kind + content) != check:
            raise broken
        if kind == b"IHDR":
            header = content
        elif kind == b"IDAT":
            body.append(content)
        elif kind == b"tRNS" and len(content) == 2:
            (clear,) = struct.unpack(">H", content)
        elif kind == b"IEND":
            break
        at += 12 + size
    if len(header) != 13 or not body:
        raise broken
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if colour in _COLOURS:
        raise BadImage(f"{path}: is {_COLOURS[colour]}; a depth image has one grey channel")
    if colour != 0 or depth not in (8, 16):
        raise BadImage(f"{path}: is a {depth}-bit PNG; a depth image has 16 bits (or 8, luminance)")
    _check_size(path, width, height)
    row = 1 + width * depth // 8
    try:
        # Interlaced rows are padded a little differently; their size is at most twice as much.
        pixels = zlib.decompressobj().decompress(b"".join(body), 2 * row * height + 2**16)
    except zlib.error:
        raise broken from None
    if not interlaced and (
        len(pixels) < row * height or max(pixels[: row * height : row], default=0) > 4
    ):
        raise broken
    # Only header and pixels: text, colour profiles and the like can only make the decoder talk.
    chunks = [(b"IHDR", header), (b"IDAT", b"".join(body)), (b"IEND", b"")]
    image = _decode(path, _PNG + b"".join(_png_chunk(*chunk) for chunk in chunks), "PNG")
    return image if clear is None else np.ma.masked_equal(image, clear)


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    checked = kind + content
    return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))


# What OpenCV reads bit for bit: SampleFormat (1 whole, 2 signed, 3 floating) and bits.
_SAMPLES = {(1, 8), (1, 16), (2, 8), (2, 16), (2, 32), (3, 32), (3, 64)}
_PACKING = {1: "", 5: "LZW", 8: "deflate", 32773: "PackBits", 32946: "deflate"}
_NODATA = 42113


def _read_tiff(path: Path, data: bytes) -> np.ndarray:
    """The first page of a TIFF, if it has one channel of bits that the decoder keeps."""
    tags = _tiff_tags(path, data)

    def tag(number: int, usual: int) -> int:
        value = tags.get(number, (usual,))[0]
        return value if isinstance(value, int) else usual

    channels, bits, sample = tag(277, 1), tag(258, 1), tag(339, 1)
    kind = {1: "uint", 2: "int", 3: "float"}.get(sample, "an unknown kind of ")
    if channels != 1:
        raise BadImage(
            f"{path}: has {channels} channels of {bits} bits (colour, alpha or several bands); "
            "a depth image has one"
        )
    if tag(262, 1) not in (0, 1):
        raise BadImage(f"{path}: is colour (palette); a depth image has one grey channel")
    if (sample, bits) not in _SAMPLES or tag(259, 1) not in _PACKING:
        packed = _PACKING.get(tag(259, 1), f"compression {tag(259, 1)}")
        raise BadImage(
            f"{path}: holds {kind}{bits}{', ' * bool(packed)}{packed}; read are uint8, uint16, "
            "int8, int16, int32, float32 and float64, plain or packed by LZW, deflate or PackBits"
        )
    _check_size(path, tag(256, 0), tag(257, 0))
    image = _decode(path, data, "TIFF")
    try:
        nodata = float(tags.get(_NODATA, ("",))[0])
    except ValueError:
        return image
    with np.errstate(over="ignore"):  # as GDAL, in the type of the pixels; NaN is none as it is
        code = image.dtype.type(nodata) if image.dtype.kind == "f" else nodata
    return np.ma.masked_where(image == code, image) if (image == code).any() else image


def _tiff_tags(path: Path, data: bytes) -> dict[int, tuple[Any, ...]]:
    """The tags of a TIFF's (or BigTIFF's) first page that hold whole numbers or text."""
    order = "<" if data.startswith(b"II") else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    offset, count, entry, room = ("Q", "Q", "HHQ", 8) if big else ("I", "H", "HHI", 4)
    sizes = {1: "B", 2: "s", 3: "H", 4: "I", 16: "Q"}
    tags = {}
    try:
        (at,) = struct.unpack_from(order + offset, data, 8 if big else 4)
        (entries,) = struct.unpack_from(order + count, data, at)
        at += struct.calcsize(order + count)
        for _ in range(min(entries, 1000)):
            number, kind, length = struct.unpack_from(order + entry, data, at)
            place = at + struct.calcsize(order + entry)
            at = place + room
            if kind not in sizes or length == 0:
                continue
            length = min(length, 64)  # all that is asked of: not the places of the strips
            if length * struct.calcsize(order + sizes[kind]) > room:
                (place,) = struct.unpack_from(order + offset, data, place)
            found = struct.unpack_from(f"{order}{length}{sizes[kind]}", data, place)
            tags[number] = (found[0].rstrip(b"\0 ").decode("latin-1"),) if kind == 2 else found
    except struct.error:
        raise BadImage(f"{path}: the TIFF is cut off or damaged") from None
    return tags


def parse_npy(data: bytes, where: str) -> np.ndarray:
    """An array from its header and bytes: nothing is unpickled, nothing allocated on its word.

    Raises:
      BadImage: not a whole NPY, or one that does not hold numbers.
    """
    import io
    import warnings

    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
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


def _exr_of_one_channel(path: Path, data: bytes) -> bytes:
    """The EXR, with its only channel called Y: OpenCV returns noise for a lone channel Z."""
    at, channels = data.find(b"channels\0chlist\0"), []
    if at < 0 or at + 20 > len(data):
        raise BadImage(f"{path}: the EXR is cut off or damaged")
    at += 16
    (size,) = struct.unpack("<i", data[at : at + 4])
    at, end = at + 4, min(at + 4 + size, len(data))
    first, whole = at, False
    while at < end and data[at] != 0:
        stop = data.find(b"\0", at, end)
        if stop < 0:
            raise BadImage(f"{path}: the EXR is cut off or damaged")
        channels.append(data[at:stop].decode("latin-1"))
        whole = whole or data[stop + 1 : stop + 5] == b"\0\0\0\0"
        at = stop + 17
    if len(channels) != 1:
        raise BadImage(
            f"{path}: the EXR has {len(channels)} channels ({', '.join(channels[:6])}); "
            "a depth image has one"
        )
    if whole:  # OpenCV makes 8 bits of them
        raise BadImage(
            f"{path}: the EXR holds whole numbers (UINT); depth is float or half, metres"
        )
    if len(channels[0]) != 1:
        raise BadImage(
            f"{path}: the EXR's channel is called {quoted(channels[0])}; rename it Z or Y"
        )
    return data[:first] + b"Y" + data[first + 1 :]


def _decode(path: Path, data: bytes, kind: str) -> np.ndarray:
    # OpenCV reads this once, when it meets its first EXR; importing cv2 earlier does no harm.
    os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")
    import cv2

    at = data.find(_EXR_SIZE)
    if kind == "EXR" and 0 < at < len(data) - 40:
        left, top, right, bottom = struct.unpack_from("<4i", data, at + len(_EXR_SIZE) + 4)
        _check_size(path, right - left + 1, bottom - top + 1)

    log: Any = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    finally:
        log.setLogLevel(level)
    if image is None:
        if kind == "EXR" and not _has_exr(cv2):
            raise BadImage(
                f"{path}: this build of OpenCV cannot read EXR; convert it to TIFF or NPY"
            )
        raise BadImage(f"{path}: the {kind} is cut off, damaged or of a type that is not read")
    return image


def _has_exr(cv2: Any) -> bool:
    lines = cv2.getBuildInformation().splitlines()
    return any("OpenEXR:" in line and "NO" not in line for line in lines)
