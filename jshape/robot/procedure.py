"""An action as an arm is to carry it out: six operations, one after the other.

above the place; down, the hand prepared; contact; act; up; clear of the camera's view.  A hand that
moves along the bed goes down where its path begins and up where it ends.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import ArrayLike, Float
from jshape.actions import PAPER_Z
from jshape.camera import Camera
from jshape.errors import quoted
from jshape.io.records import OneLine, Range
from jshape.robot.arms.base import PoseRefused
from jshape.robot.rigid import Pose

NAMES = ("above", "prepare", "contact", "act", "up", "clear")
"""The six operations, in order."""
IN_THE_AIR = ("above", "up")
"""Operations that touch nothing: a contact there is a collision, and ends the action."""
DEEPEST = 10.0
"""Greatest strength of an action: more than any bed is deep."""
LONGEST = 10.0
"""Greatest length of an action's path, as a multiple of its own: more than any bed is wide."""
POINTS = 8
"""Most points of a path."""
AROUND = 3
"""The surface at a place is the median over so many pixels to each side."""

REACH_MM = 2000.0
"""No arm's tool is farther than this from anything, mm."""
ROOM_MM = 20.0
"""Limits with less room than this are in metres."""
_Place = Annotated[tuple[float, float, float], Range(-REACH_MM, REACH_MM)]
_Point = Annotated[tuple[float, float], Range(-REACH_MM, REACH_MM)]
_Speed = Annotated[float, Range(0, 2000, above=True, metres_below=1)]
_Effort = Annotated[float, Range(0, 1000, above=True)]
_METRES = "less than {:g} mm looks like metres: times 1000"


@dataclass(frozen=True)
class Operation:
    """One of the six."""

    name: str
    height_mm: Annotated[float | None, Range(-REACH_MM, REACH_MM, metres_below=1)] = None
    """Where the tool goes: above the surface at the place; below it where negative."""
    depth_mm: Annotated[float | None, Range(0, REACH_MM, above=True, metres_below=0.1)] = None
    """Where the tool goes instead: below the surface, times the strength of the action."""
    path_mm: tuple[_Point, ...] | None = None
    """Where the tool goes instead, in straight lines from the first (x, depth) to the last: x along
    the hand from the place, times the length of the action about the middle of the two ends; depth
    below the surface where the path begins, times the strength."""
    posture: Annotated[str | None, OneLine()] = None
    """What the hand does, once the tool is there."""
    speed_mm_s: _Speed = 100.0
    """Of the tool."""
    seconds: Annotated[float, Range(0, 60, above=True)] = 0.5
    """That the posture takes."""
    effort_nm: _Effort = 40.0
    """Contact effort that ends the operation."""

    def problem(self) -> str | None:
        """What a file of it must not say."""
        if self.name == "clear" and self != Operation("clear"):
            return "the arm goes home, there is nothing else to say of it"
        if self.name in IN_THE_AIR and not (self.height_mm or 0.0) > 0:
            return "needs a height_mm above 0: the tool touches nothing there"
        if self.path_mm is not None and self.name != "act":
            return "path_mm is for act alone: the others go where it begins or ends"
        ways = "height_mm", "depth_mm", "path_mm"
        given = [way for way in ways if getattr(self, way) is not None]
        if len(given) > 1:
            return f"{' and '.join(given)} are both given; one says where the tool is"
        return None if self.path_mm is None else self._path_problem(np.array(self.path_mm))

    def ways(self, path: Float[np.ndarray, "P 2"], strength: float) -> list[tuple[float, float]]:
        """(x along the hand, depth) of the points that the tool goes to, metres from the place.

        `path` is that of the action's act; where it begins and ends the others go down and up.
        """
        if self.path_mm is not None:
            return [(x, depth * strength) for x, depth in path]
        x = path[-1 if self.name == "up" else 0, 0] if len(path) else 0.0
        if self.depth_mm is not None:
            return [(x, self.depth_mm / 1e3 * strength)]
        return [] if self.height_mm is None else [(x, -self.height_mm / 1e3)]

    def _path_problem(self, path: np.ndarray) -> str | None:
        if not 2 <= len(path) <= POINTS:
            return f"path_mm has {len(path)} points; expected 2 to {POINTS} of [x, depth]"
        x, depth = path.T
        if (back := np.flatnonzero(np.diff(x) <= 0)).size:
            one, other = x[back[0] : back[0] + 2]
            return f"path_mm goes from x {one:g} to {other:g}; each point is ahead of the last"
        if depth.min() < 0 or depth.max() == 0:
            return f"path_mm goes {depth.tolist()} mm deep; depths are from 0, one of them above"
        if x[-1] - x[0] < 1:
            return f"path_mm is {x[-1] - x[0]:g} mm long; {_METRES.format(1)}"
        if depth.max() < 0.1:
            return f"path_mm is {depth.max():g} mm deep; {_METRES.format(0.1)}"
        return None


