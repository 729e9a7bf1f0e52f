"""Arms by what people write on the command line: one table.

An arm that has a bed of its own, simulated or in physics, brings the camera above it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from jshape import sim
from jshape.camera import Camera
from jshape.errors import JShapeError, did_you_mean, quoted
from jshape.robot.arms.base import Arm
from jshape.robot.arms.dry_run import DryRun
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.cameras.names import seed_of
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.simulated import SimulatedWorld
from jshape.sim.bed import SIZE

HILLS = 0.003
"""Standard deviation of a bed's surface, metres."""
BOX = (0.50, 0.40)
"""The paper's wooden box, metres along u and v."""


@dataclass(frozen=True)
class Opened:
    """An arm, and what comes with it."""

    arm: Arm
    eye: DepthCamera | None = None
    """The camera above its own bed."""
    base_camera: np.ndarray | None = None
    """(4, 4) pose of that camera in the arm's base frame."""
    moves: bool = True
    """False: it only says what it would do, and needs to know of no camera."""


class Kind(NamedTuple):
    """A kind of arm, and how its name looks."""

    example: str
    what: str
    open: Callable[[int, str, Camera, Callable[[str], object]], Opened]
    """Given a seed, a material, the bank's camera and what says a line."""


def open_arm(
    text: str, camera: Camera, *, material: str = "flour", say: Callable[[str], object] = print
) -> Opened:
    """The arm that a text names.

    Args:
      text: as the examples of `KINDS`: a name, and for some a colon and a seed.
      camera: the bank's; a simulated camera is like it.
      material: of a simulated bed.
      say: told what a dry run would do.

    Raises:
      JShapeError: no such arm, or no such seed.
    """
    name = text.partition(":")[0]
    if name not in KINDS:
        allowed = ", ".join(kind.example for kind in KINDS.values())
        raise JShapeError(
            f"{quoted(text)} is not an arm; allowed: {allowed}{did_you_mean(name, KINDS)}"
        )
    return KINDS[name].open(seed_of(text), material, camera, say)


def bed_of(seed: int, size: tuple[float, float] = SIZE) -> tuple[sim.Bed, jax.Array, jax.Array]:
    """The uneven bed of a seed, and keys for its hand and its camera."""
    for_bed, for_world, for_eye = jax.random.split(jax.random.key(seed), 3)
    return sim.irregular_bed(for_bed, std=HILLS, size=size), for_world, for_eye


def _dry(seed: int, material: str, camera: Camera, say: Callable[[str], object]) -> Opened:
    return Opened(DryRun(say), moves=False)


def _sim(seed: int, material: str, camera: Camera, say: Callable[[str], object]) -> Opened:
    bed, for_world, for_eye = bed_of(seed)
    world = SimulatedWorld(for_world, bed, material=material, camera=camera)
    return Opened(SimulatedArm(world), simulated_camera(world, for_eye), np.eye(4))


def _mujoco(seed: int, material: str, camera: Camera, say: Callable[[str], object]) -> Opened:
    from jshape.robot.twin import make_twin

    bed, for_world, _ = bed_of(seed, size=BOX)
    arm, eye, base_camera = make_twin(for_world, bed, material=material)
    return Opened(arm, eye, base_camera)


KINDS = {
    "dry": Kind("dry", "says what it would do; needs a camera", _dry),
    "sim": Kind("sim[:SEED]", "a hand over a simulated bed, with its camera", _sim),
    "mujoco": Kind("mujoco[:SEED]", "the robot's physics twin, with its camera", _mujoco),
}
"""Every kind of arm; a new one is a file and a row here."""
