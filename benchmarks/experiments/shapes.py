"""Shapes to be wanted that no hand made: letters, bowls, trenches, ridges, measured sand and dough.

Each is a relief over the whole image of a camera: (H, W) float32, metres against the bed's mean
surface, positive is lower, as depth.  All lie in the middle of the image: `MARGIN` metres at its
edge are flat and 0.  Slopes are at most `STEEPEST`.  Letters, bowls and trenches are dug out and
lose volume, which flour can do by packing; ridges, sand and dough keep it: their mean is 0.

Lengths are metres on level ground in the middle of the camera's range; perspective within the
relief is left out, as in `depth_of_relief`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy import ndimage

from jshape._typing import Float
from jshape.camera import PAPER_BOX, Camera
from jshape.errors import BadImage
from jshape.goals.reliefs import top_of_points

MARGIN = 0.0418
"""Width of the flat edge, metres: 40 pixels of `PAPER_BOX`."""
STEEPEST = 1.5
"""Steepest slope (rise over run): a third of what flour holds, half of what kinetic sand does."""
DEPTHS = (0.008, 0.018)
"""From least to greatest depth of what is drawn, metres."""
STROKES = (0.042, 0.050)
"""From least to greatest width of a letter's strokes, metres: 40 to 48 pixels of `PAPER_BOX`."""
HEIGHT = 0.015
"""Greatest height or depth of measured sand, and the height of a piece of dough, metres."""
BLEND = 0.045
"""Over this width measured shapes blend into the flat edge, metres."""
DOUGH_CELL = 0.0025
"""Side of the cells that a point cloud of dough is gathered in, metres."""


class Shape(NamedTuple):
    """A relief with a name for people."""

    name: str
    relief: np.ndarray
    """(H, W) float32, metres, positive is lower."""


Lines = list[np.ndarray]
"""Polylines, each (n, 2) of (x, y)."""


def letter(rng: np.random.Generator, camera: Camera = PAPER_BOX) -> Shape:
    """A letter of `LETTERS` in thick dug strokes, turned by up to 40 degrees.  Loses volume."""
    name = str(rng.choice(list(LETTERS)))
    half = rng.uniform(*STROKES) / 2
    size, angle = rng.uniform(0.075, 0.095), np.radians(rng.uniform(-40, 40))
    lines = _placed(rng, camera, [_turned(line * size, angle) for line in LETTERS[name]], half)
    dug = _dug(_far(lines, camera), half, rng.uniform(*DEPTHS))
    return Shape(f"letter {name}", dug.astype(np.float32))


