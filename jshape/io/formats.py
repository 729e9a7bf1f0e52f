"""Image files to arrays, by what the bytes say and not by the file's name.

OpenCV and Pillow bring what is not a plain grey image into another form without a word (16-bit grey
with alpha becomes 8 bits, three bands one, 12 bits 16), so a file's header is read first.  OpenCV
decodes, with its log off; of a PNG only chunks whose checksums are right, since damage is printed.
Pillow (of the extra `cli`) reads the tags of TIFF.
"""

import io
import os
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadImage, needs
from jshape.io.arrays import parse_npy
from jshape.io.files import read_bytes

FILE_LIMIT = 512 * 2**20
"""Largest image file that is read, bytes."""
PIXEL_LIMIT = 2**26
"""Most pixels of an image: 67 million."""

SUFFIXES = (".png", ".tif", ".tiff", ".npy")
"""Endings of the files that `read_array` reads."""

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_OTHERS = {
    b"\xff\xd8\xff": "a JPEG, which cannot hold a depth image",
    b"GIF8": "a GIF, which cannot hold a depth image",
    b"BM": "a BMP, which cannot hold a depth image",
    b"v/1\x01": "an EXR; save it as NPY or float TIFF",
    b"PK\x03\x04": "a ZIP or NPZ archive",
    b"\x1f\x8b": "packed by gzip; unpack it",
    b"\x28\xb5\x2f\xfd": "packed by Zstandard; unpack it",
    b"ply": "a point cloud (PLY), not an image",
}
_PAINTED = (_PNG, b"\xff\xd8\xff", b"BM")
_COLOURS = {2: "colour (RGB)", 3: "colour (palette)", 4: "grey with alpha", 6: "colour (RGBA)"}


def read_array(path: str | os.PathLike) -> np.ndarray:
    """The array of an image file as it is stored, whatever its type: (H, W), one channel.

    A masked array where the file says which value is no data (GDAL's NODATA in a TIFF, the
    transparent grey of a PNG).  A TIFF of several pages gives its first; one that says that it lies
    turned is made upright.

    Raises:
      BadFile: the file is missing, a folder, empty, too large or unreadable.
      BadImage: it is not a whole PNG, TIFF or NPY, or has more than one channel.
    """
    path = Path(path)
    data = read_bytes(path, limit=FILE_LIMIT)
    reader = next((r for magic, r in _READERS.items() if data.startswith(magic)), None)
    if reader is None:
        what = next((w for magic, w in _OTHERS.items() if data.startswith(magic)), "not an image")
        raise BadImage(f"{path}: {what}; allowed: PNG, TIFF or NPY")
    image = reader(data, str(path))
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 3 and image.shape[2] in (2, 3, 4):
        raise BadImage(
            f"{path}: has {image.shape[2]} channels (a colour image); a depth image has one"
        )
    if image.ndim != 2:
        raise BadImage(f"{path}: has shape {image.shape}; a depth image is (rows, columns)")
    _check_size(str(path), image.shape[1], image.shape[0])
    return image


def read_drawing(path: str | os.PathLike) -> np.ndarray:
    """A drawing as (rows, columns) of numbers: as stored if it is grey, else its brightness.

    PNG, TIFF and NPY of one channel keep their numbers; colour PNG, JPEG and BMP become 8-bit grey,
    on black where they are transparent.  What a camera or phone turned (EXIF) is upright.

    Raises:
      BadFile: the file cannot be read.
      BadImage: it is no image.
    """
    path = Path(path)
    data = read_bytes(path, limit=FILE_LIMIT)
    if not data.startswith(_PAINTED):
        return read_array(path)
    with needs("cli", "reading a painting"):
        from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings(action="ignore"):
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "BMP")) as image:
                if image.width * image.height > PIXEL_LIMIT:
                    size = f"{image.width}x{image.height} pixels"
                    raise BadImage(f"{path}: {size}; at most {PIXEL_LIMIT:,} are read")
                upright = ImageOps.exif_transpose(image)
    except BadImage:
        raise
    except Exception:  # Pillow promises no type for a damaged file
        raise BadImage(f"{path}: the painting is cut off or damaged") from None
    if upright.mode in ("L", "I;16"):
        grey, clear = np.asarray(upright), image.info.get("transparency")
        return grey if clear is None else np.ma.masked_equal(grey, clear)
    if data.startswith(_PNG) and data[24] == 16:  # of which Pillow keeps 8
        raise BadImage(
            f"{path}: is a colour PNG of 16 bits; a painting has 8 bits, a height map of 16 is grey"
        )
    black = Image.new("RGBA", upright.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, upright.convert("RGBA")).convert("L"))


def encode_png(counts: np.ndarray) -> bytes:
    """The bytes of a 16-bit single-channel PNG of counts (H, W) uint16.

    Raises BadImage: not such an array, or it is empty.
    """
    if counts.dtype != np.uint16 or counts.ndim != 2 or counts.size == 0:
        raise BadImage(
            f"counts have shape {counts.shape} and type {counts.dtype}; expected "
            "(rows, columns) of uint16"
        )
    import cv2

    return cv2.imencode(".png", np.ascontiguousarray(counts))[1].tobytes()