@dataclass(frozen=True)
class ArmLimits:
    """What no operation may exceed, whatever its file says."""

    low_mm: _Place = (-400.0, -400.0, 150.0)
    """Lowest x, y, z of the tool in the camera's frame."""
    high_mm: _Place = (400.0, 400.0, 498.0)
    """Highest: z is how far below the camera the tool may go.  A stroke that would go deeper ends
    there; the floor of the paper's box is at 500."""
    speed_mm_s: _Speed = 250.0
    """Fastest motion of the tool, the limit of collaborative work (ISO 10218-1, 5.6.2)."""
    effort_nm: _Effort = 120.0
    """Contact effort at which the arm is stopped for good."""

    def problem(self) -> str | None:
        """What a file of it must not say."""
        room = np.subtract(self.high_mm, self.low_mm)
        if not (room > 0).all():
            return f"low_mm {self.low_mm} is not below high_mm {self.high_mm}"
        if room.max() < ROOM_MM:
            return f"low_mm to high_mm is {room.max():g} mm at most; {_METRES.format(ROOM_MM)}"
        return None

    def check(self, operation: Operation, poses: Sequence[Pose], where: str) -> None:
        """PoseRefused where an operation is too fast, trips too late or leaves the workspace."""
        for what, value, most in (
            ("speed {:g} mm/s", operation.speed_mm_s, self.speed_mm_s),
            ("threshold {:g} Nm", operation.effort_nm, self.effort_nm),
        ):
            if value > most:
                raise PoseRefused(f"{where}: {what.format(value)}; at most {most:g}")
        for pose in poses:
            at = pose[:3, 3] * 1000.0
            if not ((at >= self.low_mm) & (at <= self.high_mm)).all():
                text = "({:.0f}, {:.0f}, {:.0f})".format
                raise PoseRefused(
                    f"{where} goes to {text(*at)} mm in the camera's frame; "
                    f"the workspace is {text(*self.low_mm)} to {text(*self.high_mm)}"
                )


