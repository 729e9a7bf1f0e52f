"""The five actions of the two agents, as data: rigid fingers and the path that they take.

A finger is a segment with a rounded underside.  All actions share one shape of arrays (`T`
waypoints of `F` fingers, unused ones of radius 0), so one compiled kernel serves them all and a
new action is one more row of `_ROBOT`.  Metres; x along image columns, y along image rows, z above
the *reference height*: the mean of the bed below the hand.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float, Key
from jshape.errors import UnknownName

NUM_FINGERS = 5
NUM_WAYPOINTS = 3
FORWARD = 2.0
"""Power of the forward half of the cosine: how narrowly a finger pushes ahead."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stroke:
    """One action of one agent.  A pytree of numbers only: no name, so nothing recompiles."""

    path: Float[Array, "T F 2 3"]
    """Ends of every finger's lowest line at every waypoint, metres from place and reference."""
    times: Float[Array, "T"]
    """When the waypoints are reached, from 0 to 1."""
    radius: Float[Array, "F"]
    """Half width of a finger, metres; 0 for an unused one."""
    rise: Float[Array, "F"]
    """Height of the underside's edge above its lowest line, metres."""
    flat: Float[Array, "F"]
    """Shape of the underside: 0 a parabola, 1 flat in the middle with a round edge."""
    reach: Float[Array, "2"]
    """Half sides (x, y) of the rectangle below the hand whose mean height is the reference, m."""
    yaw: float | Array
    """How far the hand is turned from x towards y, radians."""
    spread_xy: float | Array
    """A repetition is off by at most this along x and along y, uniformly, metres."""
    spread_yaw: float | Array
    """A repetition is turned by at most this, uniformly, radians."""
    spread_depth: float | Array
    """Standard deviation of the depth over repetitions, as a share of the depth."""
    spread_size: float | Array
    """Standard deviation of the hand's size over repetitions, as a share."""
    spread_finger: float | Array
    """Standard deviation of each finger on its own over repetitions, metres, along x, y and z."""


@dataclass(frozen=True)
class Agent:
    """Whose hand acts: a stroke for each of its actions."""

    name: str
    """What a person calls it."""
    strokes: Mapping[str, Stroke]
    """By the action's name."""


def agent_of_numbers(
    name: str, actions: Mapping[str, Mapping[str, Any]], spreads: Mapping[str, float]
) -> Agent:
    """An agent from numbers as in the tables below: strokes in mm, spreads as in `Stroke`."""
    return Agent(name, {one: _stroke({**_row(**row), **spreads}) for one, row in actions.items()})


def _stroke(fields: Mapping[str, Any]) -> Stroke:
    return Stroke(**{name: jnp.asarray(value, jnp.float32) for name, value in fields.items()})


def actions_of(agent: str | Agent) -> tuple[str, ...]:
    """The names of what an agent can do."""
    return tuple(agent.strokes) if isinstance(agent, Agent) else ACTIONS


def _row(fingers, reach, times=(0.0, 1.0, 1.0), bend=0.5):
    """Pad a list of (waypoints, radius, rise, flat), all in mm, to one shape."""
    path = np.zeros((NUM_WAYPOINTS, NUM_FINGERS, 2, 3))
    shape = np.zeros((3, NUM_FINGERS))
    for f, (waypoints, *numbers) in enumerate(fingers):
        path[:, f] = np.asarray(waypoints, float) / 1000.0
        shape[:, f] = numbers
    return dict(
        path=path,
        times=np.asarray(times),
        radius=shape[0] / 1000.0,
        rise=shape[1] / 1000.0,
        flat=shape[2],
        reach=np.asarray(reach) / 1000.0,
        yaw=0.0,
        spread_finger=bend,
    )


ABOVE = 12.0
"""Height above the reference where a stroke begins, mm."""


def _push(ends, depth, radius, rise, flat):
    """A finger with ends ((x0, y0), (x1, y1)) mm that goes straight down to `depth` mm."""
    up, down = ([(x, y, z) for x, y in ends] for z in (ABOVE, -depth))
    return (up, down, down), radius, rise, flat


def _sweep(start, stop, depths, radius, rise, flat):
    """A fingertip that goes down at `start` and moves to `stop`, (x, y) mm, at two depths, mm."""
    up, down, shut = (*start, ABOVE), (*start, -depths[0]), (*stop, -depths[1])
    return ((up, up), (down, down), (shut, shut)), radius, rise, flat


