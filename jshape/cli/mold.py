"""`jshape mold DESIRED`: look, plan, act, look again, until the bed is as wanted."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera, differing, window_of
from jshape.cli import arguments, settings
from jshape.cli.robot import (
    add_robot,
    add_run,
    asking,
    may_move,
    resumed,
    robot_of,
    tell,
)
from jshape.cli.search_options import KEPT, add_search, kept_of, reachable, search_of
from jshape.data.intrinsics import within
from jshape.data.view import View, image_of_depth, middle_depth, view_of
from jshape.errors import BadCamera, BadFile, JShapeError
from jshape.io import banks, formats, points
from jshape.io.frames import Source, frame_of, goal_source, source_of
from jshape.models.bank import Bank
from jshape.planning.devices import over_devices
from jshape.planning.options import DEFAULT_BANK, Constraints
from jshape.planning.options import options as keywords
from jshape.robot.loop import HEAD
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from jshape.viz.pictures import molding_pictures


def mold(options: argparse.Namespace) -> dict[str, Any]:
    """Mold what the camera sees into what is wanted."""
    over_devices(options.devices)  # before anything starts JAX
    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    if options.resume == (options.desired is not None):
        raise BadFile("give either the image DESIRED, or --resume to go on with the run in --out")
    session = resumed(options, say) if options.resume else None
    if session is not None:
        keep_on(session.run.meta, options, say)
    bank_name = options.bank or (session.run.meta["bank"] if session else DEFAULT_BANK)
    bank = banks.load_bank(bank_name)
    confirm = asking(options)
    with robot_of(options, bank, say) as robot:
        if session is None:
            goal, bank, known = goal_of(options.desired, robot, bank, options, say)
            meta = {
                "what": "mold", "bank": str(bank_name), "arm": options.arm,
                "camera": robot.eye.name, "goal": str(options.desired),
                **kept_of(options), **known,
            }  # fmt: skip
            session = Session.start(options.out, goal, meta, overwrite=options.overwrite, say=say)
        else:
            bank = gone_on(session.run.meta, robot, bank)
        may_move(options)
        say(HEAD)
        eye = robot.eye.camera
        mask = reachable(
            options.reachable, eye.shape, bank,
            lambda: robot.view or View(eye, bank.camera, window_of(bank.camera, eye), 0.0),
        )  # fmt: skip
        summary = session.mold(
            robot, bank, confirm=confirm, blind=options.arm == "dry",
            draw=molding_pictures(bank.rois), **keywords(search_of(options), reachable=mask),
        )  # fmt: skip
    if not options.json:
        tell(summary)
    return summary


def goal_of(
    path: Path, robot: Robot, bank: Bank, options: argparse.Namespace, say: Callable[[str], Any]
) -> tuple[np.ndarray, Bank, dict[str, float]]:
    """What is wanted, from a file of any camera that can be known, and how the robot is to look.

    A goal of the robot's own camera is seen as the bed will be: moved by the same distance.

    Returns:
      The image (H, W); the bank, for the robot's camera as it is where `--window` or
      `--depth-range` asks for that; and what a run that is gone on with must know.

    Raises:
      BadFile, BadImage, BadCamera, BadBank: as for `jshape plan`.
    """
    eye = robot.eye.camera
    whole: Camera = getattr(robot.eye, "whole", eye)
    own = Source(eye, robot.eye.depth_unit, robot.eye.name, True)
    if path.suffix.lower() in points.SUFFIXES:
        source = own
    else:
        shape = formats.read_array(path).shape
        of_eye = [camera for camera in (eye, whole) if camera.shape == shape]
        beside = goal_source(path, own, None)
        if beside is not own:
            source = beside
        elif options.camera_file is None and of_eye and window_of(bank.camera, of_eye[0]) is None:
            unit = options.depth_unit or own.depth_unit
            source = own._replace(camera=of_eye[0], depth_unit=unit)  # no preset of the same size
        else:
            source = source_of(path, shape, options.camera_file, bank, options.depth_unit)
    depth = frame_of(path, source, reproject=bool(options.reproject))
    theirs = within(source.camera, (float(eye.z_min), float(eye.z_max)))
    at = window_of(eye, theirs)
    if at is not None:  # the robot's own camera, or a part of its frames
        depth = depth[at[1] : at[1] + eye.height, at[0] : at[0] + eye.width]
        source = source._replace(camera=eye)
    elif source.camera is not eye:
        say(f"goal: {source.said}, of another camera than {robot.eye.name}")
    known: dict[str, float] = {}
    if (options.window or options.depth_range) and not options.reproject and at is not None:
        known["bed_m"] = middle_depth(depth)
        bank = gone_on(known, robot, bank)
    view = view_of(
        source.camera, bank.camera, depth, reproject=bool(options.reproject), where=str(path)
    )  # fmt: skip
    if at is None and (view.window is None) != (window_of(bank.camera, eye) is None):
        raise BadCamera(
            f"{path}: of another camera than {robot.eye.name} ({differing(theirs, eye, 'its')}); "
            "nothing says how high it is above the bed; make the goal from a frame of that camera"
        )
    if at is not None and view.window is None:
        known["rise_m"] = view.rise
        robot.view = view
    max_missing = options.max_missing
    if max_missing is None:
        max_missing = Constraints().max_missing
    image = image_of_depth(
        depth, bank.camera, max_missing=max_missing, where=str(path), view=view
    ).image  # fmt: skip
    return image, bank, known


def gone_on(known: Mapping[str, Any], robot: Robot, bank: Bank) -> Bank:
    """The bank, and the robot, as a run began: see `goal_of`.

    Raises:
      BadBank, BadCamera: as for `Bank.seen_by`.
    """
    eye = robot.eye.camera
    if isinstance(known.get("bed_m"), float):
        if differing(bank.camera, eye, ""):
            bank = bank.seen_by(eye, known["bed_m"])
        robot.camera = bank.camera
    if isinstance(known.get("rise_m"), float):
        robot.view = View(eye, bank.camera, None, known["rise_m"])
    return bank


def keep_on(
    known: Mapping[str, Any], options: argparse.Namespace, say: Callable[[str], Any]
) -> None:
    """Set the options of `KEPT` as a run began; what differs from the defaults is said.

    Raises:
      BadFile: one that the option does not take, in a run.json that was changed.
    """
    said = []
    for action in options.kept:
        name, key = action.dest, settings.key_of(action)
        if known.get(name) is None or name in getattr(options, "given", ()):
            continue  # a run of an older version does not say it
        try:
            then = settings.read_value(action, key, known[name], options.out)
        except JShapeError as problem:
            raise BadFile(f"{options.out}: the run's {key}: {problem}") from None
        now = getattr(options, name)
        usual = getattr(action, "usual", None) if now is None else now
        if then != (list(usual) if isinstance(usual, tuple) else usual):
            setattr(options, name, then)
            text = ",".join(map(str, then)) if isinstance(then, list) else str(then)
            said.append(f"--{key} {text}")
    if said:
        say(f"going on with: {' '.join(said)}")


def add(commands: Any) -> None:
    """The parser of `jshape mold`."""
    parser = arguments.command(commands, "mold", mold)
    parser.register("action", None, arguments.Remembered)
    parser.add_argument("desired", type=Path, nargs="?", help="depth image wanted, or a PLY or PCD")
    add_robot(parser, plans=True)
    add_run(parser)
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument("--depth-unit", type=arguments.positive, help="metres per count of DESIRED")
    add_search(parser)
    parser.set_defaults(kept=[one for one in parser._actions if one.dest in KEPT])
