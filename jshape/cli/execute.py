"""`jshape execute PLAN`: a plan that was made before, action by action, with a look after each."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import differing
from jshape.cli.names import Bank
from jshape.cli.options import Nonnegative, Share, plan_file
from jshape.cli.robot import Runs, asking, molded, new_session, resumed, robot_of
from jshape.cli.tables import say
from jshape.data.view import View, above
from jshape.errors import BadFile
from jshape.planning.maps import bank_for
from jshape.planning.options import DEFAULT_BANK, Constraints, StopCriteria
from jshape.planning.plan import Plan
from jshape.robot.learning import bank_of

OTHER = 2.0
"""Times a frame's noise by which two looks at one bed differ at most: 1.4 where each is one frame,
and as much again for what seeing it from above adds."""


@dataclass(frozen=True, kw_only=True)
class ExecuteOptions(Runs):
    """Of `jshape execute`."""

    bank: Bank | None = None
    """Bank that the plan was made with (default: pressed-flour-robot)."""
    stock_cm3: Nonnegative | None = None
    """Material in a stock beside the bed of --arm sim, cm³, that actions may bring."""
    max_missing: Share = Constraints.max_missing
    """Largest share, 0 to 1, of pixels without a reading that may be filled."""


def execute(plan: Path, /, options: ExecuteOptions) -> dict[str, Any]:
    """Carry a plan out.

    Args:
      plan: What `jshape plan --out` wrote.
    """
    path = plan_file(plan)
    made = Plan.from_json(path)
    if made.goal is None:
        raise BadFile(f"{path}: holds no images, so nothing says what is wanted")
    session = resumed(options) if options.resume else None
    bank_name = options.bank or DEFAULT_BANK
    bank = bank_of(bank_name)
    confirm = asking(options)
    with robot_of(options, options.out, bank) as robot:
        eye, view = robot.depth_camera.camera, made.view
        posed = view is not None and None not in (eye.pose, view.source.pose)
        placed = posed or view is None or view.window is not None  # by both poses, or on a map
        if above(made.camera):
            bank = bank_for(bank, made.camera)
            robot.camera = bank.camera
        if above(made.camera) and placed:
            robot.view = View(eye, bank.camera)  # from wherever it stands
        elif view is not None and not differing(view.source, eye, ""):
            robot.view = view  # the same looks as those it was made for
        if session is None:
            known = {"what": "execute", "plan": str(plan), "bank": str(bank_name)}
            goal = made.goal if made.seen is None else np.where(made.seen, made.goal, np.nan)
            session = new_session(options, goal, robot, **known)
        stop = StopCriteria(max_steps=max(len(made), 1))
        constraints = Constraints(max_missing=options.max_missing)
        how = {"plan": made, "confirm": confirm, "stop": stop, "constraints": constraints}
        if not options.resume:
            how["on_start"] = lambda off_mm: _compare(off_mm, OTHER * robot.noise_mm)
        return molded(session, robot, bank, options, **how)


def _compare(off_mm: float, most: float) -> None:
    """Warn of a bed that is not the plan's."""
    if off_mm > most:
        say(
            f"warning: the bed lies {off_mm:.2f} mm from the one that the plan was made for; two "
            f"looks at one bed differ by at most {most:.2f} mm: is it another, or was it changed?"
        )
