"""Actions, the image region each can change, and the places where they can be applied.

Pixels are 0-based `(u, v)`; the paper counts from 1, so its clamp to [1, w] is [0, w - 1] here.
A ROI is `(w, h)` pixels; centred at `(u, v)` its first pixel is `(u - w // 2, v - h // 2)`.
Host code: NumPy, small, and it raises.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jshape._typing import ArrayLike
from jshape.camera import Camera
from jshape.errors import BadPosition, UnknownName


@dataclass(frozen=True)
class Action:
    """One row of Table I: what an action is called and how far its effect reaches."""

    name: str
    half_size: tuple[float, float, float]
    """ΔX, ΔY, ΔZ: half the sides of the box that holds the effect, metres."""
    description: str = ""


class ActionSet(tuple[Action, ...]):
    """An ordered set of actions, looked up by name."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in order."""
        return tuple(action.name for action in self)

    def named(self, name: str) -> Action:
        """The action of that name.

        Raises:
          UnknownName: there is none.
        """
        for action in self:
            if action.name == name:
                return action
        raise UnknownName("action", name, self.names)


PAPER_ACTIONS = ActionSet(
    (
        Action("grasp", (0.218, 0.195, 0.050), "the hand, first a claw, is closed"),
        Action("knock", (0.084, 0.075, 0.050), "the closed fist pushes downward"),
        Action("press", (0.046, 0.103, 0.050), "the bottom of the fist pushes downward"),
        Action("pinch", (0.042, 0.085, 0.050), "index and middle finger close"),
        Action("poke", (0.022, 0.018, 0.050), "the index finger pushes downward"),
    )
)
"""Table I of the paper.  Its half sizes do not reproduce the ROI sizes of the experiments."""

PAPER_ROIS = {"grasp": (183, 183), "knock": (112, 60), "poke": (40, 45)}
"""ROI sizes (w, h) in pixels of the paper's experiments: the means of hand-annotated boxes."""

PAPER_Z = 0.45
"""Depth of all action positions in the paper, metres (Hypothesis 3)."""


class Cuboid(NamedTuple):
    """An axis-aligned box in the camera frame, metres.  Eq. bbox."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    z_min: float
    z_max: float


class Roi(NamedTuple):
    """First and last pixel of a rectangle in the image (both inside it)."""

    left: int
    top: int
    right: int
    bottom: int


def box_of(action: Action, position: Sequence[float]) -> Cuboid:
    """The box an action can change at a position (X, Y, Z) in metres.  Below Eq. bbox."""
    (x, y, z), (dx, dy, dz) = position, action.half_size
    return Cuboid(x - dx, x + dx, y - dy, y + dy, z - dz, z + dz)


def roi_from_box(camera: Camera, box: Cuboid) -> Roi:
    """The pixels that hold the image of a box, clamped to the image.  Table RoiCorners.

    A box seen off-centre shows its near face on the side away from the optical axis and its far
    face on the other: hence the choice of depth by sign.

    Raises:
      BadPosition: the box reaches behind the camera.
    """
    if box.z_min <= 0:
        raise BadPosition(f"box reaches depth {box.z_min} m; all of it must be before the camera")

    def pixel(lateral: float, focal: float, centre: float, near: bool, count: int) -> int:
        depth = box.z_min if near else box.z_max
        return int(np.clip(np.rint(focal * lateral / depth + centre), 0, count - 1))

    fx, fy, u0, v0 = (float(x) for x in (camera.fx, camera.fy, camera.u0, camera.v0))
    return Roi(
        pixel(box.x_min, fx, u0, box.x_min < 0, camera.width),
        pixel(box.y_min, fy, v0, box.y_min < 0, camera.height),
        pixel(box.x_max, fx, u0, box.x_max >= 0, camera.width),
        pixel(box.y_max, fy, v0, box.y_max >= 0, camera.height),
    )


def roi_size(camera: Camera, action: Action, z: float = PAPER_Z) -> tuple[int, int]:
    """ROI (w, h) in pixels of an action at depth z: 2 f Δ / z, the same at every place.

    Hypothesis 3: the box is thin against its depth.
    """
    dx, dy, _ = action.half_size
    return (
        int(np.rint(2 * float(camera.fx) * dx / z)),
        int(np.rint(2 * float(camera.fy) * dy / z)),
    )


def visible_range(
    camera: Camera, action: Action, z: float = PAPER_Z
) -> tuple[tuple[float, float], tuple[float, float]]:
    """((X min, X max), (Y min, Y max)) in metres where the whole box of an action is visible.

    The unnumbered condition below Table RoiCorners, as the paper prints it: it takes the far face
    on one side and the near face on the other.  A range is empty where its minimum exceeds its
    maximum.
    """
    dx, dy, dz = action.half_size
    near, far = z - dz, z + dz

    def span(count: int, centre: float, focal: float, half: float) -> tuple[float, float]:
        return (0 - centre) * far / focal + half, (count - 1 - centre) * near / focal - half

    fx, fy, u0, v0 = (float(x) for x in (camera.fx, camera.fy, camera.u0, camera.v0))
    return span(camera.width, u0, fx, dx), span(camera.height, v0, fy, dy)


def is_visible(camera: Camera, action: Action, position: Sequence[float]) -> bool:
    """True if all of the action's box at position (X, Y, Z) is inside the image."""
    box = box_of(action, position)
    u = [float(camera.fx) * x / z + float(camera.u0) for x in box[:2] for z in box[4:]]
    v = [float(camera.fy) * y / z + float(camera.v0) for y in box[2:4] for z in box[4:]]
    inside = min(u) >= 0 and max(u) <= camera.width - 1
    return bool(box.z_min > 0 and inside and min(v) >= 0 and max(v) <= camera.height - 1)


