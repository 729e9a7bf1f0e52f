"""A camera over a simulated bed: it sees what a hand does to it, with a D435's noise and holes."""

from collections.abc import Iterator

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Key
from jshape.camera import Camera
from jshape.data.simulate import DEPTH_UNIT
from jshape.robot.cameras.base import CameraSettings
from jshape.robot.cameras.played import Played
from jshape.robot.registry import seed_of
from jshape.robot.simulated import SimulatedWorld, bed_of

NOISE = 0.00045
"""Standard deviation of one frame at 0.45 m, metres."""
HOLES = 0.002
"""Share of pixels without a reading."""


def simulated_camera(
    world: SimulatedWorld,
    key: Key[Array, ""],
    camera: Camera | None = None,
    *,
    noise: float = NOISE,
    holes: float = HOLES,
) -> Played:
    """A camera that sees the bed of a world as it is at each frame; `key`: consumed, of the noise.

    Its `camera` has its pose in the bed's frame, so several may look at one; None: the world's.
    `noise` is the standard deviation of one frame at 0.45 m, metres; `holes` the share of pixels
    without a reading.
    """
    still = noise == 0 and holes == 0
    camera, name = camera or world.camera, "simulated camera"
    if camera.pose is not None:
        x, y, _ = (1e3 * row[3] for row in camera.pose[:3])
        name += f" at ({x:.0f}, {y:.0f}) mm"
    frames = _frames(world, camera, key, noise, holes)
    return Played(name, camera, DEPTH_UNIT, frames, live=True, still=still)


def open_simulated(address: str, settings: CameraSettings) -> Played:
    """A camera above a levelled bed of the seed that the address is, or as the settings have it."""
    settings.check_own("sim", unit_only=True)
    seed = seed_of(address)
    key = jax.random.fold_in(jax.random.key(seed), 1)
    return simulated_camera(levelled_world(seed), key, settings.camera and settings.camera[0])


def levelled_world(seed: int = 0) -> SimulatedWorld:
    """A world whose bed somebody has just levelled by hand."""
    bed, for_world, _ = bed_of(seed)
    return SimulatedWorld(for_world, bed)


def _frames(
    world: SimulatedWorld, camera: Camera, key: Key[Array, ""], noise: float, holes: float
) -> Iterator[np.ndarray]:
    bed = depth = None
    while True:
        if world.bed is not bed:  # looking along every ray takes longer than noise does
            bed, depth = world.bed, sim.render(world.bed, camera)
        key, now = jax.random.split(key)
        yield np.array(sim.to_uint16(sim.sensor(now, depth, noise, holes), DEPTH_UNIT))
