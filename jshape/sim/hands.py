"""The hands of the two agents, as data: a row of numbers for each of their actions.

A new action is one more row of `_ROBOT`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jshape.errors import UnknownName
from jshape.sim.tools import NUM_FINGERS, NUM_WAYPOINTS, Load, Stroke, scaled


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
    return Stroke(**jax.tree.map(lambda value: jnp.asarray(value, jnp.float32), dict(fields)))


def actions_of(agent: str | Agent) -> tuple[str, ...]:
    """The names of what an agent can do."""
    return tuple(agent.strokes) if isinstance(agent, Agent) else tuple(_ROBOT)


def _row(fingers, reach, times=(0.0, 1.0, 1.0), bend=0.5, load=None):
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
        load=load,
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


def _along(points, half):
    """Waypoints of a finger from -`half` to `half` mm along y, through (x, z) points, mm."""
    return tuple(((x, -half, z), (x, half, z)) for x, z in points)


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
ACTIONS = tuple(_ROBOT)
"""Names of the five actions, which press."""

_ROBOT |= {
    # The edge of the fist, along v, is lowered and drawn along u.
    "sweep": _row(
        [(_along(((-40.0, ABOVE), (-40.0, -8.6), (45.0, -8.6)), 28.7), 23.3, 15.8, 0.18)],
        reach=(23.0, 51.5),
        times=(0.0, 0.3, 1.0),
        load=Load(under=0.2, begins=1.0),
    ),
    # The lip of a cupped hand goes in along a slope and on along u; what lies above it comes out.
    "scoop": _row(
        [(_along(((-63.9, 0.0), (-4.6, -11.8), (16.8, -11.8)), 35.2), 11.0, 3.1, 0.86)],
        reach=(27.5, 35.0),
        times=(0.0, 0.55, 1.0),
        load=Load(takes=0.39, begins=0.43),
    ),
    # 50 cm³ of loose material fall out of an open hand.
    "pour": _row(
        [_push(((0.0, 0.0), (0.0, 0.0)), 0.0, 22.5, 0.0, 0.0)],
        reach=(22.5, 22.5),
        load=Load(gives=50e-6),
    ),
}
MOVING = tuple(_ROBOT)[len(ACTIONS) :]
"""Names of the actions that move material: along, out of the bed, into it."""

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
    "sweep": (0.96, 0.85),
    "scoop": (0.96, 0.85),
    "pour": (0.96, 0.85),
}
"""Size and depth of the human hand, as shares of the robot's."""

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
