"""What `jshape mold` and `jshape execute` share: robot, question, pictures of the run."""

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jshape.commands import arguments
from jshape.errors import JShapeError
from jshape.planned import Plan
from jshape.predict.bank import Bank
from jshape.robot.arms.names import KINDS as ARMS
from jshape.robot.arms.names import open_arm
from jshape.robot.cameras.names import open_camera
from jshape.robot.loop import Molding
from jshape.robot.robot import Robot
from jshape.store.poses import read_base_camera
from jshape.store.procedures import load_hand
from jshape.viz import pictures

HEAD = "step  action                  before     predicted  obtained (mm to the goal)"


@contextmanager
def robot_of(options: argparse.Namespace, bank: Bank, say: Callable[[str], Any]) -> Iterator[Robot]:
    """The robot that the options name; stopped and closed at the end, at home if people agree.

    Raises:
      JShapeError: no such arm or camera, or no camera for an arm that brings none.
    """
    opened = open_arm(options.arm, bank.camera, material=options.material, say=say)
    eye, base_camera = opened.eye, opened.base_camera
    if options.camera is not None:
        if eye is not None:
            eye.close()
        eye = open_camera(options.camera, camera=options.camera_file)
    if eye is None:
        raise JShapeError(f"the arm {options.arm} brings no camera; name one with --camera")
    if options.base is not None:
        base_camera = read_base_camera(options.base, options.gripper)
    robot = Robot(
        eye, opened.arm, load_hand(options.hand), bank.camera,
        base_camera=base_camera, frames=options.frames, reproject=options.reproject,
    )  # fmt: skip
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield robot
    except BaseException:
        robot.arm.stop()
        _offer_home(robot, options.yes)
        raise
    finally:
        robot.close()
        signal.signal(signal.SIGTERM, before)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _offer_home(robot: Robot, yes: bool) -> None:
    """Ask whether the arm should go home after whatever stopped it; nobody there: it stays."""
    if yes or not sys.stdin.isatty():
        print("the arm is stopped where it is", file=sys.stderr)
        return
    try:
        if _asked("the arm is stopped; go home? [y/N] ") == "y":
            robot.arm.home()
    except (JShapeError, KeyboardInterrupt) as problem:
        robot.arm.stop()
        print(f"jshape: not at home: {problem}", file=sys.stderr)


def asking(options: argparse.Namespace) -> Callable[[Plan], bool] | None:
    """What asks before each action; None where `--yes` says that nobody is to be asked.

    Raises:
      JShapeError: there is nobody to ask.
    """
    if options.yes:
        return None
    if not sys.stdin.isatty():
        raise JShapeError("nobody can be asked here; --yes acts without asking")
    all_of_them = False

    def ask(ahead: Plan) -> bool:
        nonlocal all_of_them
        if all_of_them:
            return True
        u, v = (round(float(x)) for x in ahead.exact_positions[0])
        d = ahead.distances_mm
        print(
            f"next: {ahead.actions[0]} x{float(ahead.strengths[0]):.2f} at ({u}, {v}), "
            f"{np.degrees(float(ahead.yaws[0])):.0f}°: {d[0]:.3f} -> {d[1]:.3f} mm",
            file=sys.stderr,
        )
        answer = _asked("act? [y]es, [a]ll, [N]o: ")
        all_of_them = answer == "a"
        return answer in ("y", "a")

    return ask


def _asked(question: str) -> str:
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower()[:1]


def draw(rois: Mapping[str, tuple[int, int]]) -> Callable[[Molding], dict[str, bytes]]:
    """The pictures of a run."""

    def pictured(result: Molding) -> dict[str, bytes]:
        first = result.first_plan
        names = ["at the start", *(f"after {k + 1} {s.action}" for k, s in enumerate(result.steps))]
        strip = pictures.strip_figure([*result.images, result.goal], [*names, "goal"], first.camera)
        made = {"steps.png": pictures.png(strip)}
        if first.initial is not None:
            story = pictures.plan_figure(
                first, obtained=result.images[-1], obtained_mm=result.distances_mm,
                rois=dict(rois), title="the first plan, and what was obtained",
            )  # fmt: skip
            made["result.png"] = pictures.png(story)
        return made

    return pictured


def tell(summary: Mapping[str, Any]) -> None:
    """Print how a run ended."""
    print(f"stopped: {summary['why']}")
    print(
        f"distance to the goal: {summary['before_mm']:.3f} mm before, "
        f"{summary['obtained_mm']:.3f} mm obtained"
    )
    print(f"run and pictures: {summary['out']}")


def add_robot(parser: argparse.ArgumentParser) -> None:
    """The options that say which robot, and how it acts."""
    arms = ", ".join(f"{kind.example} ({kind.what})" for kind in ARMS.values())
    parser.add_argument("--arm", default="dry", metavar="ARM", help=f"{arms}; default: dry")
    parser.add_argument(
        "--camera", metavar="CAMERA", help="as for `jshape record`; default: the arm's own"
    )
    parser.add_argument(
        "--camera-file", type=Path, metavar="FILE", help="camera.json to believe instead"
    )
    parser.add_argument(
        "--reproject", action="store_true", help="the camera is another than the bank's"
    )
    parser.add_argument(
        "--base", type=Path, metavar="POSE", help="of the camera, from `jshape calibrate`"
    )
    parser.add_argument(
        "--gripper", type=Path, metavar="POSE", help="of the gripper, for a camera in the hand"
    )
    parser.add_argument(
        "--hand", type=Path, metavar="FOLDER", help="limits.yaml and ACTION.yaml (the twin's)"
    )
    parser.add_argument("--material", default="flour", help="of a simulated bed (flour)")
    parser.add_argument(
        "--frames", type=arguments.positive_count, default=15, help="of a look (15)"
    )
    parser.add_argument("--yes", action="store_true", help="act without asking")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument(
        "--resume", action="store_true", help="go on with the run in --out from what is seen now"
    )
