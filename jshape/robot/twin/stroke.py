"""How the bed gives way while the hand acts: `sim` says what becomes of it, the tool says when."""

from dataclasses import replace

import numpy as np

from jshape import sim
from jshape.robot.arms.base import ArmError, Doing
from jshape.robot.rigid import Pose, yaw_of
from jshape.robot.simulated import after_action, goes_along, placed_path
from jshape.robot.twin.model import FLOOR
from jshape.robot.twin.world import Twin

PARTS = 8
"""Parts of a path after each of which the bed is known: 11 mm of a sweep, half its width."""
LEAST = 0.02
"""A stroke that went less than this share of its way only touched the bed."""
WHOLE = 0.98
"""One that went further went all the way."""
REFRESH = 5
"""The bed moves every so many steps of the physics."""


def pours(doing: Doing) -> bool:
    """Whether an action brings material in the air: nothing but the hand moves.

    Raises:
      ArmError: one that goes along a path, and the procedure has none, or the other way round.
    """
    known = doing.action in sim.actions_of("robot")
    stroke = sim.stroke(doing.action) if known else None
    along = stroke is not None and goes_along(stroke)
    if along != (doing.way > 0):
        said = "goes along a path, and the procedure's act has no path_mm"
        other = "has a path_mm, and the twin's bed knows none of it"
        raise ArmError(f"{doing.action}: {said if along else other}")
    return stroke is not None and stroke.load is not None and not along


class BedStroke:
    """One stroke into a twin's bed, along it, or above it.

    The beds after parts of the stroke are computed first, from where the tool really is: before and
    after the fingers close or open, or after parts of a path.  While the tool goes down the surface
    goes to the first of them, and on from one to the next as the fingers do or the tool: the
    material recedes as fast as the hand comes, and what the hand feels is what does not.
    """

    def __init__(self, twin: Twin, doing: Doing, start: Pose, end: Pose):
        """A stroke that goes down from one pose of the tool to another (base frame).

        Raises:
          UnknownName: the simulator has no such action.
          BadPosition: the tool is not over the bed.
        """
        self._twin, self._doing = twin, doing
        to_bed, stroke = np.linalg.inv(twin.base_camera), sim.stroke(doing.action)
        self._yaw = yaw_of(to_bed @ end)  # as it was commanded: the physics errs by a little
        self._start, xy = start[:2, 3].copy(), (to_bed @ start)[:2, 3]
        self._pours = pours(doing)
        closes = not self._pours and bool((stroke.path[1] != stroke.path[2]).any())
        shares = [0.0, 1.0] if closes else [1.0]
        if doing.way:
            length, xy = placed_path(stroke, doing.way, xy, self._yaw)
            stroke = sim.lengthened(stroke, length)
            shares = np.linspace(0.0, 1.0, PARTS + 1).tolist()
        self._xy, self._stroke, self._key = xy.astype(np.float32), stroke, twin.next_key()
        self._before = twin.bed
        beds = [self._after(doing.strength, share) for share in shares]
        self._last = beds[-1]
        beds = [self._before, *beds] if self._pours else beds
        self._heights = np.stack([np.asarray(bed.height) for bed in beds])
        self._touch, self._to = start[2, 3], end[2, 3]
        # A hill beside the place may have met the hand before the surface there did.
        self._from = max(self._touch, self._surface())
        self._sunk, self._shown, self._gone, self._calls = 0.0, 0.0, 0.0, 0

    def down(self, tool: Pose) -> None:
        """The tool is here now (base frame)."""
        z = tool[2, 3]
        self._sunk = max(self._sunk, _share(self._from, z, self._to))
        # The surface stays as far behind the hand as it was when the hand felt it.
        self._shown = max(self._shown, _share(self._touch, z, self._to))
        if self._doing.way:
            gone = float(np.linalg.norm(tool[:2, 3] - self._start)) / self._doing.way
            self._gone = max(self._gone, min(gone, 1.0))
        self._show()

    def close(self, share: float) -> None:
        """The fingers have done this share of their way."""
        if not self._doing.way:
            self._gone = max(self._gone, share)
        self._show()

    def finish(self) -> None:
        """The stroke is over: the bed is what the way that was really gone makes of it."""
        twin, deep, gone = self._twin, self._sunk, self._gone
        if self._pours:
            deep, gone = gone, 1.0
        elif self._doing.way:
            if self._to >= self._touch - 1e-3:  # it goes in on the way, as a scoop
                deep = 0.0
            deep = 1.0 if gone >= LEAST else deep
        elif len(self._heights) == 1:  # no finger moves
            gone = 1.0
        deep = 1.0 if deep >= WHOLE else deep
        if deep < LEAST:
            twin.bed = self._before
        elif deep == 1.0 and gone >= WHOLE:
            twin.bed = self._last
        else:
            twin.bed = self._after(self._doing.strength * deep, gone)
        twin.show(np.asarray(twin.bed.height))

    def _after(self, strength: float, share: float) -> sim.Bed:
        """The bed after this share of the path, or of the fingers' way; the same repetition."""
        twin, stroke = self._twin, self._stroke
        if share < 1 and self._doing.way:
            stroke = sim.cut(stroke, share)
        elif share < 1:
            open_, closed = stroke.path[1:3]
            stroke = replace(stroke, path=stroke.path.at[2].set(open_ + share * (closed - open_)))
        given = (self._key, self._before, twin.material, stroke, self._xy, strength)
        return after_action(*given, beside=twin.beside, yaw=self._yaw, spread=twin.spread)

    def _surface(self) -> float:
        """Height of the bed where the tool is, base frame, metres."""
        height, cell = np.asarray(self._before.height), self._before.cell
        middle = (np.array(height.shape) - 1) / 2
        row, column = np.rint(self._xy[::-1] / cell + middle).astype(int)
        inside = 0 <= row < height.shape[0] and 0 <= column < height.shape[1]
        return FLOOR + float(height[row, column]) if inside else -np.inf

    def _show(self) -> None:
        self._calls += 1
        if self._calls % REFRESH:
            return
        known, before = self._heights, np.asarray(self._before.height)
        at = self._gone * (len(known) - 1)
        k = int(at)
        height = known[k] + (at - k) * (known[min(k + 1, len(known) - 1)] - known[k])
        on_the_way = self._pours or self._doing.way and self._gone >= LEAST
        self._twin.show(height if on_the_way else before + self._shown * (height - before))


def _share(first: float, now: float, last: float) -> float:
    """How much of the way down from first to last is done, 0 to 1."""
    return float(np.clip((first - now) / max(first - last, 1e-6), 0.0, 1.0))
