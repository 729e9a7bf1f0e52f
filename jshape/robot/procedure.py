"""An action as an arm carries it out: six operations, one after the other.

above the place; down, the hand prepared; contact; act; up; clear of the camera's view.  An effort
above an operation's threshold ends that operation and goes on to the next, as in the paper.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import Float
from jshape.errors import quoted
from jshape.io.records import OneLine, Range
from jshape.robot.arms.base import Arm, ArmError, Doing, EffortLimit, Moved, PoseRefused, stop_arm

NAMES = ("above", "prepare", "contact", "act", "up", "clear")
"""The six operations, in order."""
IN_THE_AIR = ("above", "up")
"""Operations that touch nothing: a contact there is a collision, and ends the action."""
DEEPEST = 10.0
"""Greatest strength of an action: more than any bed is deep."""


REACH_MM = 2000.0
"""No arm's tool is farther than this from anything, mm."""
ROOM_MM = 20.0
"""Limits with less room than this are in metres."""
_Place = Annotated[tuple[float, float, float], Range(-REACH_MM, REACH_MM)]
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
        if self.height_mm is not None and self.depth_mm is not None:
            return "height_mm and depth_mm are both given; one says where the tool is"
        return None


@dataclass(frozen=True)
class Procedure:
    """The six operations of one action."""

    action: Annotated[str, OneLine()]
    operations: tuple[Operation, ...]
    tool_mm: _Place = (0.0, 0.0, 0.0)
    """The point of the hand that meets the place, in the flange's frame."""

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


class OperationResult(NamedTuple):
    """How an operation ended."""

    operation: str
    contact: bool
    """The effort ended it."""
    effort_nm: float
    """The greatest on the way."""
    tool_mm: tuple[float, float, float]
    """Where the tool ended, in the camera's frame."""


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
    pose = np.eye(4)
    pose[:3, :3] = turned(yaw)
    pose[:3, 3] = point
    if operation.depth_mm is not None:
        pose[2, 3] = min(pose[2, 3] + operation.depth_mm * strength / 1e3, deepest_mm / 1e3)
    elif operation.height_mm is not None:
        pose[2, 3] -= operation.height_mm / 1e3
    else:
        return None
    return pose


