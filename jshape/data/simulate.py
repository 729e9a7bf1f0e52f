"""Pairs from the simulator: a new bed, one action at a random place, two looks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy import ndimage

from jshape import sim
from jshape._typing import Array, Key
from jshape.camera import PAPER_BOX, Camera
from jshape.data.pairs import Pairs
from jshape.errors import JShapeError, UnknownName

ROIS = {
    "grasp": (183, 183),
    "knock": (112, 104),
    "press": (76, 132),
    "pinch": (70, 116),
    "poke": (40, 45),
}
"""ROI sizes (w, h) in pixels of `PAPER_BOX` that hold the simulated effects.

Grasp and poke are the paper's.  Its knock is 112 x 60, flatter than the crater of our fist with
its rim; press and pinch have no printed size.
"""

ALL_ROIS = ROIS | {"sweep": (196, 156), "scoop": (128, 128), "pour": (100, 100)}
"""With those of the actions that move material, which are simulated when asked for by name."""

BEDS = ("flat", "irregular", "curved")
"""Kinds of bed to draw from."""

DEPTH_UNIT = 0.0001
"""Metres per count of simulated frames: 0.1 mm, finer than the noise."""


MARGIN = 0.025
"""What a hand piles up around it is nearer than this, metres."""


class SimulatedPair(NamedTuple):
    """One row of a data set with its frames."""

    action: str
    agent: str
    material: str
    position: tuple[int, int]
    roi: tuple[int, int]
    prior: np.ndarray
    posterior: np.ndarray
    strength: float = 1.0
    path_mm: float = 0.0


def random_bed(key: Key[Array, ""], kind: str, std: float = 0.008) -> sim.Bed:
    """A bed of one kind; irregular ones have hills of standard deviation `std` metres.

    Raises UnknownName: no such kind.
    """
    if kind == "flat":
        return sim.flat_bed()
    if kind == "irregular":
        return sim.irregular_bed(key, std)
    if kind == "curved":
        return sim.curved_bed(jnp.where(jax.random.bernoulli(key), 0.25, -0.25))
    raise UnknownName("kind of bed", kind, BEDS)


def bed_of_depth(depth: np.ndarray, camera: Camera) -> sim.Bed:
    """The loose bed under a depth image (H, W), metres, all pixels known.

    Places that the image does not show take their neighbour's height; what is hidden behind a wall
    is a wall.
    """
    level = sim.flat_bed()
    x, y = (np.asarray(axis) for axis in level.axes())
    z = np.full(level.height.shape, float(np.median(depth)))
    for _ in range(12):  # which pixel sees a column depends on its height
        u, v = camera.pixel(x[None], y[:, None], z)
        at = np.broadcast_arrays(v, u)
        z = ndimage.map_coordinates(depth, at, order=1, mode="nearest")
    return sim.loose_bed((sim.Z_FLOOR - z).astype(np.float32))


def look(
    key: Key[Array, ""], bed: sim.Bed, camera: Camera, *, frames: int = 1, noise: float = 0.00045
) -> np.ndarray:
    """Depth (H, W) in metres of a bed as the noisy camera reports it; 0 = no reading.

    The mean of `frames` frames, taken over each pixel's readings only.
    """
    depth = sim.render(bed, camera)
    if frames == 1:
        return np.asarray(sim.sensor(key, depth, noise))
    shots = jax.vmap(lambda k: sim.sensor(k, depth, noise))(jax.random.split(key, frames))
    shots = np.asarray(shots)
    seen = shots > 0
    return shots.sum(0) / np.maximum(seen.sum(0), 1)


def simulate_pairs(
    key: Key[Array, ""],
    count: int,
    *,
    actions: Sequence[str] = tuple(ROIS),
    agents: Sequence[str | sim.Agent] = ("robot",),
    material: str | sim.Material = "flour",
    beds: Sequence[str] = ("flat",),
    camera: Camera = PAPER_BOX,
    rois: Mapping[str, tuple[int, int]] = ALL_ROIS,
    frames: int = 1,
    noise: float = 0.00045,
    strengths: tuple[float, float] = (1.0, 1.0),
    length: float = 1.0,
) -> Iterator[SimulatedPair]:
    """`count` pairs per action and agent, at random places where the whole ROI is visible.

    Args:
      key: consumed.
      count: pairs per action and agent.
      actions: names of simulated actions.
      agents: "robot" repeats itself, "human" is smaller, goes less deep and varies; or your own.
      material: a simulated material, or its name.
      beds: kinds of bed, taken in turn.
      camera: that looks straight down.
      rois: ROI size (w, h) of each action, pixels; they grow with `length`.
      frames: frames averaged into each look.
      noise: standard deviation of one frame at 0.45 m, metres.
      strengths: least and greatest of how many times as deep as the agent's own each action goes
        (of a pour: as much as it gives); drawn for each pair so that halves are as frequent as
        doubles (log-uniformly).
      length: how many times as long as the agent's own the path of a `sweep` is.

    Raises:
      UnknownName: no such action, agent, material or kind of bed.
      JShapeError: strengths that are not two rising numbers above 0.
    """
    low_high = np.asarray(strengths, np.float64)
    if not (np.isfinite(low_high).all() and 0 < low_high[0] <= low_high[1]):
        raise JShapeError(f"strengths are {tuple(strengths)}; expected two rising numbers above 0")
    for what, names, allowed in (
        ("agent", [agent for agent in agents if isinstance(agent, str)], sim.AGENTS),
        *(("action", actions, sim.actions_of(agent)) for agent in agents),
        ("kind of bed", beds, BEDS),
    ):
        for name in names:
            if name not in allowed:
                raise UnknownName(what, name, allowed)
    material = sim.read_material(material)
    for agent in agents:
        who = agent if isinstance(agent, str) else agent.name
        for action in actions:
            stroke = sim.stroke(action, agent)
            w, h = rois[action] if action in rois else roi_of(stroke, camera)
            path = sim.path_mm(stroke)
            longer = 1e-3 * path * (length - 1.0) * float(camera.fx) / sim.SURFACE
            roi, own = (w + 2 * int(np.ceil(longer / 2)), h), length if longer else None
            for index in range(count):
                key, for_bed, for_place, for_act, for_prior, for_posterior = _split(key)
                bed = random_bed(for_bed, beds[index % len(beds)])
                place = random_place(for_place, roi, camera)
                xy = sim.position_to_xy(camera, place)
                # Of its own key, so that the beds and places are those of strength 1.
                share = jax.random.uniform(jax.random.fold_in(for_act, 1), (), jnp.float32)
                strength = float(low_high[0] * (low_high[1] / low_high[0]) ** float(share))
                after = sim.apply_action(
                    for_act, bed, material, (action, agent), xy, strength, length=own
                )
                prior, posterior = (
                    np.asarray(
                        sim.to_uint16(look(k, b, camera, frames=frames, noise=noise), DEPTH_UNIT)
                    )
                    for k, b in ((for_prior, bed), (for_posterior, after))
                )
                what, frames_of_both = (action, who, material.name, place, roi), (prior, posterior)
                yield SimulatedPair(*what, *frames_of_both, strength, path * length)


def random_place(key: Key[Array, ""], roi: tuple[int, int], camera: Camera) -> tuple[int, int]:
    """A random (u, v) at which a whole ROI of size (w, h) is visible."""
    w, h = roi
    low = jnp.array([w // 2, h // 2], jnp.int32)
    high = low + jnp.array([camera.width - w, camera.height - h], jnp.int32)
    u, v = np.asarray(jax.random.randint(key, (2,), low, high + 1, jnp.int32)).tolist()
    return u, v


def roi_of(stroke: sim.Stroke, camera: Camera) -> tuple[int, int]:
    """ROI size (w, h) in pixels that holds what a stroke does: its way, and `MARGIN` around it."""
    ends = np.abs(np.asarray(stroke.path)[..., :2]) + np.asarray(stroke.radius)[:, None, None]
    half = ends.max((0, 1, 2)) + MARGIN
    w, h = np.rint(2 * half * (float(camera.fx), float(camera.fy)) / sim.SURFACE).astype(int)
    return min(int(w), camera.width), min(int(h), camera.height)


def _split(key: Key[Array, ""]) -> Key[Array, "6"]:
    """The key of the next pair, then the five of this one."""
    return jax.random.split(key, 6)


def keys_along(key: Key[Array, ""], count: int) -> Key[Array, "count"]:
    """The keys that `simulate_pairs` has before each of so many pairs: it can begin at any."""

    def step(key: Key[Array, ""], _: None) -> tuple[Key[Array, ""], Key[Array, ""]]:
        return _split(key)[0], key

    return lax.scan(step, key, length=count)[1]


def together(pairs: Iterable[SimulatedPair], camera: Camera = PAPER_BOX) -> Pairs:
    """Simulated pairs as the set that predictors are fitted to; nothing goes through the disk."""
    made = list(pairs)
    return Pairs(
        camera=camera,
        depth_unit=DEPTH_UNIT,
        prior=np.stack([pair.prior for pair in made]),
        posterior=np.stack([pair.posterior for pair in made]),
        action=np.array([pair.action for pair in made]),
        agent=np.array([pair.agent for pair in made]),
        material=np.array([pair.material for pair in made]),
        centre=np.array([pair.position for pair in made], np.int32),
        size=np.array([pair.roi for pair in made], np.int32),
        id=np.array([f"{pair.action}_{pair.agent}_{k:05d}" for k, pair in enumerate(made)]),
        strength=np.array([pair.strength for pair in made], np.float32),
        path_mm=np.array([pair.path_mm for pair in made], np.float32),
    )
