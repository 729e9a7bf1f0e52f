"""A twin, ready to use: its arm, its camera, and where the camera is."""

from typing import NamedTuple

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Float, Key
from jshape.camera import D435_BAZAR, Camera
from jshape.robot.arms.mujoco import MuJoCoArm
from jshape.robot.cameras.mujoco import MuJoCoCamera
from jshape.robot.twin.model import Obstacle
from jshape.robot.twin.world import Twin


class Ready(NamedTuple):
    """What a robot is made of; `arm.twin` is the world behind both."""

    arm: MuJoCoArm
    """At home, the bed in the camera's view."""
    camera: MuJoCoCamera
    """On its wrist."""
    base_camera: Float[np.ndarray, "4 4"]
    """Pose of the camera in the arm's base frame when the arm is at home."""


def make_twin(
    key: Key[Array, ""] | int,
    bed: sim.Bed,
    material: str = "flour",
    obstacle: Obstacle | None = None,
    *,
    camera: Camera = D435_BAZAR,
    noise: float = 0.00045,
    spread: float = 0.0,
) -> Ready:
    """The arm and the camera of a new twin.

    Args:
      key: of all that is random, or a seed.
      bed: as it is at first; its size is the box's.
      material: of the bed.
      obstacle: something rigid in the bed.
      camera: size and intrinsics of the depth camera.
      noise: of the camera at 0.45 m, metres; 0 for a perfect one.
      spread: factor on how much the robot's actions vary beyond what the physics does.

    Raises:
      UnknownName: no such material.
      JShapeError: MuJoCo or mink is not installed.
    """
    key = jax.random.key(key) if isinstance(key, int) else key
    for_actions, for_camera = jax.random.split(key)
    twin = Twin(
        bed, key=for_actions, material=material, camera=camera, obstacle=obstacle, spread=spread
    )
    eye = MuJoCoCamera(twin, key=for_camera, noise=noise)
    return Ready(MuJoCoArm(twin), eye, twin.base_camera)
