"""An action carried out: its operations one after the other, judged by the efforts they meet.

An effort above an operation's threshold ends that operation and goes on to the next, as in the
paper; the rest of a path that it ends is not gone.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.robot.arms.base import Arm, ArmError, Doing, EffortLimit, Moved, stop_arm
from jshape.robot.procedure import IN_THE_AIR, ArmLimits, Hand, Operation
from jshape.robot.rigid import Pose


class OperationResult(NamedTuple):
    """How an operation ended."""

    operation: str
    contact: bool
    """The effort ended it."""
    effort_nm: float
    """The greatest on the way."""
    tool_mm: tuple[float, float, float]
    """Where the tool ended, in the camera's frame."""


def perform(
    arm: Arm,
    hand: Hand,
    action: str,
    point: Float[np.ndarray, "3"],
    base_camera: Float[np.ndarray, "4 4"],
    strength: float = 1.0,
    yaw: float = 0.0,
    length: float = 1.0,
    *,
    on_operation: Callable[[OperationResult], None] = lambda done: None,
    only_check: bool = False,
) -> list[OperationResult]:
    """Carry an action out at a point of the surface, once all of it is checked.

    Any failure, Ctrl-C included, stops the arm before the error is passed on.

    Args:
      arm: does it.
      hand: procedures and limits.
      action: its name.
      point: as for `Procedure.poses`, like strength, yaw and length.
      base_camera: pose of the point's camera in the arm's base frame, metres.
      strength: a factor on depths.
      yaw: turn of the hand from u towards v, radians.
      length: a factor on the path.
      on_operation: called after each operation.
      only_check: the arm does not move.

    Raises:
      PoseRefused: it leaves the workspace or what the arm can reach; the arm has not moved.
      ArmError: the arm did not do it, touched something in the air, or has no such procedure.
      EffortLimit: the effort rose above the hard limit.
    """
    if action not in hand.procedures:
        raise ArmError(f"the hand cannot {action}; it can: {', '.join(hand.procedures)}")
    procedure, limits = hand.procedures[action], hand.limits
    seen = procedure.poses(limits, point, strength, yaw, length)
    operations = [(one, [base_camera @ pose for pose in poses]) for one, poses in seen]
    arm.limit(effort=limits.effort_nm, speed=limits.speed_mm_s / 1000.0)
    every = [pose for _, poses in operations for pose in poses]
    arm.check(every, [one.posture for one, _ in seen if one.posture], procedure.tool)
    if only_check:
        return []
    path = procedure.path(length)
    way = float(path[-1, 0] - path[0, 0]) if len(path) else 0.0
    camera_base = np.linalg.inv(base_camera)
    all_done = []
    try:
        for operation, poses in operations:
            arm.begin(Doing(action, operation.name, strength, yaw, length, way), procedure.tool)
            where = f"{action}: {operation.name}"
            contact, effort = _one(arm, operation, poses, where, limits)
            x, y, z = ((camera_base @ arm.pose())[:3, 3] * 1000.0).tolist()
            done = OperationResult(operation.name, contact, effort, (x, y, z))
            all_done.append(done)
            on_operation(done)
    except BaseException:
        stop_arm(arm)
        raise
    return all_done


def _one(
    arm: Arm, operation: Operation, poses: Sequence[Pose], where: str, limits: ArmLimits
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

    def shaped() -> tuple[bool, float]:
        if operation.posture is None:
            return False, 0.0
        how = {"seconds": operation.seconds, "threshold": operation.effort_nm}
        return judged(arm.posture(operation.posture, **how))

    # Far from the bed first: fingers that the action before stretched out could touch it.
    early = operation.name == "above"
    contact, effort = shaped() if early else (False, 0.0)
    for pose in poses:
        how = {"speed": operation.speed_mm_s / 1000.0, "threshold": operation.effort_nm}
        contact, felt = judged(arm.move(pose, **how))
        effort = max(effort, felt)
        if contact:
            break
    if not early:
        # A hand that touches something on its way down still closes: it is what the action does.
        touched, more = shaped()
        contact, effort = contact or touched, max(effort, more)
    return contact, effort
