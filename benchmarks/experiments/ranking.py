"""Does a distance fall as a bed nears its goal?  Measured on simulated molding sequences.

What counts as near is how many actions are left, which favours no distance.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from scipy.stats import kendalltau

from benchmarks import clouds
from benchmarks.experiments.samples import CAMERAS, Progress
from jshape import metric, sim
from jshape.data.view import image_of_depth
from jshape.robot.simulated import SimulatedWorld

CAMERA = CAMERAS["240x198"]
"""That looks at the sequences: small, so that clouds of all its points can be compared."""
STRENGTHS = (0.3, 1.0)
"""How deep the actions go, times their nominal depth."""
FEW = 500
"""Points of a subsample."""
HILLS = 0.004
"""Standard deviation of the beds, metres."""
ROUNDS = 8
"""Most rounds of ICP."""

Distance = Callable[[np.random.Generator, np.ndarray, np.ndarray], float]
"""Of two weighed images I, mm; may draw points."""


def _points(image: np.ndarray) -> np.ndarray:
    level = metric.unweigh(image, CAMERA)
    return 1e3 * np.asarray(CAMERA.points(level)).reshape(-1, 3)


def _plain(_: np.random.Generator, a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(_points(a)[:, 2] - _points(b)[:, 2]).mean())


def _d(_: np.random.Generator, a: np.ndarray, b: np.ndarray) -> float:
    return float(metric.to_mm(metric.distance(a, b), CAMERA))


def distances() -> Mapping[str, Distance]:
    """By name; with the quickest of the packages that are installed."""
    tree = clouds.installed(clouds.TREES)[-1]
    mover = clouds.installed(clouds.MOVERS)[-1]
    even = clouds.spread(CAMERA.shape, FEW)

    def drawn(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
        return clouds.drawn(rng, _points(image), FEW)

    return {
        "d": _d,
        "depth difference": _plain,
        "Chamfer": lambda _, a, b: clouds.chamfer(_points(a), _points(b), tree),
        f"Chamfer, {FEW} random points": lambda rng, a, b: clouds.chamfer(
            drawn(rng, a), drawn(rng, b), tree
        ),
        f"EMD, {FEW} same pixels": lambda _, a, b: clouds.emd(
            _points(a)[even], _points(b)[even], mover
        ),
        f"EMD, {FEW} random points": lambda rng, a, b: clouds.emd(
            drawn(rng, a), drawn(rng, b), mover
        ),
        "ICP": lambda _, a, b: clouds.icp(_points(a), _points(b), tree, most=ROUNDS).distance,
    }


def rank(
    seed: int, count: int, steps: int, progress: Progress
) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """How every distance follows sequences of actions to their end.

    Args:
      seed: of beds, actions and noise.
      count: sequences.
      steps: actions of each.
      progress: wraps the sequences.

    Returns:
      A row per distance (mean Kendall tau with the number of actions left, share of the actions
      with which it falls, what of the start is left at the goal), and (count, steps + 1) values in
      mm from the start to the goal, seen again with other noise.
    """
    known = distances()
    values = {name: np.zeros((count, steps + 1)) for name in known}
    for k in progress(range(count), count, "ranking"):
        looks, goal = sequence(seed, k, steps)
        rng = np.random.default_rng([seed, 6, k])
        for name, distance in known.items():
            values[name][k] = [distance(rng, look, goal) for look in looks]
    rows = []
    for name, found in values.items():
        rows.append({"part": "ranking", "method": name} | scores(found))
    return rows, values


def scores(values: np.ndarray) -> dict[str, float]:
    """What is told of one distance's values (sequences, steps + 1), from start to goal."""
    left = np.arange(values.shape[1])[::-1]
    tau = [float(kendalltau(left, line)[0]) for line in values]  # pyright: ignore
    return {
        "kendall": float(np.mean(tau)),
        "kendall_least": float(np.min(tau)),
        "falls": float((np.diff(values, axis=1) < 0).mean()),
        "start_mm": float(values[:, 0].mean()),
        "goal_mm": float(values[:, -1].mean()),
        "left_at_goal": float((values[:, -1] / values[:, 0]).mean()),
    }


def sequence(seed: int, number: int, steps: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Looks (I) at a bed before, between and after its actions, and another look at its end."""
    rng = np.random.default_rng([seed, 5, number])
    for_bed, for_world = jax.random.split(jax.random.key(int(rng.integers(2**31))))
    world = SimulatedWorld(for_world, sim.irregular_bed(for_bed, HILLS), camera=CAMERA)

    def look() -> np.ndarray:
        return image_of_depth(world.look(), CAMERA, where="look").image

    looks = [look()]
    for _ in range(steps):
        name = str(rng.choice(sim.ACTIONS))
        place = rng.uniform(0.15, 0.85, 2) * (CAMERA.width, CAMERA.height)
        u, v = (float(x) for x in place)
        world.act(name, (u, v), float(rng.uniform(*STRENGTHS)))
        looks.append(look())
    return looks, look()
