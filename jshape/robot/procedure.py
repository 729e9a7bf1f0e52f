"""An action as an arm carries it out: six operations, one after the other.

above the place; down, the hand prepared; contact; act; up; clear of the camera's view.  An effort
above an operation's threshold ends that operation and goes on to the next, as in the paper.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jshape._typing import Float
from jshape.robot.arms.base import Arm, ArmError, Doing, EffortLimit, Moved, PoseRefused, stop_arm

NAMES = ("above", "prepare", "contact", "act", "up", "clear")
"""The six operations, in order."""
IN_THE_AIR = ("above", "up")
"""Operations that touch nothing: a contact there is a collision, and ends the action."""
DEEPEST = 10.0
"""Greatest strength of an action: more than any bed is deep."""


@dataclass(frozen=True)
class Operation:
    """One of the six."""

    name: str
    height_mm: float | None = None
    """Where the tool goes: above the surface at the place; below it where negative."""
    depth_mm: float | None = None
    """Where the tool goes instead: below the surface, times the strength of the action."""
    posture: str | None = None
    """What the hand does, once the tool is there."""
    speed_mm_s: float = 100.0
    """Of the tool."""
    seconds: float = 0.5
    """That the posture takes."""
    effort_nm: float = 40.0
    """Contact effort that ends the operation."""


@dataclass(frozen=True)
class Procedure:
    """The six operations of one action."""

    action: str
    operations: tuple[Operation, ...]
    tool_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point of the hand that meets the place, in the flange's frame."""


@dataclass(frozen=True)
class ArmLimits:
    """What no operation may exceed, whatever its file says."""

    low_mm: tuple[float, float, float] = (-400.0, -400.0, 150.0)
    """Lowest x, y, z of the tool in the camera's frame."""
    high_mm: tuple[float, float, float] = (400.0, 400.0, 498.0)
    """Highest: z is how far below the camera the tool may go.  A stroke that would go deeper ends
    there; the floor of the paper's box is at 500."""
    speed_mm_s: float = 250.0
    """Fastest motion of the tool, the limit of collaborative work (ISO 10218-1, 5.6.2)."""
    effort_nm: float = 120.0
    """Contact effort at which the arm is stopped for good."""


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

    Args:
      operation: gives the height or the depth.
      point: on the surface, camera frame, metres.
      strength: factor on the depth.
      yaw: turn of the hand from u towards v, radians.
      deepest_mm: a depth ends there at the latest: above the floor of the box.
    """
    if operation.depth_mm is not None:
        down = operation.depth_mm * strength
    elif operation.height_mm is not None:
        down = -operation.height_mm
    else:
        return None
    pose = np.eye(4)
    pose[:3, :3] = turned(yaw)
    pose[:3, 3] = point + np.array([0.0, 0.0, down / 1000.0])
    if operation.depth_mm is not None:
        pose[2, 3] = min(pose[2, 3], deepest_mm / 1000.0)
    return pose


def poses_of(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> list[tuple[Operation, Float[np.ndarray, "4 4"] | None]]:
    """Each operation with the pose where it ends: see `pose_of`; strokes end above the floor."""
    deepest = limits.high_mm[2]
    return [(one, pose_of(one, point, strength, yaw, deepest)) for one in procedure.operations]


def check_reach(
    procedure: Procedure,
    limits: ArmLimits,
    point: Float[np.ndarray, "3"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> None:
    """Whether all of an action stays inside the limits, before the arm moves.

    Raises:
      PoseRefused: an operation leaves the workspace, is too fast or trips above the hard limit; a
        strength or yaw that makes no sense.
    """
    if not (np.isfinite(point).all() and np.isfinite(yaw) and 0 < strength <= DEEPEST):
        raise PoseRefused(
            f"{procedure.action}: at {point} m, strength {strength:g}, yaw {yaw:g} rad; a strength "
            f"is above 0 and at most {DEEPEST:g}, and all are finite"
        )
    for operation, pose in poses_of(procedure, limits, point, strength, yaw):
        where = f"{procedure.action}: {operation.name}"
        if operation.speed_mm_s > limits.speed_mm_s:
            raise PoseRefused(
                f"{where}: speed {operation.speed_mm_s:g} mm/s; at most {limits.speed_mm_s:g}"
            )
        if operation.effort_nm > limits.effort_nm:
            raise PoseRefused(
                f"{where}: threshold {operation.effort_nm:g} Nm; at most {limits.effort_nm:g}"
            )
        if pose is None:
            continue
        at = pose[:3, 3] * 1000.0
        if not ((at >= limits.low_mm) & (at <= limits.high_mm)).all():
            raise PoseRefused(
                f"{where} goes to {_text(at)} mm in the camera's frame; "
                f"the workspace is {_text(limits.low_mm)} to {_text(limits.high_mm)}"
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
    told: Callable[[OperationResult], None] = lambda done: None,
) -> list[OperationResult]:
    """Carry an action out.

    Any failure, Ctrl-C included, stops the arm before the error is passed on.

    Args:
      arm: does it.
      hand: its procedures and limits.
      action: name.
      point: (3,) on the surface in the camera's frame, metres.
      base_camera: pose of the camera in the arm's base frame.
      strength: factor on the depth.
      yaw: turn of the hand from u towards v, radians.
      told: called after each operation.

    Raises:
      PoseRefused: it leaves the workspace or what the arm can reach; the arm has not moved.
      ArmError: the arm did not do it, touched something in the air, or has no such procedure.
      EffortLimit: the effort rose above the hard limit.
    """
    prepared = prepare(arm, hand, action, point, base_camera, strength, yaw)
    camera_base = np.linalg.inv(base_camera)
    all_done = []
    try:
        for operation, pose in prepared.operations:
            arm.begin(Doing(action, operation.name, strength, yaw), prepared.tool)
            contact, effort = _one(arm, operation, pose, f"{action}: {operation.name}", hand.limits)
            x, y, z = ((camera_base @ arm.pose())[:3, 3] * 1000.0).tolist()
            done = OperationResult(operation.name, contact, effort, (x, y, z))
            all_done.append(done)
            told(done)
    except BaseException:
        stop_arm(arm)
        raise
    return all_done


class Prepared(NamedTuple):
    """An action at a place, checked."""

    tool: np.ndarray
    """(4, 4) pose of the tool in the flange's frame."""
    operations: list[tuple[Operation, np.ndarray | None]]
    """Each with the tool's pose (4, 4) in the base frame; None: it goes nowhere."""


