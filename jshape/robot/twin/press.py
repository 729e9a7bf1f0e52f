"""How the bed gives way while the hand acts: `sim` says what becomes of it, the tool says when."""

from dataclasses import replace

import jax
import numpy as np

from jshape import sim
from jshape.robot.arms.base import Doing
from jshape.robot.rigid import Pose, yaw_of
from jshape.robot.twin.model import FLOOR
from jshape.robot.twin.world import Twin

LEAST = 0.02
"""A stroke that went less than this share of its way only touched the bed."""
WHOLE = 0.98
"""One that went further went all the way."""


class BedPress:
    """One stroke into a twin's bed.

    The bed after it is computed first, at the place where the tool really is, and once more with
    the stroke cut off before the fingers close.  While the tool goes down the surface goes from the
    first to the cut one, while the fingers close from there to the last: the material recedes as
    fast as the hand comes, and what the hand feels is what does not.
    """

    def __init__(self, twin: Twin, doing: Doing, start: Pose, end: Pose, refresh: int):
        """A stroke from one pose of the tool to another (base frame), shown every `refresh` steps.

        Raises:
          UnknownName: the simulator has no such action.
          BadPosition: the tool is not over the bed.
        """
        self._twin, self._doing, self._refresh = twin, doing, refresh
        to_bed = np.linalg.inv(twin.base_camera)
        x, y, _ = (to_bed @ start)[:3, 3].tolist()
        self.xy = x, y
        """Where the tool touched, in the bed's frame, metres."""
        self._yaw = yaw_of(to_bed @ end)  # as it was commanded: the physics errs by a little
        self._stroke = sim.stroke(doing.action)
        self._key = twin.next_key()
        self._before = twin.bed
        self._touch, self._to = start[2, 3], end[2, 3]
        # A hill beside the place may have met the hand before the surface there did.
        self._from = max(self._touch, self._surface())
        self._closes = bool((self._stroke.path[1] != self._stroke.path[2]).any())
        self._last = self._after(doing.strength, 1.0)
        low = self._after(doing.strength, 0.0) if self._closes else self._last
        self._low = np.asarray(low.height)
        self._sunk, self._shown, self._shut, self._calls = 0.0, 0.0, 0.0, 0

    def down(self, tool: Pose) -> None:
        """The tool is here now (base frame)."""
        z = tool[2, 3]
        self._sunk = max(self._sunk, share_of(self._from, z, self._to))
        # The surface stays as far behind the hand as it was when the hand felt it.
        self._shown = max(self._shown, share_of(self._touch, z, self._to))
        self._show()

    def close(self, share: float) -> None:
        """The fingers have done this share of their way."""
        self._shut = max(share, self._shut)
        self._show()

    def finish(self) -> None:
        """The stroke is over: the bed is what the way that was really gone makes of it."""
        twin = self._twin
        shut = self._shut if self._closes else 1.0
        if self._sunk < LEAST:
            twin.bed = self._before
        elif self._sunk >= WHOLE and shut >= WHOLE:
            twin.bed = self._last
        else:
            deep = 1.0 if self._sunk >= WHOLE else self._sunk
            twin.bed = self._after(self._doing.strength * deep, shut)
        twin.show(np.asarray(twin.bed.height))

    def _after(self, strength: float, shut: float) -> sim.Bed:
        """The bed after the stroke, the fingers closed by this share of their way."""
        twin, stroke = self._twin, self._stroke
        if shut < 1.0:
            path = stroke.path
            path = path.at[2].set(path[1] + shut * (path[2] - path[1]))
            stroke = replace(stroke, path=path)
        # The key is used again: it is the same repetition, cut off or less deep.
        key = jax.random.wrap_key_data(jax.random.key_data(self._key))
        how = {"strength": strength, "yaw": self._yaw, "spread": twin.spread}
        return sim.apply_action(key, self._before, twin.material, stroke, self.xy, **how)

    def _surface(self) -> float:
        """Height of the bed where the tool is, base frame, metres."""
        height, cell = np.asarray(self._before.height), self._before.cell
        middle = (np.array(height.shape) - 1) / 2
        row, column = np.rint(np.array(self.xy[::-1]) / cell + middle).astype(int)
        inside = 0 <= row < height.shape[0] and 0 <= column < height.shape[1]
        return FLOOR + float(height[row, column]) if inside else -np.inf

    def _show(self) -> None:
        self._calls += 1
        if self._calls % self._refresh:
            return
        before, low = np.asarray(self._before.height), self._low
        height = before + self._shown * (low - before)
        height += self._shut * (np.asarray(self._last.height) - low)
        self._twin.show(height)


def share_of(first: float, now: float, last: float) -> float:
    """How much of the way down from first to last is done, 0 to 1."""
    return float(np.clip((first - now) / max(first - last, 1e-6), 0.0, 1.0))