def grid(
    camera: Camera, columns: int = 5, rows: int = 3, *, margin: tuple[int, int] = (183, 183)
) -> np.ndarray:
    """A regular grid of positions (columns * rows, 2) as (u, v), row by row.

    The paper's experiments use 15 (5 x 3) and 21 (7 x 3) positions.

    Args:
      camera: whose image the grid spans.
      columns: positions along u.
      rows: positions along v.
      margin: (w, h) in pixels of the largest ROI, which fits into the image at every position.

    Raises:
      BadPosition: that ROI is larger than the image, or more places than pixels are asked for.
    """

    def places(count: int, size: int, roi: int) -> np.ndarray:
        if not 1 <= roi <= size:
            raise BadPosition(f"a ROI of {roi} pixels does not fit into {size} pixels")
        first, last = roi // 2, size - (roi - roi // 2)
        if not isinstance(count, int | np.integer) or not 1 <= count <= last - first + 1:
            raise BadPosition(
                f"{count} places on a line of {last - first + 1} pixels where a ROI of {roi} fits"
            )
        if count == 1:
            return np.array([(first + last) // 2])
        return np.rint(np.linspace(first, last, count)).astype(int)

    u = places(columns, camera.width, margin[0])
    v = places(rows, camera.height, margin[1])
    return np.stack(np.broadcast_arrays(u[None, :], v[:, None]), -1).reshape(-1, 2).astype(np.int32)


def first_pixels(positions: np.ndarray, roi: ArrayLike) -> np.ndarray:
    """First pixels (N, 2) as (u, v) of ROIs of size (w, h), or (N, 2), centred at positions."""
    return positions - np.asarray(roi) // 2


def fits(camera: Camera, positions: np.ndarray, roi: tuple[int, int]) -> np.ndarray:
    """Which positions (N, 2) keep the whole ROI (w, h) inside the image: (N,) of bool."""
    first = first_pixels(positions, roi)
    return np.all((first >= 0) & (first + roi <= (camera.width, camera.height)), axis=-1)


def place(
    camera: Camera,
    positions: Mapping[str, np.ndarray],
    rois: Mapping[str, tuple[int, int]],
    out_of_bounds: str = "refuse",
) -> dict[str, np.ndarray]:
    """Positions whose ROIs are all inside the image, per action.

    Args:
      camera: whose image.
      positions: per action (N, 2) of (u, v), ROI centres.
      rois: per action ROI size (w, h), pixels.
      out_of_bounds: what to do with a ROI that leaves the image: "refuse" raises, "shift" moves it
        inwards, "drop" leaves that position out for that action.

    Raises:
      BadPosition: with "refuse", naming the first offenders; or a ROI larger than the image.
    """
    if out_of_bounds not in ("refuse", "shift", "drop"):
        raise UnknownName("out_of_bounds", out_of_bounds, ("refuse", "shift", "drop"))
    placed, offenders = {}, []
    for name, where in positions.items():
        (w, h), where = rois[name], np.asarray(where, np.int32).reshape(-1, 2)
        if w > camera.width or h > camera.height:
            raise BadPosition(
                f"{name}: ROI {w}x{h} is larger than the {camera.width}x{camera.height} image"
            )
        inside = fits(camera, where, (w, h))
        if out_of_bounds == "shift":
            low = np.array([w // 2, h // 2])
            where = np.clip(where, low, low + (camera.width - w, camera.height - h))
        elif out_of_bounds == "drop":
            where = where[inside]
        else:
            offenders += [f"{name} at ({u}, {v})" for u, v in where[~inside]]
        placed[name] = where
    if offenders:
        shown = ", ".join(offenders[:5]) + (", ..." if len(offenders) > 5 else "")
        raise BadPosition(
            f"{len(offenders)} ROI(s) leave the {camera.width}x{camera.height} image: {shown}; "
            "move them, or ask for the clip 'shift' or 'drop'"
        )
    return placed