def prepare(
    arm: Arm,
    hand: Hand,
    action: str,
    point: Float[np.ndarray, "3"],
    base_camera: Float[np.ndarray, "4 4"],
    strength: float = 1.0,
    yaw: float = 0.0,
) -> Prepared:
    """All poses of an action, checked against the limits and by the arm, which does not move.

    Raises:
      PoseRefused, ArmError: as for `perform`.
    """
    if action not in hand.procedures:
        raise ArmError(f"the hand cannot {action}; it can: {', '.join(hand.procedures)}")
    procedure, limits = hand.procedures[action], hand.limits
    check_reach(procedure, limits, point, strength, yaw)
    tool = np.eye(4)
    tool[:3, 3] = np.asarray(procedure.tool_mm) / 1000.0
    operations = [
        (operation, None if pose is None else base_camera @ pose)
        for operation, pose in poses_of(procedure, limits, point, strength, yaw)
    ]
    arm.limit(effort=limits.effort_nm, speed=limits.speed_mm_s / 1000.0)
    poses = [pose for _, pose in operations if pose is not None]
    arm.check(poses, [one.posture for one in procedure.operations if one.posture], tool)
    return Prepared(tool, operations)


def _one(
    arm: Arm, operation: Operation, pose: np.ndarray | None, where: str, limits: ArmLimits
) -> tuple[bool, float]:
    """Whether the effort ended an operation, and the greatest effort."""

    def judged(moved: Moved) -> tuple[bool, float]:
        if not 0 <= moved.effort <= limits.effort_nm:  # NaN too
            raise EffortLimit(
                f"{where}: effort {moved.effort:.0f} Nm; the hard limit is {limits.effort_nm:g}"
            )
        if moved.contact and operation.name in IN_THE_AIR:
            raise ArmError(f"{where}: effort {moved.effort:.0f} Nm: something is in the way")
        return moved.contact, moved.effort

    if operation.name == "clear":
        return judged(arm.home())
    contact, effort = False, 0.0
    if pose is not None:
        speed = operation.speed_mm_s / 1000.0
        contact, effort = judged(arm.move(pose, speed=speed, threshold=operation.effort_nm))
    if operation.posture is not None:
        # A hand that touches something on its way down still closes: it is what the action does.
        touched, more = judged(
            arm.posture(operation.posture, seconds=operation.seconds, threshold=operation.effort_nm)
        )
        contact, effort = contact or touched, max(effort, more)
    return contact, effort


def _text(values) -> str:
    return "(" + ", ".join(f"{value:.0f}" for value in values) + ")"
