"""`jshape execute PLAN`: a plan that was made before, action by action, with a look after each."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape.camera import differing, window_of
from jshape.cli.names import Bank
from jshape.cli.options import Share, plan_file
from jshape.cli.robot import Reprojects, Runs, asking, molded, new_session, resumed, robot_of, tell
from jshape.data.view import middle_depth
from jshape.errors import BadFile
from jshape.io import banks
from jshape.planning.options import DEFAULT_BANK, Constraints, StopCriteria
from jshape.planning.plan import Plan


@dataclass(frozen=True, kw_only=True)
class ExecuteOptions(Runs, Reprojects):
    """Of `jshape execute`."""

    bank: Bank | None = None
    """Bank that the plan was made with (default: pressed-flour-robot)."""
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
    bank = banks.load_bank(bank_name)
    foreign = window_of(made.camera, bank.camera) is None
    if foreign and made.initial is not None and all(hasattr(p, "seen_by") for p in bank.predictors):
        # Made with --window or --depth-range: on the frames of another camera, as they are.
        first = np.asarray(made.camera.depth(metric.unweigh(made.initial, made.camera)))
        bank = bank.seen_by(made.camera, middle_depth(first))
    confirm = asking(options)
    with robot_of(options, options.out, bank) as robot:
        if made.view is not None and not differing(made.view.source, robot.depth_camera.camera, ""):
            robot.view = made.view  # the same looks as those it was made for
        if session is None:
            known = {"what": "execute", "plan": str(plan), "bank": str(bank_name)}
            session = new_session(options, made.goal, robot, **known)
        stop = StopCriteria(max_steps=max(len(made), 1))
        constraints = Constraints(max_missing=options.max_missing)
        how = {"plan": made, "confirm": confirm, "stop": stop, "constraints": constraints}
        summary = molded(session, robot, bank, options, **how)
    return tell(summary)
