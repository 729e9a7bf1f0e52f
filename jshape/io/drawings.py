"""Drawings on disk, in grey or in colour: masks and height maps that people paint."""

import io
import os
from pathlib import Path

import numpy as np

from jshape.errors import BadImage, needs, one_line
from jshape.io.files import read_bytes
from jshape.io.formats import FILE_LIMIT, PIXEL_LIMIT, orientation, read_array

_TURNS = {
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: np.transpose,
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).T,
    8: np.rot90,
}
"""What makes an image upright, by its EXIF orientation.  OpenCV does it for TIFF only."""
_PAINTED = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM")


def read_drawing(path: str | os.PathLike) -> np.ndarray:
    """A drawing as (rows, columns) of numbers: as stored if it is grey, else its brightness.

    PNG, TIFF, EXR and NPY of one channel keep their numbers; colour PNG, JPEG and BMP become 8-bit
    grey, on black where they are transparent.  What a camera or phone turned (EXIF) is upright.

    Raises:
      BadFile: the file cannot be read.
      BadImage: it is no image.
    """
    path = Path(path)
    data = read_bytes(path, limit=FILE_LIMIT)
    try:
        drawn = read_array(path, turned=True)
        return _TURNS[orientation(data)](drawn) if data.startswith(_PAINTED) else drawn
    except BadImage as problem:
        if not data.startswith(_PAINTED):
            raise
        if data.startswith(_PAINTED[0]) and data[24] == 16:  # Pillow keeps 8 of the 16 bits
            raise BadImage(
                f"{problem}; a painting has 8 bits, a height map of 16 is grey"
            ) from None
        grey = _brightness(data)
        if isinstance(grey, str):
            raise BadImage(f"{problem}; as a painting: {grey}") from None
        return grey


def _brightness(data: bytes) -> np.ndarray | str:
    """Grey levels of a painted image, or why there are none."""
    import warnings

    with needs("cli", "reading a painting"):
        from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "BMP")) as image:
                if image.width * image.height > PIXEL_LIMIT:
                    return f"{image.width}x{image.height} pixels; at most {PIXEL_LIMIT:,} are read"
                colour = ImageOps.exif_transpose(image).convert("RGBA")
    except Exception as problem:  # Pillow promises no type for a damaged file
        return one_line(f"{type(problem).__name__}: {problem}", 100)
    black = Image.new("RGBA", colour.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, colour).convert("L"))
