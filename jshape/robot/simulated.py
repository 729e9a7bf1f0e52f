"""A simulated world: a bed, a hand and a camera."""

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, ArrayLike, Float, Key
from jshape.actions import Place
from jshape.camera import PAPER_BOX, Camera
from jshape.data.recording import LEVELLED_STD
from jshape.data.simulate import look
from jshape.errors import UnknownName
from jshape.sim import check

NOTHING = 1e-7
"""Less material than this is none, m³: a tenth of a cubic centimetre."""


def bed_of(
    seed: int, size: tuple[float, float] = sim.SIZE
) -> tuple[sim.Bed, Key[Array, ""], Key[Array, ""]]:
    """The levelled bed of a seed, and keys for its hand and its camera.

    Cameras and arms of one seed are over the same bed: a goal that was made on a look of `sim:3`
    is one for `--arm sim:3`.
    """
    for_bed, for_world, for_eye = jax.random.split(jax.random.key(seed), 3)
    return sim.irregular_bed(for_bed, std=LEVELLED_STD, size=size), for_world, for_eye


def after_action(
    key: Key[Array, ""],
    bed: sim.Bed,
    material: sim.Material,
    stroke: sim.Stroke,
    xy: ArrayLike,
    strength: float | int,
    *,
    beside: float = 0.0,
    **how: float | int,
) -> sim.Bed:
    """`sim.apply_action`, but a hand brings at most what was taken out, and a stock beside the bed.

    `beside` is that stock at first, loose m³; the key may be used again for the same repetition.
    """

    def after(strength: float | int) -> sim.Bed:
        again = jax.random.wrap_key_data(jax.random.key_data(key))
        return sim.apply_action(again, bed, material, stroke, xy, strength=strength, **how)

    found = after(strength)
    given, left = float(bed.stock - found.stock), float(bed.stock) + beside
    if given <= max(left, 0.0):
        return found
    return bed if left <= NOTHING else after(strength * left / given)


def placed_path(
    stroke: sim.Stroke, way: float, start: Float[np.ndarray, "2"], yaw: float
) -> tuple[float, Float[np.ndarray, "2"]]:
    """How a stroke along the bed is stretched and placed for a tool that goes `way` along its x.

    The tool goes down at `start`, (x, y) metres.  Returns the stroke's length as a multiple, and
    the place (x, y) of which its hand goes down there.
    """
    first, *_, last = np.asarray(sim.way(stroke), float)
    length = way / float(np.linalg.norm(last - first)) if way else 1.0
    begins = (first + last) / 2 - length * (last - first) / 2
    cos, sin = np.cos(yaw), np.sin(yaw)
    return length, start - np.array([[cos, -sin], [sin, cos]]) @ begins


def goes_along(stroke: sim.Stroke) -> bool:
    """Whether a hand moves material along the bed."""
    first, *_, last = np.asarray(sim.way(stroke), float)
    return stroke.load is not None and bool(np.linalg.norm(last - first) > 1e-6)


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
        stock_cm3: float = 0.0,
    ):
        """A world that starts with `bed`; `frames` frames are averaged into each look.

        `spread` is a factor on the agent's variability: 0 repeats its nominal actions exactly.
        `stock_cm3` is loose material beside the bed, which hands may bring beyond what they took.

        Raises:
          UnknownName: no such material or agent.
          JShapeError: a stock below 0.
        """
        check.number("stock_cm3", stock_cm3, at_least=0.0)
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
        self._beside = 1e-6 * stock_cm3  # m³

    def _next_key(self) -> Key[Array, ""]:
        self._key, key = jax.random.split(self._key)
        return key

    def look(self) -> np.ndarray:
        """Depth (H, W) in metres; 0 = no reading."""
        return look(self._next_key(), self.bed, self.camera, frames=self._frames, noise=self._noise)

    def act(
        self,
        action: str,
        position: Place,
        strength: float | int = 1.0,
        yaw: float | int = 0.0,
        length: float | int = 1.0,
        *,
        share: float = 1.0,
    ) -> None:
        """Apply an action as `jshape.robot.loop.World` says, or a share of its path.

        One that brings material brings `strength` times as much, at most what was taken out of the
        bed before, and the stock beside it.

        Raises:
          UnknownName: no such action.
          BadPosition: a place outside the box.
          JShapeError: a strength, a yaw or a length that makes no sense.
        """
        check.number("length", length, above=0.0)
        xy = sim.position_to_xy(self.camera, np.asarray(position))
        stroke = sim.stroke(action, self.agent)
        if length != 1:
            stroke = sim.lengthened(stroke, length)
        if share < 1:
            stroke = sim.cut(stroke, share)
        given = (self._next_key(), self.bed, self._material, stroke, xy)
        how = {"yaw": yaw, "spread": self._spread, "beside": self._beside}
        self.bed = after_action(*given, strength, **how)
