"""Actions, the image region each can change, and the places where they can be applied.

Pixels are 0-based `(u, v)`; the paper counts from 1.
A ROI is `(w, h)` pixels; centred at `(u, v)` its first pixel is `(u - w // 2, v - h // 2)`.
Host code: NumPy, small, and it raises.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jshape._typing import ArrayLike, Float
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


Place = tuple[float | int, float | int]
"""(u, v) pixels, whole or not."""


@dataclass(frozen=True)
class PlacedAction:
    """An action where and how it is to be done, or was done."""

    action: str
    """Its name."""
    position: Place
    """(u, v) pixels, whole or not."""
    strength: float = 1.0
    """How many times as deep as the trained action."""
    yaw: float = 0.0
    """Turn of the hand from u towards v, radians."""
    length: float = 1.0
    """How many times as long as the trained action's the hand's path is."""
    stroke: tuple[float, float] = (0.0, 0.0)
    """Displacement (u, v), pixels: of an action that moves along a line, from the start of its path
    to its end, the place in the middle; of one that takes material out, to where the next action
    brings it; 0 for all others."""
    roi: tuple[int, int] | None = None
    """(w, h) pixels of what it changes; None: not known."""
    carries: bool = False
    """It takes material to where the next action brings it."""

    @property
    def how(self) -> dict[str, float]:
        """Strength, yaw and length, as far as they are not the trained action's."""
        usual = {"strength": 1.0, "yaw": 0.0, "length": 1.0}
        return {name: getattr(self, name) for name in usual if getattr(self, name) != usual[name]}

    @property
    def ends(self) -> Float[np.ndarray, "2 2"]:
        """Where its stroke starts and ends, (u, v); twice the place without one."""
        start = np.array(self.position) - (0.0 if self.carries else 0.5) * np.array(self.stroke)
        return np.stack([start, start + self.stroke])

    @property
    def outline(self) -> Float[np.ndarray, "4 2"]:
        """Corners (u, v) of its ROI, turned as the hand is."""
        assert self.roi is not None
        half = np.array(self.roi) * [[-1, -1], [1, -1], [1, 1], [-1, 1]] / 2
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return half @ np.array([[cos, sin], [-sin, cos]]) + self.position

    def stroke_mm(self, camera: Camera) -> Float[np.ndarray, "2"]:
        """Its stroke in mm along u and v, in the middle of the camera's range."""
        per_metre = camera.scale((float(camera.z_min) + float(camera.z_max)) / 2)
        return 1e3 * np.array(self.stroke) / np.array([float(f) for f in per_metre])

    @property
    def deep(self) -> str:
        """Its strength, to be said after its name unless it is 1: " x0.5"."""
        rounded = f"{round(self.strength, 2):g}"
        return "" if rounded == "1" else f" x{rounded}"

    def words(self, camera: Camera, at: str = "") -> str:
        """In one line: "press x0.5 (312, 91), yaw 30°"; `at` says its place otherwise."""
        u, v = self.position
        said = f"{self.action}{self.deep} {at or f'({u:.0f}, {v:.0f})'}"
        said += f", yaw {np.degrees(self.yaw):.0f}°" if self.yaw else ""
        mm = float(np.linalg.norm(self.stroke_mm(camera)))
        way = f", taken {mm:.0f} mm to the next" if self.carries else f", {mm:.0f} mm long"
        return said + (way if mm else "")


def linked(actions: Iterable[PlacedAction], within: float = 0.01) -> tuple[PlacedAction, ...]:
    """A sequence in which those say so that carry material: their strokes end at the next place.

    `within` is how exact the positions are, pixels.
    """
    found = list(actions)
    for k, (one, after) in enumerate(pairwise(found)):
        off = np.abs(np.subtract(after.position, one.position) - one.stroke)
        found[k] = replace(one, carries=bool(any(one.stroke) and off.max() < within))
    return tuple(found)


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


def roi_size(camera: Camera, action: Action, z: float = PAPER_Z) -> tuple[int, int]:
    """ROI (w, h) in pixels of an action at depth z: 2 f Δ / z, the same at every place.

    Hypothesis 3: the box is thin against its depth.
    """
    dx, dy, _ = action.half_size
    return (
        int(np.rint(2 * float(camera.fx) * dx / z)),
        int(np.rint(2 * float(camera.fy) * dy / z)),
    )


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
            "move them, or set out_of_bounds (--out-of-bounds) to 'shift' or 'drop'"
        )
    return placed