def poses_of(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> list[tuple[Operation, Float[np.ndarray, "4 4"] | None]]:
    """Each operation with the pose where it ends: see `pose_of`; strokes end above the floor."""
    how = (point, strength, yaw, limits.high_mm[2])
    return [(one, pose_of(one, *how)) for one in procedure.operations]


def check_reach(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> None:
    """Whether all of an action stays inside the limits, before the arm moves.

    Raises:
      PoseRefused: it leaves the workspace, is too fast, trips above the hard limit, or has a
        strength or yaw that makes no sense.
    """
    if not (np.isfinite(point).all() and np.isfinite(yaw) and 0 < strength <= DEEPEST):
        raise PoseRefused(
            f"{procedure.action}: at {point} m, strength {strength:g}, yaw {yaw:g} rad; a strength "
            f"is above 0 and at most {DEEPEST:g}, and all are finite"
        )
    for operation, pose in poses_of(procedure, limits, point, strength, yaw):
        where = f"{procedure.action}: {operation.name}"
        for what, value, most in (
            ("speed {:g} mm/s", operation.speed_mm_s, limits.speed_mm_s),
            ("threshold {:g} Nm", operation.effort_nm, limits.effort_nm),
        ):
            if value > most:
                raise PoseRefused(f"{where}: {what.format(value)}; at most {most:g}")
        if pose is None:
            continue
        at = pose[:3, 3] * 1000.0
        if not ((at >= limits.low_mm) & (at <= limits.high_mm)).all():
            text = "({:.0f}, {:.0f}, {:.0f})".format
            raise PoseRefused(
                f"{where} goes to {text(*at)} mm in the camera's frame; "
                f"the workspace is {text(*limits.low_mm)} to {text(*limits.high_mm)}"
            )


def perform(
    arm: Arm,
    hand: Hand,
    action: str,
    point: Float[np.ndarray, "3"],
    base_camera: Float[np.ndarray, "4 4"],
    *,
    strength: float = 1.0,
    yaw: float = 0.0,
    on_operation: Callable[[OperationResult], None] = lambda done: None,
) -> list[OperationResult]:
    """Carry an action out as `prepare` has it; `on_operation` is called after each operation.

    Any failure, Ctrl-C included, stops the arm before the error is passed on.

    Raises:
      PoseRefused: it leaves the workspace or what the arm can reach; the arm has not moved.
      ArmError: the arm did not do it, touched something in the air, or has no such procedure.
      EffortLimit: the effort rose above the hard limit.
    """
    tool, operations = prepare(arm, hand, action, point, base_camera, strength, yaw)
    camera_base = np.linalg.inv(base_camera)
    all_done = []
    try:
        for operation, pose in operations:
            arm.begin(Doing(action, operation.name, strength, yaw), tool)
            contact, effort = _one(arm, operation, pose, f"{action}: {operation.name}", hand.limits)
            x, y, z = ((camera_base @ arm.pose())[:3, 3] * 1000.0).tolist()
            done = OperationResult(operation.name, contact, effort, (x, y, z))
            all_done.append(done)
            on_operation(done)
    except BaseException:
        stop_arm(arm)
        raise
    return all_done


def prepare(
    arm: Arm,
    hand: Hand,
    action: str,
    point: Float[np.ndarray, "3"],
    base_camera: Float[np.ndarray, "4 4"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> tuple[Float[np.ndarray, "4 4"], list[tuple[Operation, Float[np.ndarray, "4 4"] | None]]]:
    """Check an action at a point of the surface (camera's frame, metres); the arm does not move.

    Returns:
      The pose of the tool in the flange's frame, and the operations with the tool's poses in the
      base frame, None for one that goes nowhere.

    Raises:
      PoseRefused, ArmError: as for `perform`.
    """
    if action not in hand.procedures:
        raise ArmError(f"the hand cannot {action}; it can: {', '.join(hand.procedures)}")
    procedure, limits = hand.procedures[action], hand.limits
    check_reach(procedure, limits, point, strength, yaw)
    tool = np.eye(4)
    tool[:3, 3] = np.asarray(procedure.tool_mm) / 1000.0
    seen = poses_of(procedure, limits, point, strength, yaw)
    operations = [(one, None if pose is None else base_camera @ pose) for one, pose in seen]
    arm.limit(effort=limits.effort_nm, speed=limits.speed_mm_s / 1000.0)
    poses = [pose for _, pose in operations if pose is not None]
    arm.check(poses, [one.posture for one in procedure.operations if one.posture], tool)
    return tool, operations


def _one(
    arm: Arm, operation: Operation, pose: np.ndarray | None, where: str, limits: ArmLimits
) -> tuple[bool, float]:
    """Whether the effort ended an operation, and the greatest effort."""

    def judged(moved: Moved) -> tuple[bool, float]:
        said = f"{where}: effort {moved.effort:.0f} Nm"
        if not 0 <= moved.effort <= limits.effort_nm:  # NaN too
            raise EffortLimit(f"{said}; the hard limit is {limits.effort_nm:g}")
        if moved.contact and operation.name in IN_THE_AIR:
            raise ArmError(f"{said}: something is in the way")
        return moved.contact, moved.effort

    if operation.name == "clear":
        return judged(arm.home())
    contact, effort = False, 0.0
    if pose is not None:
        speed = operation.speed_mm_s / 1000.0
        contact, effort = judged(arm.move(pose, speed=speed, threshold=operation.effort_nm))
    if (name := operation.posture) is not None:
        # A hand that touches something on its way down still closes: it is what the action does.
        most = operation.effort_nm
        touched, more = judged(arm.posture(name, seconds=operation.seconds, threshold=most))
        contact, effort = contact or touched, max(effort, more)
    return contact, effort
