"""What `jshape mold` and `jshape execute` share: robot, question, pictures of the run."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from jshape.cli.camera import CAMERA_HELP, Camera, Looks, every
from jshape.cli.names import Simulates
from jshape.cli.options import File, PositiveCount, Writes
from jshape.cli.tables import say
from jshape.data.fusion import check_poses
from jshape.errors import JShapeError, one_line
from jshape.io import folders, runs
from jshape.io.cameras import read_camera
from jshape.io.simulated import material_of
from jshape.models.bank import Bank
from jshape.planning.plan import Plan
from jshape.robot.arms.base import ArmSettings, stop_arm
from jshape.robot.arms.guarded import GuardedArm
from jshape.robot.arms.names import ARMS, open_arm
from jshape.robot.cameras.base import DepthCamera
from jshape.robot.cameras.guarded import GuardedCamera
from jshape.robot.loop import HEAD
from jshape.robot.pose_file import read_base_camera
from jshape.robot.procedure_file import load_hand
from jshape.robot.registry import described
from jshape.robot.robot import Robot
from jshape.robot.session import CONTENTS, Session
from jshape.robot.signals import interruptible, uninterrupted
from jshape.viz.pictures import molding_pictures

if TYPE_CHECKING:
    Arm = str
else:
    Arm = Annotated[Literal[tuple(ARMS)] | str, Parameter(metavar="ARM", help=described(ARMS))]


_CAMERAS = f"{CAMERA_HELP} (default: the arm's own); repeat it for more cameras of one bed"


@dataclass(frozen=True, kw_only=True)
class Robots(Looks, Simulates):
    """Which robot acts, and how it looks."""

    arm: Arm | None = "dry"
    camera: Annotated[list[Camera] | None, Parameter(help=_CAMERAS)] = None
    camera_file: Annotated[list[Path] | None, File] = None
    """camera.json to use instead of what the camera says of itself; of several cameras one for
    each, with a pose. Without --camera: of the camera over the bed of --arm sim."""
    temporal: Annotated[bool, Parameter(negative="--no-temporal")] = True
    base: Annotated[Path | None, Parameter(metavar="POSE")] = None
    """Pose of the (first) camera, from `jshape calibrate`."""
    gripper: Annotated[Path | None, Parameter(metavar="POSE")] = None
    """Pose of the gripper when the camera looks, for a camera in the hand."""
    hand: Annotated[Path | None, Parameter(metavar="FOLDER")] = None
    """Folder of the hand's limits.yaml and ACTION.yaml (default: the twin's)."""
    frames: PositiveCount = 15
    """Number of frames whose median is one look."""


@dataclass(frozen=True, kw_only=True)
class Runs(Robots, Writes):
    """Where a run is kept, and whether anybody is asked."""

    arm: Arm = "dry"
    out: Path
    """Folder for the run."""
    yes: bool = False
    """Act without asking."""
    resume: bool = False
    """Resume the run in --out from what is seen now."""
    batch: PositiveCount = 1
    """Most actions between two looks; only actions whose ROIs do not meet are done together."""


@contextmanager
def robot_of(options: Any, out: Path, bank: Bank) -> Iterator[Robot]:
    """The robot that the options name; stopped and closed at the end, at home if people agree.

    Everything is read before the arm is opened, which is the last thing that can fail.
    """
    run = options if isinstance(options, Runs) else None
    if run is None or not run.resume:
        whole = (*runs.CONTENTS, *CONTENTS)
        folders.check_target(out, run is not None and run.overwrite, contents=whole)
    hand, material = load_hand(options.hand), material_of(options.material)
    files = [str(file) for file in options.camera_file or ()]
    described = [read_camera(file, 1.0)[0] for file in files]
    check_poses(described, files)
    base_camera = options.base and read_base_camera(options.base, options.gripper)
    with ExitStack() as stack:
        stack.enter_context(interruptible())
        eyes = [_guarded(stack, one) for one in _eyes(options)]
        cameras = [] if eyes else described
        stock = getattr(options, "stock_cm3", None) or 0.0
        settings = ArmSettings(bank.camera, material, say, cameras, stock)
        opened = open_arm(options.arm, settings)
        arm = GuardedArm(opened.arm)
        stack.callback(_let_go, arm)
        stack.callback(stop_arm, arm)
        if not eyes:
            if opened.depth_camera is None:
                raise JShapeError(f"the arm {options.arm} brings no camera; name one with --camera")
            eyes = [_guarded(stack, one) for one in (opened.depth_camera, *opened.others)]
            base_camera = opened.base_camera if base_camera is None else base_camera
        if base_camera is None and opened.moves:
            raise JShapeError(
                f"nothing says where {eyes[0].name} is in the frame of {opened.arm.name}; --base "
                "takes what `jshape calibrate` wrote"
            )
        how = {"base_camera": base_camera, "others": eyes[1:], "frames": options.frames}
        robot = Robot(eyes[0], arm, hand, bank.camera, **how)
        try:
            yield robot
        except BaseException as problem:
            with uninterrupted():
                broken = stop_arm(arm)
                for said in getattr(problem, "__notes__", ()):  # how the run goes on
                    print(one_line(said, 2000), file=sys.stderr)
            if robot.moved:
                _offer_home(robot, run, problem, broken)
            raise


def _eyes(options: Robots) -> Iterator[DepthCamera]:
    """The cameras that were named, each started when asked for; none: the arm brings its own."""
    if not options.camera:
        looks = "topic", "window", "depth_range", "fill_holes"
        options.refuse(looks, ": only with --camera; the arm's own camera takes none")
        return
    yield from every(options.camera, options)


def _guarded(stack: ExitStack, eye: DepthCamera) -> GuardedCamera:
    guarded = GuardedCamera(eye)
    stack.callback(_let_go, guarded)
    return guarded


def _let_go(device: GuardedArm | GuardedCamera) -> None:
    """Close it; what goes wrong with that is said, and hides nothing that was raised before."""
    with uninterrupted():
        try:
            device.close()
        except JShapeError as problem:
            print(one_line(problem), file=sys.stderr)


def _offer_home(robot: Robot, run: Runs | None, problem: BaseException, broken: str | None) -> None:
    """Say why the arm was stopped, and ask whether it should go home; nobody there: it stays."""
    asks = broken is None and run is not None and not run.yes and sys.stdin.isatty()
    said = f"the arm {'is stopped where it is' if broken is None else 'was told to stop'}"
    if isinstance(problem, KeyboardInterrupt):
        said = f"interrupted; {said}"
    elif asks:  # else the command ends at once, and says the problem by itself
        said = f"{one_line(problem, 2000)}; {said}"
    print(said, file=sys.stderr)
    if broken is not None:
        print(broken, file=sys.stderr)
    if not asks:
        return
    try:
        with interruptible():
            if _asked("go home? [y/N] ") in YES:
                robot.home()
    except (JShapeError, KeyboardInterrupt) as more:
        stop_arm(robot.guard)
        print(f"not at home: {str(more) or 'interrupted'}", file=sys.stderr)


def at_home(robot: Robot, options: Runs) -> Robot:
    """The robot, its arm at home and out of the camera's view; people are asked before it moves."""
    may_move(robot, options)
    robot.home()
    return robot