def _ray(angle, outer, inner_x):
    """Start and stop of a finger that comes in along a ray, from `outer` mm to x = `inner_x`."""
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return (outer * cos, outer * sin), (inner_x, inner_x * sin / cos)


_ROBOT = {
    # The thumb comes from -x, four fingers fan out towards +x; they close on one another.
    "grasp": _row(
        [
            _sweep((-46.8, 0.0), (-30.5, 0.0), (25.0, 25.0), 9.7, 4.5, 0.75),
            *[
                _sweep(*_ray(angle, 44.8, 15.4), (21.4, 24.9), 9.7, 4.5, 0.75)
                for angle in (-48.3, -16.0, 16.0, 48.3)
            ],
        ],
        reach=(49.0, 47.0),
        times=(0.0, 0.45, 1.0),
        bend=2.0,
    ),
    # Four knuckles side by side.
    "knock": _row(
        [_push(((x, -23.4), (x, 23.4)), 16.7, 14.5, 11.5, 0.31) for x in (-28.5, -9.5, 9.5, 28.5)],
        reach=(41.0, 36.0),
    ),
    # The edge of the fist, along v.
    "press": _row(
        [_push(((0.0, -28.7), (0.0, 28.7)), 17.8, 23.3, 15.8, 0.18)],
        reach=(21.0, 54.0),
    ),
    # Index and middle finger towards each other.
    "pinch": _row(
        [
            _sweep((-2.5, -32.3), (-1.2, -13.1), (19.6, 21.0), 9.4, 3.4, 0.36),
            _sweep((2.5, 32.3), (1.2, 13.1), (19.6, 21.0), 9.4, 3.4, 0.36),
        ],
        reach=(12.0, 45.0),
        times=(0.0, 0.5, 1.0),
        bend=2.0,
    ),
    "poke": _row(
        [_push(((0.0, 0.0), (0.0, 0.0)), 19.8, 10.3, 8.0, 0.11)],
        reach=(10.0, 12.0),
    ),
}
"""The robot's hand, fitted to material-point samples in flour (docs/simulator.md)."""

_SPREADS = {
    "robot": dict(
        spread_xy=0.001,
        spread_yaw=np.radians(2.0),
        spread_depth=0.035,
        spread_size=0.005,
        spread_finger=0.0005,
    ),
    "human": dict(
        spread_xy=0.004,
        spread_yaw=np.radians(8.0),
        spread_depth=0.13,
        spread_size=0.04,
        spread_finger=0.0020,
    ),
}
"""How much a repetition differs from the nominal stroke; a row's `bend` multiplies the last."""

_HUMAN = {
    "grasp": (0.92, 0.85),
    "knock": (0.96, 0.87),
    "press": (0.96, 0.84),
    "pinch": (0.97, 0.85),
    "poke": (0.95, 0.85),
}
"""Size and depth of the human hand, as shares of the robot's."""

ACTIONS = tuple(_ROBOT)
"""Names of the actions."""
AGENTS = tuple(_SPREADS)
"""Names of the agents."""


def stroke(action: str, agent: str | Agent = "robot") -> Stroke:
    """The nominal stroke of an action by an agent, or by one of a given name.

    Raises:
      UnknownName: no such action or agent.
    """
    if action not in actions_of(agent):
        raise UnknownName("action", action, actions_of(agent))
    if isinstance(agent, Agent):
        return agent.strokes[action]
    if agent not in _SPREADS:
        raise UnknownName("agent", agent, AGENTS)
    fields = {**_ROBOT[action], **_SPREADS[agent]}
    fields["spread_finger"] *= _ROBOT[action]["spread_finger"]
    made = _stroke(fields)
    if agent == "human":
        made = scaled(made, *_HUMAN[action])
    return made


def scaled(stroke: Stroke, size: float | Array, depth: float | Array) -> Stroke:
    """The same stroke by a larger hand (x, y, radius) that goes deeper (z below the reference)."""
    z = stroke.path[..., 2]
    z = jnp.where(z < 0, z * depth, z)
    xy = stroke.path[..., :2] * size
    path = jnp.concatenate([xy, z[..., None]], axis=-1)
    return replace(stroke, path=path, radius=stroke.radius * size, reach=stroke.reach * size)


