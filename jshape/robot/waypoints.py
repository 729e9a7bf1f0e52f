"""A plan as poses of the tool, for a controller that is not ours.

Every action becomes its six operations on the surface that is predicted before it, so that later
actions touch what the earlier ones leave.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jshape import metric
from jshape._typing import Float
from jshape.actions import PAPER_Z
from jshape.errors import BadPosition, JShapeError, UnknownName
from jshape.planning.plan import Plan
from jshape.robot.procedure import Hand, Operation, check_reach, poses_of
from jshape.robot.rigid import check_rigid
from jshape.robot.surface import surface_point


class Waypoint(NamedTuple):
    """One operation: the tool goes there, then the hand takes its posture."""

    operation: str
    """above, prepare, contact, act, up or clear."""
    pose: Float[np.ndarray, "4 4"] | None
    """Of the tool at its end, metres; None: it stays, or, for clear, the arm goes home."""
    posture: str | None
    """Of the hand, after the motion; None: as it was."""
    seconds: float
    """That the posture takes."""
    speed: float
    """Of the tool, m/s."""
    effort: float
    """Contact effort that ends the operation, Nm."""


class ActionPath(NamedTuple):
    """One action of the plan."""

    action: str
    position: tuple[float, float]
    """(u, v) in the image of the plan's camera."""
    strength: float
    """How many times as deep as the trained action."""
    yaw: float
    """Turn of the hand from u towards v, radians."""
    surface: Float[np.ndarray, "3"]
    """The place on the predicted surface, metres."""
    tool: Float[np.ndarray, "3"]
    """The tool's origin in the flange's frame, metres; the axes are the flange's."""
    distance_mm: float
    """Predicted distance to the goal after it."""
    waypoints: tuple[Waypoint, ...]
    """The six operations, in order."""


@dataclass(frozen=True, eq=False)
class Waypoints:
    """A plan as poses."""

    frame: str
    """Of all poses: base, or camera where no pose of the camera was given."""
    base_camera: Float[np.ndarray, "4 4"] | None
    """T_base_camera, metres."""
    place_depth: float
    """Depth at which the plan's places are meant, metres."""
    hard_effort: float
    """Contact effort at which the arm must stop for good, Nm."""
    actions: Sequence[ActionPath]
    """In the order to apply them."""


def waypoints_of(
    plan: Plan,
    hand: Hand,
    base_camera: Float[np.ndarray, "4 4"] | None = None,
    *,
    place_depth: float = PAPER_Z,
) -> Waypoints:
    """The poses of all operations of a plan.

    Args:
      plan: with its images: they say how high the surface will be.
      hand: procedures and limits.
      base_camera: pose of the camera that took the frames in the arm's base frame, metres; None
        gives poses in that camera's frame.
      place_depth: depth from the plan's camera at which its places are meant, metres (Hypothesis
        3); 0.45 for the bundled banks.

    Raises:
      JShapeError: the plan has no actions, or was stored without its images.
      UnknownName: an action without a procedure.
      BadPosition: a place depth beyond the range of the plan's camera.
      PoseRefused: an operation leaves the hand's limits.
      BadPose: base_camera is not rigid, or not in metres.
    """
    if len(plan) == 0:
        raise JShapeError("the plan has no actions: there is nothing to export")
    if plan.initial is None:
        raise JShapeError(
            "the plan was stored without its images, which say how high the surface is; plan again"
        )
    camera, missing = plan.camera, [a for a in plan.actions if a not in hand.procedures]
    if missing:
        raise UnknownName("action", missing[0], hand.procedures)
    if not float(camera.z_min) <= place_depth <= float(camera.z_max):
        raise BadPosition(
            f"places are meant at {place_depth:g} m, beyond the range of the plan's camera, "
            f"{float(camera.z_min):g} to {float(camera.z_max):g} m; say at which depth "
            "(place_depth, --place-depth)"
        )
    frame = "camera" if base_camera is None else "base"
    change = np.eye(4) if base_camera is None else check_rigid(base_camera, "T_base_camera")
    rise = 0.0 if plan.view is None else plan.view.rise
    all_actions = []
    for k, action in enumerate(plan.actions):
        procedure = hand.procedures[action]
        u, v = (float(x) for x in plan.exact_positions[k])
        strength, yaw = float(plan.strengths[k]), float(plan.yaws[k])
        depth = np.asarray(camera.depth(metric.unweigh(plan.images[k], camera)))
        point = surface_point(depth, camera, (u, v), rise=rise, place_depth=place_depth)
        check_reach(procedure, hand.limits, point, strength, yaw)
        path = ActionPath(
            action=action,
            position=(u, v),
            strength=strength,
            yaw=yaw,
            surface=change[:3, :3] @ point + change[:3, 3],
            tool=np.array(procedure.tool_mm) / 1e3,
            distance_mm=float(plan.distances_mm[k + 1]),
            waypoints=tuple(
                _waypoint(operation, None if pose is None else change @ pose)
                for operation, pose in poses_of(procedure, hand.limits, point, strength, yaw)
            ),
        )
        all_actions.append(path)
    kept = None if base_camera is None else change
    return Waypoints(frame, kept, place_depth, hand.limits.effort_nm, tuple(all_actions))


def _waypoint(operation: Operation, pose: np.ndarray | None) -> Waypoint:
    """An operation with the tool's pose (4, 4); None: the arm goes home, wherever that is."""
    return Waypoint(
        operation.name,
        pose,
        operation.posture,
        float(operation.seconds),
        operation.speed_mm_s / 1e3,
        float(operation.effort_nm),
    )
