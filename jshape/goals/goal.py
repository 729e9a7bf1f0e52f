"""What is wanted of a bed, held to what the bed can give: depth, range, reach, slopes, volume."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jshape._typing import Bool, Float
from jshape.errors import BadImage, JShapeError, UnknownName, quoted
from jshape.goals.bedmap import BedMap
from jshape.goals.slopes import held
from jshape.goals.transport import Transport, transport
from jshape.sim.bed import DEPTH

BALANCES = ("around", "level")
"""How a volume is balanced: spread around the shape, or by moving the level of the whole bed."""
RIM = 0.04
"""Width of what is spread around a shape, metres: half of what a knock heaves is within it."""
LEAST = 1e-5
"""Changes of less are none, metres."""
ROUNDS = 8
"""Most tries of a balance."""
BALANCED = 0.002
"""A net volume below this share of what is moved is balanced."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What a bed can give."""

    steepest: float
    """Steepest slope that stands, rise over run."""
    floor: float = DEPTH
    """How deep the material is below the bed's level, metres."""
    reach: Bool[np.ndarray, "H W"] | None = None
    """Pixels of the frame where the bed may be changed; None is everywhere."""

    def __post_init__(self) -> None:
        for name in ("steepest", "floor"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise JShapeError(f"{name} is {quoted(value)}; it must be a number above 0")


class Balance(NamedTuple):
    """How a goal came to move as much in as out."""

    how: str
    """One of `BALANCES`."""
    most: float
    """Greatest height that was added (negative: taken away), metres."""
    before: float
    """Net volume without it, cm³."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A wanted bed that the real one can become, as far as material, slopes and camera go."""

    bed: BedMap
    """The bed now."""
    limits: Limits
    """What it was held to."""
    wanted: Float[np.ndarray, "Y X"]
    """Change of height that was asked for (and what balances it), metres, up."""
    change: Float[np.ndarray, "Y X"]
    """Change of height that is left of it, metres, up."""
    left: dict[str, np.ndarray]
    """Per reason what was asked for and is not in `change`, (Y, X) metres, up."""
    balance: Balance | None = None
    """How its volume was balanced; None: it was not."""
    like: np.ndarray | None = None
    """(H, W) the frame that the goal was taken from, where it was one."""

    @property
    def height(self) -> Float[np.ndarray, "Y X"]:
        """The surface wanted, metres above the bed's level."""
        return self.bed.height + self.change

    @cached_property
    def depth(self) -> Float[np.ndarray, "H W"]:
        """The depth image to plan for, metres, without gaps."""
        return self.bed.frame_with(self.height, self.like)

    @cached_property
    def transport(self) -> Transport:
        """How much material has to come from where."""
        return transport(self.bed, self.change)


def make_goal(
    bed: BedMap,
    wanted: Float[np.ndarray, "Y X"],
    limits: Limits,
    *,
    balance: str | None = None,
    like: np.ndarray | None = None,
) -> Goal:
    """The goal nearest to what is wanted that a bed can give, in the order of `Goal.left`.

    Where nobody saw the bed, or the hand does not reach, nothing changes; nothing goes below the
    material's floor or out of the camera's range; then slopes that do not stand are leaned inwards
    (`slopes.held`).  What the bed is already it may remain, be it too steep or too deep.

    Args:
      bed: seen from above.
      wanted: (Y, X) change of height, metres, up.
      limits: what the bed can give.
      balance: "around" spreads what is dug too much in a rim of `RIM` around the shape (or digs
        there what is missing); "level" moves the whole bed; None leaves the volume as it is.
      like: (H, W) the frame that `wanted` was taken from, if it was one.

    Raises:
      BadImage: another shape than the map's, or numbers that are not finite; nothing is wanted, or
        nothing where the bed was seen.
      UnknownName: no such balance.
    """
    if wanted.shape != bed.height.shape or not np.isfinite(wanted).all():
        raise BadImage(
            f"a change has shape {wanted.shape}; it must be {bed.height.shape} finite numbers"
        )
    wanted = np.where(bed.inside, wanted, 0.0).astype(np.float32)
    if np.abs(wanted).max() < LEAST:
        raise BadImage("the goal is the bed as it is: nothing of it would change")
    if not np.abs(wanted[bed.seen]).max() >= LEAST:
        raise BadImage("the goal lies where no camera saw the bed: place it where it was seen")
    change, left = _held_to(bed, wanted, limits)
    if balance is None:
        return Goal(bed, limits, wanted, change, left, like=like)
    if balance not in BALANCES:
        raise UnknownName("balance", balance, BALANCES)
    more = _rim(bed, wanted) if balance == "around" else bed.seen.astype(np.float32)
    before = float(change.sum(dtype=np.float64))

    def tried(amount: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        return _held_to(bed, wanted + np.float32(amount) * more, limits)

    if more.any():
        amount = _root(
            lambda a: float(tried(a)[0].sum(dtype=np.float64)),
            before,
            slope=float(more.sum(dtype=np.float64)),
            enough=BALANCED * float(np.abs(change).sum(dtype=np.float64)),
        )
        change, left = tried(amount)
    else:
        amount = 0.0
    said = Balance(balance, amount, 1e6 * bed.cell**2 * before)
    return Goal(bed, limits, wanted + np.float32(amount) * more, change, left, said, like)


def _held_to(
    bed: BedMap, wanted: np.ndarray, limits: Limits
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The change that is left of a wanted one, and what each limit took."""
    now = bed.height
    goal = now + wanted
    left = {}

    def hold(reason: str, allowed: np.ndarray) -> None:
        nonlocal goal
        left[reason] = np.where(allowed == goal, 0.0, goal - allowed).astype(np.float32)
        goal = allowed

    hold("not seen", np.where(bed.seen, goal, now))
    if limits.reach is not None:
        hold("out of reach", np.where(bed.at_nodes(limits.reach), goal, now))
    hold("deeper than the material", np.maximum(goal, np.minimum(now, -limits.floor)))
    near, far = float(bed.camera.z_min), float(bed.camera.z_max)
    if near < bed.level < far:
        held_in = np.maximum(goal, np.minimum(now, bed.level - far))
        held_in = np.minimum(held_in, np.maximum(now, bed.level - near))
        hold("beyond the camera's range", held_in)
    hold("too steep", held(now, goal, limits.steepest, bed.cell))
    return goal - now, left


def _rim(bed: BedMap, wanted: np.ndarray) -> np.ndarray:
    """A smooth ring around what changes, 1 at its crest, 0 at the shape and `RIM` from it."""
    away = np.asarray(ndimage.distance_transform_edt(np.abs(wanted) < LEAST, sampling=bed.cell))
    ring = np.sin(np.pi * np.clip(away / RIM, 0.0, 1.0)) ** 2
    return np.where(bed.seen, ring, 0.0).astype(np.float32)


def _root(net: Callable[[float], float], before: float, *, slope: float, enough: float) -> float:
    """Amount at which a rising function is 0, by secants; the best found where limits stop it."""
    last, last_net, amount = 0.0, before, -before / slope
    best, least = 0.0, abs(before)
    for _ in range(ROUNDS):
        if least <= enough:
            break
        now = net(amount)
        if abs(now) < least:
            best, least = amount, abs(now)
        if now == last_net:
            break
        amount, last, last_net = (amount - now * (amount - last) / (now - last_net), amount, now)
    return best