def repetition(
    key: Key[Array, ""],
    stroke: Stroke,
    strength: float | Array = 1.0,
    yaw: float | Array = 0.0,
    spread: float | Array = 1.0,
) -> Stroke:
    """One repetition: the nominal stroke moved, turned, scaled and bent at random.

    Args:
      key: consumed.
      stroke: the nominal stroke.
      strength: how much deeper than nominal.
      yaw: turn of the hand from x towards y, radians.
      spread: factor on all of the stroke's spreads; 0 gives the nominal stroke.

    Returns:
      A stroke whose path is final.
    """
    place, turn, deep, size, bend = jax.random.split(key, 5)
    size = 1.0 + spread * stroke.spread_size * jax.random.normal(size, (), jnp.float32)
    deep = 1.0 + spread * stroke.spread_depth * jax.random.truncated_normal(
        deep, -2.5, 2.5, (), jnp.float32
    )
    made = scaled(stroke, size, strength * deep)
    angle = yaw + spread * stroke.spread_yaw * jax.random.uniform(turn, (), jnp.float32, -1.0)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, z = made.path[..., 0], made.path[..., 1], made.path[..., 2]
    path = jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    shift = spread * stroke.spread_xy * jax.random.uniform(place, (2,), jnp.float32, -1.0)
    path = path.at[..., :2].add(shift)
    bend = spread * stroke.spread_finger * jax.random.normal(bend, (NUM_FINGERS, 1, 3), jnp.float32)
    return replace(made, path=path + bend[None], yaw=angle)


def underside(
    stroke: Stroke,
    ends: Float[Array, "F 2 3"],
    x: Float[Array, "1 X"],
    y: Float[Array, "Y 1"],
) -> Float[Array, "Y X"]:
    """Lowest point of the hand above every place, metres; infinite where there is no finger.

    Args:
      stroke: gives the fingers' shapes.
      ends: the fingers' segments at this moment, metres.
      x: of the places, metres, in the frame of `ends`.
      y: likewise.
    """
    x, y = x[None], y[None]
    start, stop = ends[:, 0, :, None, None], ends[:, 1, :, None, None]
    along = stop - start
    length2 = along[:, 0] ** 2 + along[:, 1] ** 2
    dx, dy = x - start[:, 0], y - start[:, 1]
    share = jnp.clip((dx * along[:, 0] + dy * along[:, 1]) / (length2 + 1e-9), 0.0, 1.0)
    off2 = (dx - share * along[:, 0]) ** 2 + (dy - share * along[:, 1]) ** 2
    radius, rise, flat = (a[:, None, None] for a in (stroke.radius, stroke.rise, stroke.flat))
    q = off2 / (radius**2 + 1e-12)
    lowest = start[:, 2] + share * along[:, 2]
    under = lowest + rise * ((1.0 - flat) * q + flat * q**3)
    return jnp.where(q < 1.0, under, jnp.inf).min(0)


def heading(
    stroke: Stroke,
    before: Float[Array, "F 2 3"],
    ends: Float[Array, "F 2 3"],
    x: Float[Array, "1 X"],
    y: Float[Array, "Y 1"],
) -> Float[Array, "Y X"]:
    """How much every place lies ahead of the finger that is nearest to it, in [0, 1].

    1 straight ahead of a finger that moves sideways, 0 behind it, and 1 everywhere around a
    finger that goes straight down.
    """
    middle = ends.mean(1)[:, :2, None, None]
    motion = (ends - before).mean(1)[:, :2]
    speed = jnp.linalg.norm(motion, axis=-1)
    toward = (motion / (speed[:, None] + 1e-9))[:, :, None, None]
    dx, dy = x[None] - middle[:, 0], y[None] - middle[:, 1]
    far2 = dx**2 + dy**2
    cosine = (dx * toward[:, 0] + dy * toward[:, 1]) / jnp.sqrt(far2 + 1e-8)
    moves = (speed > 1e-6)[:, None, None]
    ahead = jnp.where(moves, (0.5 + 0.5 * cosine) ** FORWARD, 1.0)
    used = (stroke.radius > 0)[:, None, None]
    # Softly the nearest finger: 0.012 m is about the distance between two fingers.
    weight = jnp.where(used, jnp.exp(-0.5 * far2 / 0.012**2) + 1e-12, 0.0)
    return (weight * ahead).sum(0) / weight.sum(0)
