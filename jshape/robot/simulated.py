"""A simulated world: a bed, a hand and a camera."""

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Key
from jshape.camera import PAPER_BOX, Camera
from jshape.data.recording import LEVELLED_STD
from jshape.data.simulate import look
from jshape.errors import UnknownName


def bed_of(
    seed: int, size: tuple[float, float] = sim.SIZE
) -> tuple[sim.Bed, Key[Array, ""], Key[Array, ""]]:
    """The levelled bed of a seed, and keys for its hand and its camera.

    Cameras and arms of one seed are over the same bed: a goal that was made on a look of `sim:3`
    is one for `--arm sim:3`.
    """
    for_bed, for_world, for_eye = jax.random.split(jax.random.key(seed), 3)
    return sim.irregular_bed(for_bed, std=LEVELLED_STD, size=size), for_world, for_eye


class SimulatedWorld:
    """A bed that an agent's hand changes and a noisy camera sees.  Holds state, as a world does."""

    def __init__(
        self,
        key: Key[Array, ""],
        bed: sim.Bed,
        *,
        material: str | sim.Material = "flour",
        agent: str | sim.Agent = "robot",
        camera: Camera = PAPER_BOX,
        frames: int = 5,
        noise: float = 0.00045,
        spread: float = 1.0,
    ):
        """A world that starts with `bed`; `frames` frames are averaged into each look.

        `spread` is a factor on the agent's variability: 0 repeats its nominal actions exactly.

        Raises:
          UnknownName: no such material or agent.
        """
        if isinstance(agent, str) and agent not in sim.AGENTS:
            raise UnknownName("agent", agent, sim.AGENTS)
        self.bed = bed
        self.camera = camera
        self._key = key
        self._material = sim.read_material(material)
        self.agent = agent
        """Whose hand it is, or the name."""
        self._frames = frames
        self._noise = noise
        self._spread = spread

    def _next_key(self) -> Key[Array, ""]:
        self._key, key = jax.random.split(self._key)
        return key

    def look(self) -> np.ndarray:
        """Depth (H, W) in metres; 0 = no reading."""
        return look(self._next_key(), self.bed, self.camera, frames=self._frames, noise=self._noise)

    def act(
        self,
        action: str,
        position: tuple[float | int, float | int],
        strength: float | int = 1.0,
        yaw: float | int = 0.0,
    ) -> None:
        """Apply an action at pixel (u, v), whole or not; see `jshape.robot.loop.World`.

        Raises:
          UnknownName: no such action.
          BadPosition: a place outside the box.
          JShapeError: a strength or a yaw that makes no sense.
        """
        xy = sim.position_to_xy(self.camera, np.asarray(position))
        given = (self._next_key(), self.bed, self._material, (action, self.agent), xy)
        self.bed = sim.apply_action(*given, strength=strength, yaw=yaw, spread=self._spread)
