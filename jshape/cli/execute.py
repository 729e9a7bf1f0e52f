"""`jshape execute PLAN`: a plan that was made before, action by action, with a look after each."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from jshape import metric
from jshape.camera import differing, window_of
from jshape.cli import arguments
from jshape.cli.robot import (
    add_robot,
    add_run,
    asking,
    may_move,
    resumed,
    robot_of,
    tell,
)
from jshape.data.view import middle_depth
from jshape.errors import BadFile
from jshape.io import banks
from jshape.planning.options import DEFAULT_BANK, Constraints, StopCriteria
from jshape.planning.plan import Plan
from jshape.robot.loop import HEAD
from jshape.robot.session import Session
from jshape.viz.pictures import molding_pictures


def execute(options: argparse.Namespace) -> dict[str, Any]:
    """Carry a plan out."""
    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    path = options.plan / "plan.json" if options.plan.is_dir() else options.plan
    plan = Plan.from_json(path)
    if plan.goal is None:
        raise BadFile(f"{path}: holds no images, so nothing says what is wanted")
    session = resumed(options, say) if options.resume else None
    bank = banks.load_bank(options.bank or DEFAULT_BANK)
    foreign = window_of(plan.camera, bank.camera) is None
    if foreign and plan.initial is not None and all(hasattr(p, "seen_by") for p in bank.predictors):
        # Made with --window or --depth-range: on the frames of another camera, as they are.
        first = np.asarray(plan.camera.depth(metric.unweigh(plan.initial, plan.camera)))
        bank = bank.seen_by(plan.camera, middle_depth(first))
    confirm = asking(options)
    with robot_of(options, bank, say) as robot:
        if plan.view is not None and not differing(plan.view.source, robot.eye.camera, ""):
            robot.view = plan.view  # the same looks as those it was made for
        if session is None:
            meta = {
                "what": "execute", "plan": str(options.plan), "arm": options.arm,
                "camera": robot.eye.name, "bank": str(options.bank or DEFAULT_BANK),
            }  # fmt: skip
            session = Session.start(
                options.out, plan.goal, meta, overwrite=options.overwrite, say=say
            )
        may_move(options)
        say(HEAD)
        summary = session.mold(
            robot, bank, plan=plan, confirm=confirm, blind=options.arm == "dry",
            draw=molding_pictures(bank.rois), stop=StopCriteria(max_steps=max(len(plan), 1)),
            constraints=Constraints(max_missing=options.max_missing),
        )  # fmt: skip
    if not options.json:
        tell(summary)
    return summary


def add(commands: Any) -> None:
    """The parser of `jshape execute`."""
    parser = arguments.command(commands, "execute", execute)
    parser.add_argument("plan", type=Path, help="what `jshape plan --out` wrote")
    add_robot(parser)
    add_run(parser)
    parser.add_argument("--bank", default=None, help="of the plan (default: the bundled one)")
    parser.add_argument(
        "--max-missing", type=arguments.share, default=0.1,
        help="largest share of pixels without depth to fill (0.1)",
    )  # fmt: skip