def may_move(robot: Robot, options: Runs) -> None:
    """Ask, unless it moved before, whether the arm may go home before the first look."""
    if robot.moved or options.yes:
        return
    if _asked("the arm goes home, out of the camera's view. go? [y/N] ") not in YES:
        raise JShapeError("the arm must be out of the camera's view before the first look")


AGAIN = ("bank", "arm", "camera", "camera_file", "base", "gripper", "hand", "material", "batch")
"""Options that a run which goes on takes as it was begun."""
YES, ALL = ("y", "yes"), ("a", "all")
"""What people answer."""


def asking(options: Runs) -> Callable[[Plan], bool] | None:
    """What asks before each action; None where `--yes` says that nobody is to be asked."""
    if options.yes:
        return None
    if not sys.stdin.isatty():
        raise JShapeError("nobody can be asked here; --yes acts without asking")
    all_of_them = False

    def ask(ahead: Plan) -> bool:
        nonlocal all_of_them
        if all_of_them:
            return True
        d, doing = ahead.distances_mm, ahead[0].words(ahead.camera)
        print(f"next: {doing}: {d[0]:.3f} -> {d[1]:.3f} mm", file=sys.stderr)
        answer = _asked("act? [y]es, [a]ll, [N]o: ")
        all_of_them = answer in ALL
        return answer in (*YES, *ALL)

    return ask


def _asked(question: str) -> str:
    """The whole answer: a word that only begins like a yes is none."""
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower()


def resumed(options: Any) -> Session:
    """The run to go on with, if it was made with the same arm and bank."""
    if options.overwrite:
        raise JShapeError("--resume goes on with a run and --overwrite replaces it; give one")
    session = Session.resume(options.out, say=say)
    for name, now in (("arm", options.arm), ("bank", options.bank)):
        then = session.run.meta.get(name)
        if now is not None and then != str(now):
            raise JShapeError(f"{options.out}: was begun with the {name} {then}, not {now}")
    return session


def new_session(options: Runs, goal: np.ndarray, robot: Robot, /, **known: Any) -> Session:
    """A new run in `--out`, with what one that goes on must know."""
    words = [known["plan"]] if "plan" in known else []  # what `--resume` must be told again
    for name in AGAIN:
        if options.given.get(name) == "cli":
            value = getattr(options, name)
            values = value if isinstance(value, list) else [value]
            words += [f"--{name.replace('_', '-')}", *map(str, values)]
    meta = {"arm": options.arm, "camera": robot.eyes, "words": words, **known}
    return Session.start(options.out, goal, meta, overwrite=options.overwrite, say=say)


def molded(
    session: Session, robot: Robot, bank: Bank, options: Runs, /, **how: Any
) -> dict[str, Any]:
    """Go on with a run to its end, and print how it ended."""
    may_move(robot, options)
    say(HEAD)
    draw = molding_pictures(bank.rois)
    how |= {"batch": options.batch, "blind": options.arm == "dry", "draw": draw}
    summary = session.mold(robot, bank, **how)
    print(f"stopped: {summary['why']}")
    print(
        f"distance to the goal: {summary['before_mm']:.3f} mm before, "
        f"{summary['obtained_mm']:.3f} mm obtained"
    )
    print(f"run and pictures: {summary['out']}")
    return summary
