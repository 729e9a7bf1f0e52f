"""`jshape mold DESIRED`: look, plan, act, look again, until the bed is as wanted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera, differing, window_of
from jshape.cli import settings
from jshape.cli.commands import build_app, leaf_of
from jshape.cli.names import Uses
from jshape.cli.options import Positive
from jshape.cli.parser import value_of
from jshape.cli.reachable import base_of, reachable
from jshape.cli.robot import (
    Runs,
    asking,
    at_home,
    molded,
    new_session,
    resumed,
    robot_of,
)
from jshape.cli.search_options import KEPT, Searches, kept_of, search_of
from jshape.cli.tables import say
from jshape.data.intrinsics import within
from jshape.data.view import View, image_of_depth, view_like
from jshape.errors import BadCamera, BadFile, BadSetting, JShapeError
from jshape.io import formats, points
from jshape.io.cameras import camera_fields, camera_from
from jshape.io.frames import Source, frame_of, goal_source, source_of
from jshape.io.maps import SUFFIX, read_map
from jshape.learn.online import Evidence
from jshape.models.bank import Bank
from jshape.planning.devices import over_devices
from jshape.planning.maps import over_bed
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.robot.cameras.base import traits_of
from jshape.robot.learning import bank_of, bank_seeing
from jshape.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class MoldOptions(Uses, Searches, Runs):
    """Of `jshape mold`."""

    depth_unit: Positive | None = None
    """Metres per count of DESIRED."""
    adapt: bool = False
    """Correct the bank between looks by what each action did; --bank RUN goes on with it."""
    probe: bool = False
    """Begin with a test press where the goal asks for nothing, to know hand and material."""


def mold(desired: Path | None = None, /, *, options: MoldOptions) -> dict[str, Any]:
    """Mold what the camera sees into what is wanted.

    Args:
      desired: Depth image wanted, a height map (NPZ), or a PLY or PCD.
    """
    over_devices(options.devices)  # before anything starts JAX
    if options.resume == (desired is not None):
        raise BadFile("give either the image DESIRED, or --resume to go on with the run in --out")
    session = resumed(options) if options.resume else None
    if session is not None:
        options = keep_on(session.run.meta, options)
    bank_name = options.bank or (session.run.meta["bank"] if session else DEFAULT_BANK)
    bank = bank_of(bank_name)
    learning_options(options, bank)
    confirm = asking(options)
    with robot_of(options, options.out, bank) as robot:
        ready = partial(at_home, robot, options)
        goal, known = None, {}
        if session is not None:
            bank = restored(session.run.meta, robot, bank)
        else:
            assert desired is not None
            goal, bank, known = goal_of(desired, robot, bank, options, lambda: ready().frame())
        eye = robot.depth_camera.camera
        seen = robot.view or View(eye, bank.camera, window_of(bank.camera, eye))
        base = base_of(eye) if robot.base_camera is None else robot.base_camera
        mask = reachable(options.reachable, seen, lambda: ready().look(), base)
        how = keywords(search_of(options), reachable=mask)
        if session is None:  # all that may be refused has been: a folder would be in the way
            assert goal is not None
            meta = {"what": "mold", "bank": str(bank_name), "goal": str(desired)}
            session = new_session(options, goal, robot, **meta, **kept_of(options), **known)
        how |= {"adapt": options.adapt, "probe": options.probe}
        return molded(session, robot, bank, options, confirm=confirm, **how)


def learning_options(options: MoldOptions, bank: Bank) -> None:
    """Raise JShapeError where there is nothing to learn from, or nobody to learn."""
    if options.adapt and options.arm == "dry":
        raise JShapeError("--adapt learns from what an arm does; --arm dry does nothing")
    if options.probe and not options.adapt:
        raise JShapeError("--probe presses once so that --adapt can learn from it; give both")
    if options.adapt:
        Evidence(bank)  # or BadBank, before there is a run


def goal_of(
    path: Path,
    robot: Robot,
    bank: Bank,
    options: MoldOptions,
    first_look: Callable[[], np.ndarray],
) -> tuple[np.ndarray, Bank, dict[str, Any]]:
    """What is wanted, from a file of any camera that can be known, and how the robot is to look.

    A goal of the robot's own camera is seen as the bed will be: from the same place above it.  One
    that was seen from above lies where its pose says; without one, on the plane that the first
    look (H, W), in metres, shows, its origin where the camera's axis meets it.

    Returns the image (H, W), NaN where it is not known from above; the bank for what the robot then
    sees; and what a run that is gone on with must know.
    """
    eye, name = robot.depth_camera.camera, robot.depth_camera.name
    depth, source = _wanted(path, robot, bank, options)
    theirs = within(source.camera, (float(eye.z_min), float(eye.z_max)))
    at = window_of(eye, theirs)
    if at is not None:  # the robot's own camera, or a part of its frames
        depth = depth[at[1] : at[1] + eye.height, at[0] : at[0] + eye.width]
        source = source._replace(camera=eye)
    elif source.camera is not eye:
        whose = "seen from above" if theirs.orthographic else f"of another camera than {name}"
        say(f"goal: {source.said}, {whose}")
    view, seen_by = over_bed(bank, source.camera, depth, str(path), again=robot.several)
    known: dict[str, Any] = {}
    if view.target != bank.camera:
        target = view.target
        if at is None and None in (source.camera.pose, eye.pose):
            if not source.camera.orthographic:
                raise BadCamera(
                    f"{path}: of another camera than {name} ({differing(theirs, eye, 'its')}); "
                    "nothing says how the two stand; make the goal from a frame of that camera, or "
                    "give both a pose (jshape calibrate)"
                )
            target = view_like(view, eye, first_look(), name).target
        known["view"] = camera_fields(target)
        seen_by = restored(known, robot, bank)
    found = image_of_depth(
        depth, view.target, max_missing=options.max_missing, where=str(path), view=view
    )
    image = found.image if seen_by is bank else np.where(found.known, found.image, np.nan)
    return image, seen_by, known


def _wanted(
    path: Path, robot: Robot, bank: Bank, options: MoldOptions
) -> tuple[np.ndarray, Source]:
    """The frame (H, W) in metres that a file of a goal holds, and of which camera."""
    if path.suffix.lower() == SUFFIX:
        found = read_map(path)
        return found.depth(found.camera()), Source(found.camera(), 1.0, "a height map", True)
    eye = robot.depth_camera.camera
    whole: Camera = traits_of(robot.depth_camera).whole or eye
    own = Source(eye, robot.depth_camera.depth_unit, robot.depth_camera.name, True)
    if path.suffix.lower() in points.SUFFIXES:
        return frame_of(path, own), own
    shape = formats.read_array(path).shape
    of_eye = [camera for camera in (eye, whole) if camera.shape == shape]
    source = goal_source(path, own, None)
    if source is own and options.camera_file is None and of_eye:
        if window_of(bank.camera, of_eye[0]) is None:  # no preset of the same size
            unit = options.depth_unit or own.depth_unit
            source = own._replace(camera=of_eye[0], depth_unit=unit)
            return frame_of(path, source), source
    if source is own:
        named = str(options.camera_file[0]) if options.camera_file else None
        source = source_of(path, shape, named, bank, options.depth_unit)
    return frame_of(path, source), source


def restored(known: Mapping[str, Any], robot: Robot, bank: Bank) -> Bank:
    """The bank, and the robot, as a run began: see `goal_of`."""
    bank = bank_seeing(known, bank, "run.json")
    if "view" in known:
        target = camera_from(known["view"], "the run's view")
        robot.view, robot.camera = View(robot.depth_camera.camera, target), target
    return bank


def keep_on(known: Mapping[str, Any], options: MoldOptions) -> MoldOptions:
    """The options, those of `KEPT` as a run began; what differs from the defaults is said."""
    leaf = leaf_of(build_app(), ["mold"])
    assert leaf is not None
    kept, said = {}, []
    for name in KEPT:
        key, then = name.replace("_", "-"), known.get(name)
        if then is None or options.given.get(name) == "cli":
            continue  # a run of an older version does not say it
        argument = leaf.arguments[key]
        try:
            tokens = settings.tokens_of(argument, key, then, options.out, "")
            value = value_of(argument, tokens)
        except BadSetting as problem:
            text = str(problem).removeprefix(f"{key}: ")
            raise BadFile(f"{options.out}: the run's {key}: {text}") from None
        if value != getattr(options, name):
            kept[name] = value
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            said.append(f"--{key} {text}")
    if said:
        say(f"going on with: {' '.join(said)}")
    return replace(options, **kept, given={**options.given, **dict.fromkeys(kept, "run")})