def bowl(rng: np.random.Generator, camera: Camera = PAPER_BOX) -> Shape:
    """A round or an elliptic bowl without edges.  Loses volume."""
    longer = rng.uniform(0.065, 0.11)
    shorter = longer * (1.0 if rng.random() < 0.5 else rng.uniform(0.55, 0.8))
    angle = rng.uniform(0, np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    ends = np.hypot([longer * cos, longer * sin], [shorter * sin, shorter * cos])
    middle = _placed(rng, camera, [np.stack([-ends, ends])], 0.0)[0].mean(0)
    x, y = _axes(camera)
    x, y = x - middle[0], y - middle[1]
    out2 = ((cos * x + sin * y) / longer) ** 2 + ((cos * y - sin * x) / shorter) ** 2
    dug = rng.uniform(*DEPTHS) * np.clip(1.0 - out2, 0.0, 1.0) ** 2
    return Shape("bowl" if longer == shorter else "elliptic bowl", dug.astype(np.float32))


def trench(rng: np.random.Generator, camera: Camera = PAPER_BOX) -> Shape:
    """A trench, straight at any angle or, one time in three, bent like an L.  Loses volume."""
    half, angle = rng.uniform(0.018, 0.026), rng.uniform(0, np.pi)
    if rng.random() < 1 / 3:
        arms = rng.uniform(0.10, 0.17, 2)
        line = np.array([[arms[0], 0.0], [0.0, 0.0], [0.0, arms[1]]])
        name = "L trench"
    else:
        line = np.array([[-0.5, 0.0], [0.5, 0.0]]) * rng.uniform(0.12, 0.30)
        name = f"trench {np.degrees(angle):.0f} deg"
    lines = _placed(rng, camera, [_turned(line, angle)], half)
    dug = _dug(_far(lines, camera), half, rng.uniform(*DEPTHS))
    return Shape(name, dug.astype(np.float32))


def ridge(rng: np.random.Generator, camera: Camera = PAPER_BOX) -> Shape:
    """A straight ridge between the furrows that its material came from.  Keeps its volume."""
    half, angle = rng.uniform(0.018, 0.024), rng.uniform(0, np.pi)
    furrow = 1.6 * half
    line = np.array([[-0.5, 0.0], [0.5, 0.0]]) * rng.uniform(0.10, 0.22)
    lines = _placed(rng, camera, [_turned(line, angle)], half + furrow)
    far = _far(lines, camera)
    crest = _smooth(1.0 - far / half)
    across = (far - half) / furrow
    beside = np.where((across > 0) & (across < 1), np.sin(np.pi * across) ** 2, 0.0)
    height = rng.uniform(*DEPTHS)
    relief = height * (beside * (crest.sum() / beside.sum()) - crest)
    return Shape(f"ridge {np.degrees(angle):.0f} deg", relief.astype(np.float32))


DRAWN: dict[str, Callable[..., Shape]] = {
    "letter": letter, "bowl": bowl, "trench": trench, "ridge": ridge,
}  # fmt: skip
"""Shapes that are drawn from a generator alone."""


def sand(measured: np.ndarray, camera: Camera = PAPER_BOX) -> Float[np.ndarray, "H W"]:
    """A measured height map as a relief that reaches `HEIGHT` and keeps its volume.

    Args:
      measured: (rows, columns) of depth, in any unit and against any level; positive is lower.
      camera: whose image to fill.

    Raises:
      BadImage: not a two-dimensional map of finite numbers, or one without relief.
    """
    measured = np.asarray(measured)
    if measured.ndim != 2 or min(measured.shape, default=0) < 2 or measured.dtype.kind not in "fiu":
        raise BadImage(f"a map has shape {measured.shape} and type {measured.dtype}, not numbers")
    if not np.isfinite(measured).all() or np.ptp(measured) == 0:
        raise BadImage("a map has to be of finite numbers, and not all the same")
    relief = _inlaid(measured / np.abs(measured).max(), camera, 1.0)
    return (relief * (HEIGHT / np.abs(relief).max())).astype(np.float32)


def dough(points: Float[np.ndarray, "P 3"], camera: Camera = PAPER_BOX) -> Float[np.ndarray, "H W"]:
    """A measured piece of dough as a relief: `HEIGHT` high, its volume taken from around it.

    The highest points of every cell are the surface; what lies on the table is left out, and a
    place beside the piece that no point reaches is table.

    Args:
      points: (P, 3) of (x, y, z), z upwards, metres; a piece on a level table.
      camera: whose image to fill.

    Raises:
      BadImage: nothing stands out of the table.
    """
    table = float(np.percentile(points[:, 2], 1))
    if np.ptp(points[:, 2]) == 0:
        raise BadImage(f"{len(points)} points hold no piece of dough: they are level")
    top = top_of_points(points[:, :2], points[:, 2] - table, DOUGH_CELL, margin=8)
    top = np.nan_to_num(top)
    top = ndimage.gaussian_filter(ndimage.median_filter(top, 3), 1.0)
    found: Any = ndimage.label(top > 0.2 * top.max())
    pieces = found[0]
    piece = pieces == np.argmax(np.bincount(pieces.reshape(-1))[1:]) + 1
    top = np.where(ndimage.binary_dilation(piece, iterations=2), top, 0.0)
    rows, columns = (slice(k.min() - 6, k.max() + 7) for k in np.nonzero(piece))
    return _inlaid(-HEIGHT * (top / top.max())[rows, columns], camera, 0.85).astype(np.float32)


def depth_of_relief(
    relief: np.ndarray, camera: Camera, *, scale: float = 1.0, middle: float | None = None
) -> Float[np.ndarray, "H W"]:
    """The depth image of a relief laid over the whole view of a camera.

    The relief is stretched to the image, so its horizontal size is what the camera sees; `scale`
    sets how high it is.  Perspective within the relief is left out: at 0.45 m, 25 mm of height
    move a point at the edge of the paper's box by 6 %.

    Args:
      relief: (rows, columns) of depth against its mean: positive is farther away; NaN unknown.
      camera: whose image to fill.
      scale: metres of depth per unit of the relief.
      middle: depth of relief 0, metres; None is the middle of the camera's range.

    Returns:
      (H, W) float32, metres; NaN where the relief is unknown.

    Raises:
      BadImage: not a two-dimensional map of real numbers.
    """
    relief = np.asarray(relief)
    if relief.ndim != 2 or min(relief.shape, default=0) < 2 or relief.dtype.kind not in "fiu":
        raise BadImage(
            f"a relief has shape {relief.shape} and type {relief.dtype}; "
            "expected (rows, columns) of numbers, at least 2 x 2"
        )
    if middle is None:
        middle = (float(camera.z_min) + float(camera.z_max)) / 2
    size = (camera.width, camera.height)
    stretched = cv2.resize(relief.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return (middle + scale * stretched).astype(np.float32)


def _inlaid(relief: np.ndarray, camera: Camera, share: float) -> np.ndarray:
    """A relief stretched, proportions kept, to a share of the middle; blended, mean 0."""
    sides, sizes = pixel(camera), np.array(relief.shape[::-1])
    cell = share * (2 * _half(camera) / sizes).min()
    w, h = (int(n) for n in sizes * cell / sides)
    inner = cv2.resize(relief.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    inner = ndimage.gaussian_filter(inner.astype(float), 2.0)  # the corners of bilinear patches
    edge_x, edge_y = (
        _smooth((np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) * side / BLEND)
        for n, side in zip((w, h), sides, strict=True)
    )
    weight = edge_y[:, None] * edge_x[None, :]
    inner = weight * (inner - (weight * inner).sum() / weight.sum())
    left, top = (camera.width - w) // 2, (camera.height - h) // 2
    whole = np.zeros(camera.shape)
    whole[top : top + h, left : left + w] = inner
    return whole


def pixel(camera: Camera) -> np.ndarray:
    """Sides (x, y) of a pixel on level ground in the middle of the range, metres."""
    middle = (float(camera.z_min) + float(camera.z_max)) / 2
    return middle / np.array([float(camera.fx), float(camera.fy)])


def _half(camera: Camera) -> np.ndarray:
    """Half sides (x, y) of the rectangle within the margin, metres."""
    return np.array([camera.width, camera.height]) / 2 * pixel(camera) - MARGIN


def _axes(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """X (1, W) and y (H, 1) of the pixels from the middle of the image, metres."""
    x, y = (
        (np.arange(n) + 0.5 - n / 2) * side
        for n, side in zip((camera.width, camera.height), pixel(camera), strict=True)
    )
    return x[None, :], y[:, None]


def _turned(line: np.ndarray, angle: float) -> np.ndarray:
    """A polyline turned from x towards y, radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return line @ np.array([[cos, sin], [-sin, cos]])


def _placed(rng: np.random.Generator, camera: Camera, lines: Lines, half: float) -> Lines:
    """Polylines anywhere in the middle, with `half` metres around; shrunk if they do not fit."""
    every = np.concatenate(lines)
    low, high = every.min(0), every.max(0)
    room = _half(camera) - half
    shrink = min(1.0, *(2 * room / np.maximum(high - low, 1e-9)))
    slack = np.maximum(room - shrink * (high - low) / 2, 0.0)
    middle = rng.uniform(-slack, slack)
    return [shrink * (line - (low + high) / 2) + middle for line in lines]


def _far(lines: Lines, camera: Camera) -> np.ndarray:
    """Distance (H, W) of every pixel from the nearest of some polylines, metres."""
    x, y = _axes(camera)
    nearest = np.full(camera.shape, np.inf)
    for line in lines:
        for (x0, y0), (x1, y1) in zip(line[:-1], line[1:], strict=True):
            dx, dy = x1 - x0, y1 - y0
            along = ((x - x0) * dx + (y - y0) * dy) / max(dx**2 + dy**2, 1e-12)
            along = np.clip(along, 0.0, 1.0)
            off = (x - x0 - along * dx) ** 2 + (y - y0 - along * dy) ** 2
            np.minimum(nearest, off, out=nearest)
    return np.sqrt(nearest)


def _dug(far: np.ndarray, half: float, depth: float) -> np.ndarray:
    """A groove of `half` width whose walls are as steep as is allowed."""
    wall = 1.5 * depth / STEEPEST  # a smooth step is 1.5 times as steep as a straight one
    return depth * _smooth((half - far) / wall)


def _smooth(share: np.ndarray) -> np.ndarray:
    """0 below 0, 1 above 1, and a smooth step between."""
    share = np.clip(share, 0.0, 1.0)
    return share**2 * (3.0 - 2.0 * share)


def _arc(middle: tuple, radii: tuple, start: int, stop: int) -> np.ndarray:
    """Part of an ellipse, from `start` to `stop` degrees from x towards y."""
    angle = np.radians(np.linspace(start, stop, 17))
    return np.array(middle) + np.array(radii) * np.stack([np.cos(angle), np.sin(angle)], -1)


def _line(*points: tuple) -> np.ndarray:
    return np.array(points, float)


LETTERS: dict[str, Lines] = {
    "C": [_arc((0, 0), (0.8, 1), -50, -310)],
    "I": [_line((0, -1), (0, 1)), _line((-0.5, -1), (0.5, -1)), _line((-0.5, 1), (0.5, 1))],
    "L": [_line((-0.6, -1), (-0.6, 1), (0.7, 1))],
    "O": [_arc((0, 0), (0.8, 1), 0, 360)],
    "S": [_arc((0, -0.5), (0.62, 0.5), -20, -270), _arc((0, 0.5), (0.62, 0.5), -90, 160)],
    "T": [_line((-0.8, -1), (0.8, -1)), _line((0, -1), (0, 1))],
    "U": [_line((-0.7, -1), (-0.7, 0.3)), _arc((0, 0.3), (0.7, 0.7), 180, 0),
          _line((0.7, 0.3), (0.7, -1))],
    "X": [_line((-0.8, -1), (0.8, 1)), _line((0.8, -1), (-0.8, 1))],
}  # fmt: skip
"""The middle lines of letters, 2 high around (0, 0), y downwards."""