def _check_size(where: str, width: int, height: int) -> None:
    if width <= 0 or height <= 0:
        raise BadImage(f"{where}: the image is empty ({width}x{height} pixels)")
    if width * height > PIXEL_LIMIT:
        raise BadImage(f"{where}: {width}x{height} pixels; at most {PIXEL_LIMIT:,} are read")


def read_png(data: bytes, where: str) -> np.ndarray:
    """A grey PNG of 8 or 16 bits; masked where its pixels are transparent.

    Raises BadImage: it is damaged, or another kind of PNG.
    """
    broken = BadImage(f"{where}: the PNG is cut off or damaged")
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise broken
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    if colour in _COLOURS:
        raise BadImage(f"{where}: is {_COLOURS[colour]}; a depth image has one grey channel")
    if colour != 0 or depth not in (8, 16):
        raise BadImage(
            f"{where}: is a {depth}-bit PNG; a depth image has 16 bits (or 8, luminance)"
        )
    _check_size(where, width, height)
    kept, clear, at, name = [_PNG], b"", len(_PNG), b""
    while name != b"IEND":
        size, name = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        end = at + 12 + size
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end]) or not name:
            raise broken
        if name in (b"IHDR", b"IDAT", b"IEND"):
            kept.append(data[at:end])
        clear = data[at + 8 : at + 10] if name == b"tRNS" else clear
        at = end
    pixels = _decode(b"".join(kept), where, "PNG")
    return np.ma.masked_equal(pixels, int.from_bytes(clear)) if clear else pixels


# What OpenCV reads bit for bit: SampleFormat (1 whole, 2 signed, 3 floating) and bits.
_SAMPLES = {(1, 8), (1, 16), (2, 8), (2, 16), (2, 32), (3, 32), (3, 64)}
_PACKING = {1: "", 5: "LZW", 8: "deflate", 32773: "PackBits", 32946: "deflate"}
_NODATA = 42113


def _read_tiff(data: bytes, where: str) -> np.ndarray:
    """The first page of a TIFF, if it has one channel of bits that the decoder keeps."""
    tags = _tiff_tags(data, where)

    def tag(number: int, usual: int = 1) -> int:
        found = tags.get(number, usual)
        found = found[0] if isinstance(found, tuple) else found
        return found if isinstance(found, int) else usual

    channels, bits, sample = tag(277), tag(258), tag(339)
    if channels != 1:
        raise BadImage(
            f"{where}: has {channels} channels of {bits} bits (colour, alpha or several bands); "
            "a depth image has one"
        )
    if tag(262, 1) not in (0, 1):
        raise BadImage(f"{where}: is colour (palette); a depth image has one grey channel")
    if (sample, bits) not in _SAMPLES or tag(259, 1) not in _PACKING:
        kind = {1: "uint", 2: "int", 3: "float"}.get(sample, "an unknown kind of ")
        packed = _PACKING.get(tag(259, 1), f"compression {tag(259, 1)}")
        raise BadImage(
            f"{where}: holds {kind}{bits}{', ' * bool(packed)}{packed}; read are uint8, uint16, "
            "int8, int16, int32, float32 and float64, plain or packed by LZW, deflate or PackBits"
        )
    _check_size(where, tag(256, 0), tag(257, 0))
    image = _decode(data, where, "TIFF")
    try:
        nodata = float(str(tags.get(_NODATA, "")).strip("\0 "))
    except ValueError:
        return image
    with np.errstate(over="ignore"):  # as GDAL, in the type of the pixels; NaN is none as it is
        code = image.dtype.type(nodata) if image.dtype.kind == "f" else nodata
    return np.ma.masked_where(image == code, image) if (image == code).any() else image


def _tiff_tags(data: bytes, where: str) -> dict[int, Any]:
    """The tags of a TIFF's (or BigTIFF's) first page."""
    with needs("cli", f"{where}: reading TIFF"):
        from PIL.TiffImagePlugin import ImageFileDirectory_v2

    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings(action="error"):  # so Pillow tells what is cut off
            tags = ImageFileDirectory_v2(data[: 16 if b"+" in data[2:4] else 8])
            stream.seek(tags.next)
            tags.load(stream)
            return dict(tags)
    except Exception:
        raise BadImage(f"{where}: the TIFF is cut off or damaged") from None


def _decode(data: bytes, where: str, kind: str) -> np.ndarray:
    import cv2

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
        raise BadImage(f"{where}: the {kind} is cut off, damaged or of a type that is not read")
    return image


_READERS: dict[bytes, Callable[[bytes, str], np.ndarray]] = {
    _PNG: read_png,
    b"\x93NUMPY": parse_npy,
    **dict.fromkeys(_TIFF, _read_tiff),
}
"""The reader of each format, by the bytes that its files start with."""
