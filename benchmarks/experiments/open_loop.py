"""Plans of several predictors for one goal, carried out without looking in between."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from benchmarks.experiments.banks import Recipe, simulated
from benchmarks.experiments.measures import Retrieval, retrieval
from benchmarks.experiments.problems import Applied
from jshape import metric, sim
from jshape.camera import PAPER_BOX
from jshape.data.view import image_of_depth
from jshape.errors import UnknownName
from jshape.io import banks
from jshape.learn.fit import fit
from jshape.models.bank import Bank
from jshape.planning.api import plan
from jshape.planning.options import PAPER, options
from jshape.planning.plan import Plan
from jshape.robot.simulated import SimulatedWorld

MIN_GAIN_MM = 0.005
"""What an action must gain of d where many are tried: about what a prediction errs by."""
MAX_STEPS = 8
"""Most actions of a plan."""


@dataclass(frozen=True)
class Method:
    """A way to plan."""

    predictor: str
    """As the paper names it: "f_D"."""
    bank: Bank
    trained_on: str
    """Whose actions on what the predictor has seen, such as "human, flour"."""
    where: str
    """At which places actions are tried, in words."""
    tried: Mapping[str, Any]
    """The same as keywords of `jshape.plan`."""
    least_mm: float = MIN_GAIN_MM
    """An action must help by more than this; 0.0 is the paper's Algorithm 1."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method made of a problem."""

    method: Method
    applied: tuple[Applied, ...]
    """What made the goal."""
    plan: Plan
    images: np.ndarray
    """(K+1, H, W) I as the camera saw it at the start and after each action."""
    distances_mm: np.ndarray
    """(K+1,) of them to the goal."""

    @property
    def found(self) -> Retrieval:
        """How much of what was applied the plan says."""
        return retrieval(self.applied, self.plan, self.plan.camera)

    @property
    def falls(self) -> bool:
        """Whether the distance diminishes at each step, as the paper saw it."""
        return len(self.plan) > 0 and bool((np.diff(self.distances_mm) < 0).all())

    @property
    def row(self) -> dict[str, Any]:
        """As columns of a result."""
        plan, method = self.plan, self.method
        return {
            "predictor": method.predictor,
            "trained_on": method.trained_on,
            "places": method.where,
            "applied": ", ".join(said(a.action, a.position, a.strength) for a in self.applied),
            "planned": ", ".join(
                said(act.action, at, act.strength)
                for act, at in zip(plan, plan.positions.tolist(), strict=True)
            ),
            "actions": len(plan),
            "before_mm": float(self.distances_mm[0]),
            "predicted_mm": float(plan.distances_mm[-1]),
            "obtained_mm": float(self.distances_mm[-1]),
            "predicted_left": float(plan.distances_mm[-1] / plan.distances_mm[0]),
            "obtained_left": float(self.distances_mm[-1] / self.distances_mm[0]),
            "falls": self.falls,
            "retrieved": self.found.retrieved,
            "exact": bool(self.found.exact),
            "predicted_each_mm": " ".join(f"{d:.4f}" for d in plan.distances_mm),
            "obtained_each_mm": " ".join(f"{d:.4f}" for d in self.distances_mm),
        }


def said(action: str, position: Sequence[int], strength: float = 1.0) -> str:
    """An action in words: "knock x1.6 (239, 197)"."""
    deep = "" if round(strength, 2) == 1 else f" x{strength:.1f}"
    return f"{action}{deep} ({position[0]}, {position[1]})"


def told(
    method: Method,
    start: np.ndarray,
    goal: np.ndarray,
    applied: Sequence[Applied],
    world: SimulatedWorld,
) -> Outcome:
    """Plan once and carry the plan out.

    Args:
      method: how to plan.
      start: (H, W) the image planned from, which nobody looks at again.
      goal: (H, W) the image wanted.
      applied: what made it.
      world: the bed as it is at the start; it is changed.
    """
    camera = method.bank.camera
    search = options(
        PAPER, bank=method.bank, max_steps=MAX_STEPS, min_gain_mm=method.least_mm, **method.tried
    )
    made = plan(start, goal, **search)
    images = [start]
    for act in made:
        world.act(act.action, act.position, **act.how)
        images.append(seen(world))
    distances = [metric.to_mm(metric.distance(image, goal), camera) for image in images]
    return Outcome(
        method, tuple(applied), made, np.stack(images), np.asarray(distances, np.float64)
    )


def seen(world: SimulatedWorld) -> np.ndarray:
    """I of the bed as the noisy camera sees it."""
    return image_of_depth(world.look(), world.camera, where="look").image


def looked_at(seed: int, bed: sim.Bed, material: str = "flour") -> np.ndarray:
    """The same of a bed in no world."""
    return seen(SimulatedWorld(jax.random.key(seed), bed, material=material))


def noise_in_words(bed: sim.Bed) -> str:
    """How far two looks at one bed are apart: no plan can leave less."""
    first, second = (looked_at(seed, bed) for seed in (0, 1))
    apart = float(metric.to_mm(metric.distance(first, second), PAPER_BOX))
    return (
        "Distances are between what the camera sees: two looks at one bed are already "
        f"{apart:.2f} mm apart, by its noise."
    )


def mean_bank(material: str, agent: str, pairs: int, seed: int) -> Bank:
    """f_D of five actions, fitted to so many simulated pairs of each."""
    return fit(simulated(Recipe(material, agent, seed), pairs, seed), "D")


def pressed_bank(material: str, agent: str) -> Bank:
    """f_P as it is bundled."""
    return banks.load_bank(Recipe(material, agent, 0).name)


def with_actions(bank: Bank, names: Sequence[str]) -> Bank:
    """The bank with these of its actions only.

    Raises:
      UnknownName: it has no such action.
    """
    for name in names:
        if name not in bank.actions:
            raise UnknownName("action", name, bank.actions)
    kept = [bank.actions.index(name) for name in names]
    rows = np.array(kept, int)
    known = {
        name: table[rows]
        for name in ("errors_mm", "intervals")
        if (table := getattr(bank, name)) is not None
    }
    predictors = tuple(bank.predictors[k] for k in kept)
    return replace(bank, predictors=predictors, actions=tuple(names), **known)