@dataclass(frozen=True)
class Procedure:
    """The six operations of one action."""

    action: Annotated[str, OneLine()]
    operations: tuple[Operation, ...]
    tool_mm: _Place = (0.0, 0.0, 0.0)
    """The point of the hand that meets the place, in the flange's frame."""

    @property
    def tool(self) -> Pose:
        """The pose of that point in the flange's frame, metres; its axes are the flange's."""
        pose = np.eye(4)
        pose[:3, 3] = np.asarray(self.tool_mm) / 1000.0
        return pose

    def path(self, length: float = 1.0) -> Float[np.ndarray, "P 2"]:
        """(x, depth) of the act's path, metres; no points where it has none."""
        found = [one.path_mm for one in self.operations if one.path_mm is not None]
        path = np.array(found[0] if found else np.zeros((0, 2)), float) / 1e3
        if len(path):
            middle = path[[0, -1], 0].mean()
            path[:, 0] = middle + length * (path[:, 0] - middle)
        return path

    def begins(self, yaw: float = 0.0, length: float = 1.0) -> Float[np.ndarray, "2"]:
        """(x, y) from the place to where the hand goes down, metres in the camera's frame."""
        path = self.path(length)
        return turned(yaw)[:2, 0] * (path[0, 0] if len(path) else 0.0)

    def poses(
        self,
        limits: ArmLimits,
        point: Float[np.ndarray, "3"],
        strength: float = 1.0,
        yaw: float = 0.0,
        length: float = 1.0,
    ) -> list[tuple[Operation, list[Pose]]]:
        """Each operation with the poses of the tool that it goes to, camera's frame, metres.

        None, one, or the points of its path.

        Args:
          limits: a stroke ends at the far end of the workspace.
          point: x and y of the place, and z of the surface where the hand goes down, metres.
          strength: a factor on depths.
          yaw: turn of the hand from u towards v, radians.
          length: a factor on the path.

        Raises:
          PoseRefused: it leaves the workspace, is too fast, trips above the hard limit, or has a
            strength, yaw or length that makes no sense.
        """
        if not (np.isfinite(point).all() and np.isfinite(yaw) and 0 < strength <= DEEPEST):
            raise PoseRefused(
                f"{self.action}: at {point} m, strength {strength:g}, yaw {yaw:g} rad; a strength "
                f"is above 0 and at most {DEEPEST:g}, and all are finite"
            )
        if not 0 < length <= LONGEST:
            said = f"{self.action}: its path {length:g} times as long"
            raise PoseRefused(f"{said}; a length is above 0 and at most {LONGEST:g}")
        path = self.path(length)
        if length != 1 and not len(path):
            said = f"{self.action}: its act has no path_mm"
            raise PoseRefused(f"{said}, so it cannot be {length:g} times as long")
        found = []
        for one in self.operations:
            poses = []
            for x, depth in one.ways(path, strength):
                pose = np.eye(4)
                pose[:3, :3] = turned(yaw)
                pose[:3, 3] = point + x * pose[:3, 0]
                pose[2, 3] += depth
                if one.height_mm is None:
                    pose[2, 3] = min(pose[2, 3], limits.high_mm[2] / 1000.0)
                poses.append(pose)
            limits.check(one, poses, f"{self.action}: {one.name}")
            found.append((one, poses))
        return found

    def problem(self) -> str | None:
        """What a file of it must not say."""
        names, length = [one.name for one in self.operations], float(np.linalg.norm(self.tool_mm))
        if names != list(NAMES):
            return f"operations are {quoted(names)}; expected {', '.join(NAMES)}, in this order"
        if 0 < length < 1:
            return f"tool_mm is {length:g} mm long; {_METRES.format(1)}"
        return None


@dataclass(frozen=True)
class Hand:
    """What a hand can do: procedures by action, and limits."""

    procedures: Mapping[str, Procedure]
    limits: ArmLimits = field(default_factory=ArmLimits)


def turned(yaw: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about z, from x towards y; radians."""
    return Rotation.from_euler("z", yaw).as_matrix()


def surface_point(
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    position: ArrayLike,
    *,
    place_depth: float = PAPER_Z,
    beside: ArrayLike = (0.0, 0.0),
) -> Float[np.ndarray, "3"]:
    """The point of the surface under a place, metres, in the frame of the bank's camera.

    A place (u, v) is the pixel of a point at one depth for all (Hypothesis 3), which gives its x
    and y.  The surface there may be nearer or farther, and is then seen at another pixel.

    Args:
      depth: what the bank's camera sees, metres, without gaps.
      camera: the bank's.
      position: (u, v) pixels, whole or not.
      place_depth: depth at which places are meant, metres.
      beside: (x, y) from the place to where the surface is looked up instead, metres: there a hand
        that goes along a path goes down.
    """
    u, v = np.asarray(position, np.float64)
    x, y = camera.at(u, v, place_depth)
    z, (dx, dy) = place_depth, np.asarray(beside, np.float64)
    for _ in range(4):  # the surface's slope is well below 1: each round halves the error
        column, row = (int(np.rint(at)) for at in camera.pixel(x + dx, y + dy, z))
        column, row = min(max(column, 0), camera.width - 1), min(max(row, 0), camera.height - 1)
        rows, columns = (slice(max(at - AROUND, 0), at + AROUND + 1) for at in (row, column))
        z = float(np.median(depth[rows, columns]))
    return np.array([x, y, z])
