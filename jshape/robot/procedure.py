"""An action as an arm is to carry it out: six operations, one after the other.

above the place; down, the hand prepared; contact; act; up; clear of the camera's view.  A hand that
moves along the bed goes down where its path begins and up where it ends.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import Float
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
class Procedure:
    """The six operations of one action."""

    action: Annotated[str, OneLine()]
    operations: tuple[Operation, ...]
    tool_mm: _Place = (0.0, 0.0, 0.0)
    """The point of the hand that meets the place, in the flange's frame."""

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

    def problem(self) -> str | None:
        """What a file of it must not say."""
        names, length = [one.name for one in self.operations], float(np.linalg.norm(self.tool_mm))
        if names != list(NAMES):
            return f"operations are {quoted(names)}; expected {', '.join(NAMES)}, in this order"
        if 0 < length < 1:
            return f"tool_mm is {length:g} mm long; {_METRES.format(1)}"
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


@dataclass(frozen=True)
class Hand:
    """What a hand can do: procedures by action, and limits."""

    procedures: Mapping[str, Procedure]
    limits: ArmLimits = field(default_factory=ArmLimits)


def turned(yaw: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about z, from x towards y; radians."""
    return Rotation.from_euler("z", yaw).as_matrix()


def pose_of(
    operation: Operation,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
    deepest_mm: float = np.inf,
) -> Float[np.ndarray, "4 4"] | None:
    """Of the tool at the end of an operation, in the camera's frame, metres; None: it goes nowhere.

    `point` is on the surface there, `strength` a factor on the depth, which ends at `deepest_mm`
    at the latest; `yaw` turns the hand from u towards v, radians.
    """
    if operation.depth_mm is not None:
        return _below(point, operation.depth_mm * strength, yaw, deepest_mm)
    if operation.height_mm is not None:
        return _below(point, -operation.height_mm, yaw)
    return None


def _below(point: np.ndarray, depth_mm: float, yaw: float, deepest_mm: float = np.inf) -> Pose:
    """So far below a point, but not below `deepest_mm`."""
    pose = np.eye(4)
    pose[:3, :3] = turned(yaw)
    pose[:3, 3] = point
    pose[2, 3] = min(pose[2, 3] + depth_mm / 1e3, deepest_mm / 1e3)
    return pose


def poses_of(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
    length: float = 1.0,
) -> list[tuple[Operation, list[Pose]]]:
    """Each operation with the poses that it goes to: none, one, or the points of its path.

    Args:
      procedure: of the action.
      limits: strokes end above the floor.
      point: x and y of the place, and z of the surface where the hand goes down.
      strength: a factor on depths.
      yaw: turn of the hand from u towards v, radians.
      length: a factor on the path.
    """
    path, along, deepest = procedure.path(length), turned(yaw)[:, 0], limits.high_mm[2]
    ends = path[[0, -1], 0] if len(path) else np.zeros(2)
    found = []
    for one in procedure.operations:
        if one.path_mm is not None:
            poses = [_below(point + x * along, 1e3 * z * strength, yaw, deepest) for x, z in path]
        else:
            there = point + ends[int(one.name == "up")] * along
            pose = pose_of(one, there, strength, yaw, deepest)
            poses = [] if pose is None else [pose]
        found.append((one, poses))
    return found


def check_reach(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
    length: float = 1.0,
) -> None:
    """Whether all of an action stays inside the limits, before the arm moves.

    Raises:
      PoseRefused: it leaves the workspace, is too fast, trips above the hard limit, or has a
        strength, yaw or length that makes no sense.
    """
    if not (np.isfinite(point).all() and np.isfinite(yaw) and 0 < strength <= DEEPEST):
        raise PoseRefused(
            f"{procedure.action}: at {point} m, strength {strength:g}, yaw {yaw:g} rad; a strength "
            f"is above 0 and at most {DEEPEST:g}, and all are finite"
        )
    if not 0 < length <= LONGEST:
        said = f"{procedure.action}: its path {length:g} times as long"
        raise PoseRefused(f"{said}; a length is above 0 and at most {LONGEST:g}")
    if length != 1 and not len(procedure.path()):
        said = f"{procedure.action}: its act has no path_mm"
        raise PoseRefused(f"{said}, so it cannot be {length:g} times as long")
    for operation, poses in poses_of(procedure, limits, point, strength, yaw, length):
        where = f"{procedure.action}: {operation.name}"
        for what, value, most in (
            ("speed {:g} mm/s", operation.speed_mm_s, limits.speed_mm_s),
            ("threshold {:g} Nm", operation.effort_nm, limits.effort_nm),
        ):
            if value > most:
                raise PoseRefused(f"{where}: {what.format(value)}; at most {most:g}")
        for pose in poses:
            at = pose[:3, 3] * 1000.0
            if not ((at >= limits.low_mm) & (at <= limits.high_mm)).all():
                text = "({:.0f}, {:.0f}, {:.0f})".format
                raise PoseRefused(
                    f"{where} goes to {text(*at)} mm in the camera's frame; "
                    f"the workspace is {text(*limits.low_mm)} to {text(*limits.high_mm)}"
                )
