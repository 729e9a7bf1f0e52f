"""Things to mold: a text, a mask, a height map, a mesh, each as a relief of its own size.

A relief is looked at from above: (rows, columns) of metres up, NaN where it is nothing; its
columns run to the right.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from jshape._typing import Float, Int
from jshape.camera import Camera, unmasked
from jshape.errors import BadImage, UnknownName, needs, quoted
from jshape.io.mesh import depth_of_faces

PIXELS = 1024
"""Longest side of a relief that is drawn here, pixels: finer than a bed's map by half."""
UPS = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}
"""Which axes of a mesh are x, y and z on the bed, for each that points up."""


@dataclass(frozen=True, eq=False)
class Relief:
    """Something to raise or to sink, not yet placed."""

    name: str
    """For people."""
    heights: Float[np.ndarray, "rows columns"]
    """Change of the bed, metres, up; NaN: none."""
    size: tuple[float, float]
    """Along columns and rows, metres."""

    def sized(self, longest: float, *, whole: bool = False) -> "Relief":
        """The same with another longest side, metres; `whole`: its heights grow with it."""
        factor = longest / max(self.size)
        size = self.size[0] * factor, self.size[1] * factor
        heights = self.heights * np.float32(factor) if whole else self.heights
        return replace(self, heights=heights, size=size)


def relief_of_text(text: str, height: float) -> Relief:
    """A line of text in bold letters, 1 m long or high.

    Args:
      text: what the font (DejaVu Sans) has signs for.
      height: of the letters, metres; negative: sunk.

    Raises:
      BadImage: nothing to be seen, or a character that the font does not have.
    """
    with needs("cli", "drawing letters"):
        from matplotlib.font_manager import FontProperties, findfont, get_font
        from matplotlib.path import Path
        from matplotlib.textpath import TextToPath

    if not text.strip():
        raise BadImage("the text is empty: there is nothing to mold")
    face = FontProperties(family="DejaVu Sans", weight="bold")
    signs = get_font(findfont(face)).get_charmap()
    unknown = [sign for sign in text if ord(sign) not in signs]
    if unknown:
        raise BadImage(f"the text {quoted(text)}: the font has no sign for {quoted(unknown[0])}")
    corners, codes = TextToPath().get_text_path(face, text, ismath=False)
    points = np.asarray(corners)
    outlines = Path(points, codes).to_polygons() if len(points) else []
    outlines = [line * (1, -1) for line in map(np.asarray, outlines) if len(line) > 2]
    if not outlines:
        raise BadImage(f"the text {quoted(text)} has nothing to be seen")
    every = np.concatenate(outlines)
    low, size = every.min(0), np.ptp(every, axis=0)
    scale = (PIXELS - 1) / size.max()
    shape = tuple(int(n) for n in np.ceil(size[::-1] * scale) + 1)
    drawn = np.zeros(shape, np.uint8)
    # Even-odd, so that the eye of an O is open; 4 binary places of a pixel.
    lines = [np.rint((line - low) * scale * 16).astype(np.int32) for line in outlines]
    cv2.fillPoly(drawn, lines, 255, lineType=cv2.LINE_AA, shift=4)
    heights = drawn.astype(np.float32) * np.float32(height / 255)
    return Relief(f"text {quoted(text)}", heights, _proportions(shape))


def relief_of_mask(mask: np.ndarray, height: float, name: str = "mask") -> Relief:
    """What is drawn in a mask, 1 m long: all that is brighter than half of its brightest pixel.

    Raises:
      BadImage: not an image of numbers, or all of it is the same.
    """
    return Relief(name, inked(mask, name) * np.float32(height), _proportions(mask.shape))


def inked(mask: np.ndarray, name: str = "mask") -> Float[np.ndarray, "rows columns"]:
    """1 where something is drawn and 0 elsewhere.  Raises BadImage: as for `relief_of_mask`."""
    values = _numbers(mask, name)
    top = float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
    ink = np.nan_to_num(values) > top / 2
    if top <= 0 or ink.all():
        raise BadImage(f"{name}: all of it is the same: nothing is drawn")
    return ink.astype(np.float32)


def relief_of_heights(
    heights: np.ndarray,
    low: float | None = None,
    high: float | None = None,
    name: str = "height map",
) -> Relief:
    """A grey height map, 1 m long.

    Args:
      heights: (rows, columns); NaN: no change.  Floats without `low` and `high` are metres, up.
      low: height of the darkest, metres.
      high: height of the brightest, metres.
      name: for people and errors.

    Raises:
      BadImage: not an image of numbers, or all of it is the same; counts without heights.
    """
    values = _numbers(heights, name)
    known = values[np.isfinite(values)]
    if known.size == 0 or np.ptp(known) == 0:
        raise BadImage(f"{name}: all of it is the same: there is no relief")
    least = known.min()
    above = known[known > least]
    if least <= -999 and above.min() - least > 10 * np.ptp(above) and len(known) - len(above) > 1:
        raise BadImage(
            f"{name}: {len(known) - len(above):,} pixels hold {least:g}, the others "
            f"{above.min():g} to {above.max():g}: is that no data? Mark it as NaN or, in a TIFF, "
            "by the tag GDAL_NODATA"
        )
    if low is not None and high is not None:
        share = (values - known.min()) / np.ptp(known)
        values = low + (high - low) * share
    elif heights.dtype.kind != "f":
        raise BadImage(f"{name}: grey levels need a height: --raise-mm, --depth-mm or both")
    elif np.abs(known).max() > 1:
        raise BadImage(
            f"{name}: heights are {known.min():g} to {known.max():g} m (are they millimetres?); "
            "floats are metres, or say their height with --raise-mm or --depth-mm"
        )
    values = np.where(np.isfinite(values), values, np.nan)
    return Relief(name, values.astype(np.float32), _proportions(values.shape))


