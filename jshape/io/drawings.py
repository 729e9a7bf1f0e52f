"""Drawings on disk, in grey or in colour: masks and height maps that people paint."""

import io
import os
import warnings
from pathlib import Path

import numpy as np

from jshape.errors import BadImage, needs
from jshape.io.files import read_bytes
from jshape.io.formats import FILE_LIMIT, PIXEL_LIMIT, read_array

_PNG = b"\x89PNG\r\n\x1a\n"
_PAINTED = (_PNG, b"\xff\xd8\xff", b"BM")


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
