"""Look, plan, act, look again: the closed loop.

The plan is made anew after every action from what the camera sees, so that what came out
otherwise than predicted is corrected by the actions that follow.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from jshape import metric
from jshape.camera import Camera, check_same_camera
from jshape.data.view import image_of_depth
from jshape.planning import Plan, check_image, plan
from jshape.predict.bank import Bank


@runtime_checkable
class World(Protocol):
    """What the loop needs of a robot with a camera, real or simulated."""

    camera: Camera

    def look(self) -> np.ndarray:
        """Depth (H, W) in metres of the bed, nothing in front of it; 0 or NaN = no reading."""
        ...

    def act(self, action: str, position: tuple[int, int]) -> None:
        """Apply an action at pixel (u, v) and leave the camera's view."""
        ...


class Stop(StrEnum):
    """Why the loop ended."""

    CONVERGED = "the distance is within the tolerance"
    NO_IMPROVEMENT = "no action is predicted to help by more than the least gain"
    MAX_STEPS = "as many actions as allowed"
    WORSE = "the last action did not lower the distance"
    PLAN_ENDED = "the plan is at its end, and it was not to be made anew"


class Step(NamedTuple):
    """One action of the loop."""

    action: str
    position: tuple[int, int]
    """(u, v) pixels."""
    before_mm: float
    """Distance to the goal before."""
    predicted_mm: float
    """Distance predicted after this action."""
    obtained_mm: float
    """Distance measured after it."""


@dataclass
class Molding:
    """What the loop did."""

    goal: np.ndarray
    """(H, W) the image wanted."""
    first_plan: Plan
    """The whole plan from the first look: what an open loop would have done."""
    images: list[np.ndarray]
    """(H, W) images seen: at the start and after each action."""
    depths: list[np.ndarray]
    """(H, W) raw depths of the same looks, metres."""
    steps: list[Step] = field(default_factory=list)
    stop: Stop = Stop.MAX_STEPS

    @property
    def distances_mm(self) -> np.ndarray:
        """(K+1,) measured distances to the goal."""
        camera = self.first_plan.camera
        return np.array([metric.to_mm(metric.distance(i, self.goal), camera) for i in self.images])


def mold(
    world: World,
    goal: np.ndarray,
    bank: Bank,
    *,
    max_steps: int = 16,
    min_gain: float = 0.0,
    tolerance: float = 0.0,
    max_missing: float = 0.1,
    replan: bool = True,
    on_step: Callable[[Step, np.ndarray], None] | None = None,
    **options: Any,
) -> Molding:
    """Mold the world towards a goal, looking again after every action.

    Args:
      world: to look at and act in; its camera is the bank's.
      goal: (H, W) the weighed image wanted.
      bank: predicts the actions.
      max_steps: most actions.
      min_gain: an action must be predicted to lower d by more than this.
      tolerance: stop when d is at most this.
      max_missing: largest share of a look's pixels that may be filled.
      replan: False applies the first plan to its end, blindly, as the paper does.
      on_step: called after each action with what it did and the depth (H, W) seen after it.
      **options: passed on to `jshape.plan`.

    Raises:
      BadCamera: the bank is for another camera than the world's.
      BadImage, MissingDepth: a look that is not a usable depth image.
    """
    check_same_camera(bank.camera, world.camera, "the world's")
    goal = check_image(goal, bank.camera, "goal")
    options |= {"bank": bank, "min_gain": min_gain, "tolerance": tolerance}

    def look() -> tuple[np.ndarray, np.ndarray]:
        depth = world.look()
        seen = image_of_depth(depth, bank.camera, max_missing=max_missing, where="look")
        return depth, seen.image

    depth, image = look()
    ahead = plan(image, goal, max_steps=max_steps, **options)
    run = Molding(goal, ahead, [image], [depth])
    next_ = 0
    while True:
        if next_ == len(ahead):
            run.stop = Stop[ahead.status.name] if replan or not run.steps else Stop.PLAN_ENDED
            return run
        action, (u, v) = ahead.actions[next_], ahead.positions[next_].tolist()
        world.act(action, (u, v))
        depth, image = look()
        run.depths.append(depth)
        run.images.append(image)
        d = metric.distance(image, goal)
        obtained = float(metric.to_mm(d, bank.camera))
        before, predicted = (float(x) for x in ahead.distances_mm[next_ : next_ + 2])
        before = run.steps[-1].obtained_mm if run.steps else before
        step = Step(action, (u, v), before, predicted, obtained)
        run.steps.append(step)
        if on_step is not None:
            on_step(step, depth)
        if not replan:
            next_ += 1
            continue
        if obtained >= before:
            run.stop = Stop.WORSE
            return run
        if len(run.steps) == max_steps:
            run.stop = Stop.CONVERGED if d <= tolerance else Stop.MAX_STEPS
            return run
        # Only the next action is needed, but a plan of the rest takes a few ms, and its length
        # is a static shape: always the same one, so that nothing is compiled again.
        ahead = plan(image, goal, max_steps=max_steps, **options)