def relief_of_solid(
    points: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "F 3"] | None,
    *,
    unit: float = 1.0,
    up: str = "z",
    name: str = "mesh",
) -> Relief:
    """What stands on the table of a mesh or a point cloud: heights above its lowest point.

    Args:
      points: corners of the mesh, or the cloud.
      faces: of the mesh; None or none for a cloud.
      unit: metres per unit of the points.
      up: which axis points up: "x", "y" or "z".
      name: for people and errors.

    Raises:
      BadImage: it is flat, or has no extent.
      UnknownName: no such axis.
    """
    if up not in UPS:
        raise UnknownName("axis", up, UPS)
    turned = np.asarray(points, np.float64)[:, UPS[up]] * unit * (1, -1, 1)  # rows run down
    if faces is not None and len(faces):
        turned, faces = _used(turned, np.asarray(faces))
    low, size = turned.min(0), np.ptp(turned, axis=0)
    if min(size) <= 1e-9 * max(size):
        flat = " x ".join(f"{1e3 * side:.3g}" for side in size)
        raise BadImage(f"{name}: it is flat ({flat} mm, the last one up): there is no relief")
    placed = turned - low
    if faces is None or not len(faces):
        # 16 points a cell: half of them may be the underside of a closed body.
        longest, spaced = max(size[:2]), 4 * (size[0] * size[1] / len(points)) ** 0.5
        cell = float(np.clip(spaced, longest / PIXELS, longest / 8))
        heights = top_of_points(placed[:, :2], placed[:, 2], cell, margin=0)
        shape = heights.shape
    else:
        cell = max(size[:2]) / PIXELS
        shape = tuple(int(n) for n in np.ceil(size[1::-1] / cell))
        heights = _from_above(placed, faces, shape, cell, str(name))
    if not np.isfinite(heights).any():
        raise BadImage(f"{name}: nothing of it is seen from above")
    return Relief(name, heights.astype(np.float32), (shape[1] * cell, shape[0] * cell))


def top_of_points(
    xy: Float[np.ndarray, "P 2"], height: Float[np.ndarray, "P"], cell: float, *, margin: int = 0
) -> Float[np.ndarray, "rows columns"]:
    """The highest points of a cloud in every cell of a grid; small gaps take their nearest cell.

    Args:
      xy: of the points.
      height: of the points.
      cell: side of a cell, in the points' unit.
      margin: empty cells around.

    Returns:
      (rows, columns) of (y, x); NaN in cells more than two cells away from any point.

    Raises:
      BadImage: the points are so far apart that the grid has more than ten million cells.
    """
    place = np.floor((xy - xy.min(0)) / cell).astype(int) + margin
    columns, rows = (int(n) for n in place.max(0) + margin + 1)
    if rows * columns > 1e7:
        raise BadImage(f"{len(xy)} points are too far apart: {columns} x {rows} cells")
    top = np.full((rows, columns), -np.inf)
    np.maximum.at(top, (place[:, 1], place[:, 0]), height)
    found: Any = ndimage.distance_transform_edt(np.isinf(top), return_indices=True)
    apart, nearest = found
    return np.where(apart <= 2, top[tuple(nearest)], np.nan)


def _from_above(
    points: np.ndarray, faces: np.ndarray, shape: tuple[int, ...], cell: float, name: str
) -> np.ndarray:
    """Height of the highest face at every cell, NaN where there is none.

    The renderer of the pinhole camera serves: with 1/z = 1 + height and x, y multiplied by z,
    planes stay planes, pixels are places, and the nearest face is the highest.
    """
    top = points[:, 2].max()
    z = 1.0 / (1.0 + points[:, 2] / top)
    rows, columns = shape
    camera = Camera(columns, rows, 1 / cell, 1 / cell, -0.5, -0.5, 0.5, 1.0)
    seen = depth_of_faces(
        np.stack([points[:, 0] * z, points[:, 1] * z, z], -1), faces, camera, name
    )
    return (1.0 / seen - 1.0) * top


def _used(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Only the corners that a face has."""
    used, numbers = np.unique(faces, return_inverse=True)
    return points[used], numbers.reshape(faces.shape)


def _numbers(image: np.ndarray, name: str) -> np.ndarray:
    image = np.asarray(unmasked(image))
    if image.ndim != 2 or min(image.shape, default=0) < 2 or image.dtype.kind not in "fiub":
        raise BadImage(
            f"{name}: has shape {image.shape} and type {image.dtype}; "
            "expected (rows, columns) of numbers, at least 2 x 2"
        )
    return image.astype(np.float32)


def _proportions(shape: tuple[int, ...]) -> tuple[float, float]:
    return shape[1] / max(shape), shape[0] / max(shape)
