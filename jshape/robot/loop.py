"""Look, plan, act, look again: the closed loop.

The plan is made anew after every action, or a batch of them that do not meet, from what the camera
sees, so that what came out otherwise than predicted is corrected by the actions that follow.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from jshape import metric
from jshape.actions import PlacedAction, first_pixels
from jshape.camera import Camera, check_same_camera
from jshape.data.noise import noise_of_change
from jshape.data.view import above, image_of_depth, known_in_both
from jshape.errors import JShapeError, quoted
from jshape.models.bank import Bank
from jshape.models.spread import UNLIKELY
from jshape.planning.api import Plan, check_image, plan_images, rollout
from jshape.planning.batch import batched, nearest
from jshape.planning.devices import Execution
from jshape.planning.options import Constraints, SearchBudget, SearchSpace, StopCriteria, hinted
from jshape.planning.problem import carries, names
from jshape.robot.checks import check_still, surprise_of, touched_by
from jshape.robot.probe import probe as probe_of


@runtime_checkable
class World(Protocol):
    """What the loop needs of a robot with a camera, real or simulated."""

    camera: Camera

    def look(self) -> np.ndarray:
        """Depth (H, W) in metres of the bed, nothing in front of it; 0 or NaN = no reading."""
        ...

    def act(
        self,
        action: str,
        position: tuple[float, float],
        strength: float = 1.0,
        yaw: float = 0.0,
        length: float = 1.0,
    ) -> None:
        """Apply an action at pixel (u, v), whole or not, and leave the camera's view.

        `strength` is how many times as deep as the trained action, `yaw` the turn of the hand from
        u towards v in radians, `length` how many times as long as the trained path its own is.
        They are passed only where they are not 1, 0 and 1: a hand may leave them out.
        """
        ...


class Stop(StrEnum):
    """Why the loop ended."""

    CONVERGED = "the distance is within the tolerance"
    NO_IMPROVEMENT = "no action is predicted to gain enough (--min-gain-mm, --error-margin)"
    MAX_STEPS = "as many actions as allowed"
    WORSE = "several looks in a row showed no lower distance than all before"
    BUDGET = "the time or the evaluations allowed for a plan were spent before anything helped"
    UNLIKELY = "two looks showed what the actions could not leave: has the bed or tool moved?"
    PLAN_ENDED = "the plan is at its end, and it was not to be made anew"
    DECLINED = "the next action was declined"


@dataclass(frozen=True, kw_only=True)
class Step(PlacedAction):
    """One action of the loop, its place rounded to a pixel."""

    before_mm: float
    """Distance to the goal before."""
    predicted_mm: float
    """Distance predicted after this action: within a batch from what was measured before it."""
    obtained_mm: float
    """Distance measured after it."""
    unlikely: bool = False
    """What the look shows is nothing that the bank's action could leave; always False where the
    plan was not made from the look before."""

    def line(self, number: int) -> str:
        """A line below `HEAD`."""
        u, v = self.position
        along = "by ({:+.0f},{:+.0f})".format(*self.stroke) if any(self.stroke) else ""
        return (
            f"{number:4d}  {self.action:5s} x{self.strength:4.2f} ({u:3d},{v:4d})  "
            f"{self.before_mm:8.3f}  {self.predicted_mm:9.3f}  {self.obtained_mm:9.3f}  {along}"
        ).rstrip()


PATIENCE = 3
"""Looks that show no progress, though they would, which end the loop.  An action that gains as much
as it errs by fails once in six times, three in a row once in 250; actions that gain nothing do so
once in eight.  A look is judged once the actions since the lowest distance were predicted to gain
more than the noise of two looks hides: what gains as much is hidden once in six times as well."""
SURPRISES = 2
"""Unlikely looks one after the other that end the loop: a single slip the next action mends."""
HEAD = "step  action                  before     predicted  obtained (mm to the goal)"
"""Above the lines of steps."""


@dataclass
class Molding:
    """What the loop did."""

    goal: np.ndarray
    """(H, W) the image wanted; where that is not known, the bed at the start."""
    first_plan: Plan
    """The whole plan from the first look: what an open loop would have done."""
    images: list[np.ndarray]
    """(H, W) images seen: at the start and after each action."""
    depths: list[np.ndarray]
    """(H, W) raw depths of the same looks, metres."""
    seen: list[np.ndarray | None]
    """(H, W) pixels that count in the same looks: known in the look and in the goal; None: all."""
    steps: list[Step] = field(default_factory=list)
    stop: Stop = Stop.MAX_STEPS

    @property
    def distances_mm(self) -> np.ndarray:
        """(K+1,) measured distances to the goal."""
        looks = zip(self.images, self.seen, strict=True)
        d = np.array([metric.distance(image, self.goal, seen) for image, seen in looks])
        return np.asarray(metric.to_mm(d, self.first_plan.camera))


@hinted
def mold(
    world: World,
    goal: np.ndarray,
    bank: Bank,
    *,
    planner: str = "greedy",
    space: SearchSpace = SearchSpace(),
    constraints: Constraints = Constraints(),
    stop: StopCriteria = StopCriteria(),
    budget: SearchBudget = SearchBudget(),
    execution: Execution = Execution(),
    horizon: int | None = None,
    batch: int = 1,
    patience: int | None = None,
    replan: bool = True,
    first: Plan | None = None,
    afresh: bool = False,
    watch: bool = False,
    probe: bool = False,
    learn: Callable[[PlacedAction, np.ndarray, np.ndarray], Bank] | None = None,
    confirm: Callable[[Plan], bool] | None = None,
    on_start: Callable[[float], None] | None = None,
    on_step: Callable[[Step, np.ndarray], None] | None = None,
) -> Molding:
    """Mold the world towards a goal, looking again after every action or batch of them.

    The first plan is for all actions; those after a look are for the ones that are left, at most
    `horizon`, and all planners but greedy begin with what is left of the plan before.  Greedy,
    whose first action does not depend on the later ones, then plans only that; for a batch, twice
    as many as it holds.  A look after a batch tells what each of its actions did, since their ROIs
    do not meet: images, depths and steps are by action, as if it had been looked at after each.

    Args:
      world: to look at and act in; its camera is the bank's.
      goal: (H, W) the weighed image wanted; seen from above a bed, NaN where that is not known:
        what is unknown there or hidden in a look counts nothing.
      bank: predicts the actions.
      planner: which search, as for `jshape.plan`.
      space: what is tried.
      constraints: what is allowed, of a look's missing pixels too.
      stop: when the loop ends: no action is predicted to gain enough, the goal is within the
        tolerance, or `max_steps` actions are done.
      budget: what each search may spend.
      execution: chunks and devices to evaluate candidates with.
      horizon: how many actions ahead a plan after a look is made for; None is all that are left.
      batch: actions between two looks, at most: those of the plan whose ROIs do not meet.
      patience: stop when so many looks one after the other showed no distance lower than all
        before, though by their noise, measured beside what was touched, they could have; None is
        `PATIENCE` where the plan is made anew, and never where it is not.
      replan: False applies the first plan to its end, blindly, as the paper does.
      first: the plan to begin with; None makes one from the first look.
      afresh: after each look, predict anew from it what is left of `first`, so that what an action
        starts from and what it is predicted to bring come from one look.
      watch: stop where the bed changed beside an action.
      probe: begin with a test press where the goal asks for nothing: see `robot.probe`.
      learn: called after each look with every action that was done, and I before and after it, NaN
        where there was no reading; its bank predicts from then on.
      confirm: called before each action with what is left of the plan, the action first; False ends
        the loop.
      on_start: called with how far the first look is from the image that `first` begins with, mm.
      on_step: called after each action with what it did and the depth (H, W) seen after it.

    Raises:
      BadCamera: the bank is for another camera than the world's.
      BadImage, MissingDepth: a look that is not a usable depth image.
      BedMoved: with `watch`, a bed that changed beside an action.
      JShapeError: whatever the world raises.
    """
    check_same_camera(bank.camera, world.camera, "the world's")
    wanted = np.isfinite(goal) if above(bank.camera) else None
    goal = check_image(goal if wanted is None else np.where(wanted, goal, 0), bank.camera, "goal")
    for name, value in (("horizon", horizon), ("batch", batch), ("patience", patience)):
        if value is None and name != "batch":
            continue
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise JShapeError(f"{name} is {quoted(value)}; it must be a whole number from 1")
    search = {"planner": planner, "space": space, "budget": budget, "execution": execution}
    tolerance = float(stop.tolerance_mm) / float(metric.to_mm(1.0, bank.camera))

    def look() -> _Look:
        depth = world.look()
        seen = image_of_depth(depth, bank.camera, max_missing=constraints.max_missing, where="look")
        if wanted is None:
            return _Look(depth, seen.image, goal, None, seen.known)
        both = known_in_both(seen.known, wanted, "look", "goal")
        return _Look(depth, seen.image, np.where(both, goal, seen.image), both, seen.known)

    def plan(now: _Look, **how: Any) -> Plan:
        return plan_images(bank, now.image, now.goal, now.seen, **how, **search)

    uses = dict(constraints.max_uses or {})  # what is left of each action's
    stock = constraints.stock_cm3
    moving = names(bank, carries(bank, space.carries))
    if patience is None and replan:
        patience = PATIENCE
    now = look()
    ahead = first
    if ahead is None and probe and now.distance > tolerance:
        test = probe_of(bank, now.image, now.goal, constraints, now.known)
        ahead = rollout(now.image, now.goal, [test], bank=bank, seen=now.seen)
    if ahead is None:
        ahead = plan(now, constraints=constraints.of_images(), stop=stop)
    elif on_start is not None:
        both = now.seen if now.seen is None or ahead.seen is None else now.seen & ahead.seen
        off = metric.distance(now.image, ahead.images[0], both)
        on_start(float(metric.to_mm(off, bank.camera)))
    if afresh:
        ahead = rollout(now.image, now.goal, ahead, bank=bank, seen=now.seen)
    whole = goal if wanted is None else np.where(wanted, goal, now.image)
    surprises = 0
    first_bank = bank  # one that learned from a surprise would find the next one likely
    run = Molding(whole, ahead, [now.image], [now.depth], [now.seen])
    obtained = float(metric.to_mm(now.distance, bank.camera))
    lowest, failures, promised = obtained, 0, 0.0
    while True:
        if len(ahead) == 0:
            run.stop = Stop[ahead.status.name] if replan or not run.steps else Stop.PLAN_ENDED
            return run
        left = stop.max_steps - len(run.steps) if replan else len(ahead)
        ahead, count = batched(ahead, max(min(batch, left), 1), reorder=replan)
        doing: list[PlacedAction] = []
        for k in range(count):
            if confirm is not None and not confirm(ahead.rest(k)):
                break
            world.act(ahead[k].action, ahead[k].position, **ahead[k].how)
            doing.append(ahead[k])
        declined = len(doing) < count
        if declined and not doing:
            run.stop = Stop.DECLINED
            return run
        before, now = now, look()
        planned = ahead.distances_mm.tolist()
        looks = [before, *before.towards(now, doing)]
        for k, (after, act) in enumerate(zip(looks[1:], doing, strict=True)):
            predicted = planned[k + 1] + (obtained - planned[k] if k else 0.0)
            run.depths.append(after.depth)
            run.images.append(after.image)
            run.seen.append(after.seen)
            start, obtained = obtained, float(metric.to_mm(after.distance, bank.camera))
            u, v = act.position
            done: dict[str, Any] = vars(act) | {"position": (round(u), round(v))}
            strange = (replan or afresh) and unlikely(first_bank, ahead, k, looks[k], after)
            distances = {"before_mm": start, "predicted_mm": predicted, "obtained_mm": obtained}
            step = Step(**done, **distances, unlikely=strange)
            run.steps.append(step)
            if on_step is not None:
                on_step(step, after.depth)
            if act.action in uses:
                uses[act.action] -= 1
        touched = np.any([touched_by(bank.camera, act) for act in doing], 0)
        if watch:
            check_still(before.depth, now.depth, touched)
        if learn is not None:
            for step, act, (old, new) in zip(
                run.steps[-len(doing) :], doing, pairwise(looks), strict=True
            ):
                if not step.unlikely:
                    bank = learn(act, old.readings, new.readings)
        if declined:
            run.stop = Stop.DECLINED
            return run
        surprises = surprises + 1 if any(step.unlikely for step in run.steps[-len(doing) :]) else 0
        if surprises >= SURPRISES:
            run.stop = Stop.UNLIKELY
            return run
        act = doing[-1]
        promised += planned[0] - planned[len(doing)]
        if not act.carries:  # what is taken out is brought before anything else is judged
            if obtained < lowest:
                lowest, failures, promised = obtained, 0, 0.0
            elif max(promised, obtained - lowest) > before.hides(now, touched, bank.camera):
                failures += 1
        if patience is not None and failures >= patience:
            run.stop = Stop.WORSE
            return run
        if stock is not None and any(act.action in moving for act in doing):
            moved = zip(doing, ahead.volumes_cm3.tolist(), strict=False)
            stock = max(stock - sum(cm3 for act, cm3 in moved if act.action in moving), 0.0)
        ahead = ahead.rest(count)
        if afresh or replan and act.carries:
            ahead = rollout(now.image, now.goal, ahead, bank=bank, seen=now.seen)
        elif replan:
            left = stop.max_steps - len(run.steps)
            if left <= 0:
                run.stop = Stop.CONVERGED if now.distance <= tolerance else Stop.MAX_STEPS
                return run
            # A carry is two actions, and of twice as many as it holds a batch is mostly filled.
            steps = (2 if moving or batch > 1 else 1) * batch
            steps = steps if planner == "greedy" else horizon or left
            ahead = plan(
                now,
                start=ahead,
                constraints=replace(constraints.of_images(), max_uses=uses, stock_cm3=stock),
                stop=replace(stop, max_steps=min(left, steps)),
            )


def unlikely(bank: Bank, plan: Plan, k: int, before: "_Look", after: "_Look") -> bool:
    """Whether a look after action k of a plan shows what that could not leave."""
    corner = first_pixels(plan.positions[k], plan.rois[k])
    window = tuple(slice(a, a + n) for a, n in zip(corner[::-1], plan.rois[k][::-1], strict=True))
    rois = before.image[window], plan.patches[k], after.readings[window]
    return surprise_of(bank, plan.actions[k], *rois) > UNLIKELY


class _Look(NamedTuple):
    """What was seen, and what of it counts."""

    depth: np.ndarray
    """(H, W) metres."""
    image: np.ndarray
    """(H, W) I, gaps filled."""
    goal: np.ndarray
    """(H, W) the image wanted; the image itself where it does not count."""
    seen: np.ndarray | None
    """(H, W) pixels that count; None: all."""
    known: np.ndarray
    """(H, W) pixels with a reading."""

    @property
    def readings(self) -> np.ndarray:
        """(H, W) I, NaN where there is no reading."""
        return np.where(self.known, self.image, np.float32(np.nan))

    def towards(self, last: "_Look", doing: Sequence[PlacedAction]) -> Iterator["_Look"]:
        """What would have been seen after each of the actions that lead to another look."""
        by = nearest(doing, self.depth.shape)
        for k in range(1, len(doing)):
            done, seen = by < k, None
            if self.seen is not None and last.seen is not None:
                seen = np.where(done, last.seen, self.seen)
            depth, image, goal, known = (
                np.where(done, getattr(last, name), getattr(self, name))
                for name in ("depth", "image", "goal", "known")
            )
            yield _Look(depth, image, goal, seen, known)
        yield last

    def hides(self, later: "_Look", touched: np.ndarray, camera: Camera) -> float:
        """Standard deviation that the noise of both looks gives to a change of distance, mm."""
        seen = np.ones_like(touched)
        for mask in (self.seen, later.seen):
            seen = seen if mask is None else seen & mask
        noise = noise_of_change(self.image, later.image, seen & ~touched, int(seen.sum()))
        return float(metric.to_mm(noise, camera))

    @property
    def distance(self) -> float:
        """To the goal."""
        return float(metric.distance(self.image, self.goal, self.seen))
