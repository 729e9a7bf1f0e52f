"""How the bed gives way while the hand moves material: `sim` says what, the tool says when."""

import numpy as np

from jshape import sim
from jshape.robot.arms.base import ArmError, Doing
from jshape.robot.rigid import Pose, yaw_of
from jshape.robot.simulated import after_action, goes_along, placed_path
from jshape.robot.twin.press import LEAST, WHOLE, share_of
from jshape.robot.twin.world import Twin

PARTS = 8
"""Parts of a path after each of which the bed is known: 11 mm of a sweep, half its width."""


def moves(doing: Doing) -> bool:
    """Whether an action moves material.

    Raises:
      ArmError: one that does so along a path, and the procedure has none, or the other way round.
    """
    known = doing.action in sim.actions_of("robot")
    stroke = sim.stroke(doing.action) if known else None
    along = stroke is not None and goes_along(stroke)
    if along != (doing.way > 0):
        said = "goes along a path, and the procedure's act has no path_mm"
        other = "has a path_mm, and the twin's bed knows none of it"
        raise ArmError(f"{doing.action}: {said if along else other}")
    return stroke is not None and stroke.load is not None


class BedPath:
    """One stroke along a twin's bed, or above it.

    The beds after parts of the path are computed first, from where the tool really goes down.
    While the tool goes down the surface goes to the first of them, and on from one to the next as
    the tool does; what a hand pours comes as it opens.
    """

    def __init__(self, twin: Twin, doing: Doing, start: Pose, end: Pose, refresh: int):
        """A stroke that goes down from one pose of the tool to another (base frame).

        It is shown every `refresh` steps.

        Raises:
          BadPosition: the place is not over the bed.
        """
        self._twin, self._doing, self._refresh = twin, doing, refresh
        to_bed, stroke = np.linalg.inv(twin.base_camera), sim.stroke(doing.action)
        self._yaw = yaw_of(to_bed @ end)  # as it was commanded: the physics errs by a little
        self._start = start[:2, 3].copy()
        xy = (to_bed @ start)[:2, 3]
        shares = [1.0]
        if doing.way:
            length, xy = placed_path(stroke, doing.way, xy, self._yaw)
            stroke = sim.lengthened(stroke, length)
            shares = np.linspace(0.0, 1.0, PARTS + 1).tolist()
        self._xy, self._stroke, self._key = xy.astype(np.float32), stroke, twin.next_key()
        self._before = twin.bed
        self._beds = [self._after(doing.strength, share) for share in shares]
        heights = [np.asarray(bed.height) for bed in self._beds]
        self._heights = np.stack(heights if doing.way else [self._before.height, *heights])
        self._touch, self._to = start[2, 3], end[2, 3]
        self._sunk, self._gone, self._calls = 0.0, 0.0, 0

    def down(self, tool: Pose) -> None:
        """The tool is here now (base frame)."""
        if self._doing.way:
            self._sunk = max(self._sunk, share_of(self._touch, tool[2, 3], self._to))
            gone = float(np.linalg.norm(tool[:2, 3] - self._start)) / self._doing.way
            self._gone = max(self._gone, min(gone, 1.0))
        self._show()

    def close(self, share: float) -> None:
        """The fingers have done this share of their way: a hand above the bed opens."""
        if not self._doing.way:
            self._gone = max(share, self._gone)
        self._show()

    def finish(self) -> None:
        """The stroke is over: the bed is what the way that was really gone makes of it."""
        twin, gone, deep = self._twin, self._gone, self._doing.strength
        if not self._doing.way:
            none, partly = gone < LEAST, (deep * gone, 1.0)
        else:
            level = self._to >= self._touch - 1e-3  # it goes in on the way, as a scoop
            sunk = 1.0 if level or self._sunk >= WHOLE or gone > LEAST else self._sunk
            none, partly = sunk < LEAST or level and gone < LEAST, (deep * sunk, gone)
        if none:
            twin.bed = self._before
        else:
            twin.bed = self._beds[-1] if gone >= WHOLE else self._after(*partly)
        twin.show(np.asarray(twin.bed.height))

    def _after(self, strength: float, share: float) -> sim.Bed:
        """The bed after this share of the path."""
        twin = self._twin
        stroke = sim.cut(self._stroke, share) if share < 1 else self._stroke
        given = (self._key, self._before, twin.material, stroke, self._xy, strength)
        return after_action(*given, beside=twin.beside, yaw=self._yaw, spread=twin.spread)

    def _show(self) -> None:
        self._calls += 1
        if self._calls % self._refresh:
            return
        known = self._heights
        at = self._gone * (len(known) - 1)
        k = min(int(at), len(known) - 2)
        height = known[k] + (at - k) * (known[k + 1] - known[k])
        if self._doing.way and self._gone < LEAST:
            before = np.asarray(self._before.height)
            height = before + self._sunk * (height - before)
        self._twin.show(height)
