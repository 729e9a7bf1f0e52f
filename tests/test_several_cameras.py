"""One bed that several cameras look at: their looks are one, and what goes wrong is said."""

import itertools
import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from jshape import HeightMap, Plan, Status, load_bank, metric, options, sim
from jshape.app.view.read import read_episode
from jshape.cli.main import main
from jshape.data.view import View, image_of_depth
from jshape.errors import BadCamera
from jshape.height_map import as_frame, places_on
from jshape.io.cameras import write_camera
from jshape.io.maps import write_map
from jshape.planning.maps import bank_for
from jshape.robot.arms.dry_run import DryRun
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.base import CameraLost
from jshape.robot.cameras.played import Played, calls
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.loop import mold
from jshape.robot.procedure_file import load_hand
from jshape.robot.rigid import pose_at
from jshape.robot.robot import Robot
from jshape.robot.simulated import SimulatedWorld
from jshape.robot.waypoints import waypoints_of
from tests.seen_beds import (
    STRAIGHT,
    above_simulated,
    bed,
    dug_simulated,
    heights,
    seen_by,
    standing,
)

HAND = load_hand()


def mound(x, y):
    """Heights of a mound of 40 mm with walls of 70 degrees, 50 mm beside the middle, metres."""
    return 0.04 * np.exp(-(((x - 0.05) ** 2 + y**2) ** 4) / 0.04**8)


def played(tilt, frames=None):
    """A camera at an angle that sees a bed with a mound; or what `frames` gives."""
    camera = standing(tilt)
    counts = np.rint(seen_by(camera, bed(of=mound)) / 1e-4).astype(np.uint16)
    return Played(f"at {tilt}", camera, 1e-4, calls(frames or (lambda: counts)), still=True)


def robot_of(*eyes):
    """A robot that sees it from above."""
    target = bed(of=mound).camera()
    robot = Robot(eyes[0], DryRun(), HAND, target, others=eyes[1:], frames=3)
    robot.view = View(eyes[0].camera, target)
    return robot


def test_two_looks_are_one_map_of_the_bed():
    with robot_of(played(-30), played(30)) as robot:
        both, one = robot.look(), robot.view.depth(robot.frame(), "the first alone")
        off = both - bed(of=mound).depth(robot.camera)
    assert robot.eyes == "at -30 + at 30"
    inside = np.s_[3:-3, 3:-3]  # the bed ends within a pixel of the cameras, which are 4 mm
    assert np.isfinite(both[inside]).mean() > 0.99 > np.isfinite(one[inside]).mean()
    assert np.nanmedian(np.abs(off)) < 1e-4


def test_a_camera_that_sends_nothing_or_moved_is_named():
    counts, left = played(30).frame(), iter(3 * [0])

    def ends():
        next(left)
        return counts

    with robot_of(played(-30), played(30, ends)) as robot:
        robot.look()
        with pytest.raises(CameraLost, match="^at 30: has no more frames"):
            robot.look()
    pushed = standing(30, distance=0.47)
    moved = Played("moved", pushed, 1e-4, calls(lambda: counts), still=True)
    with robot_of(played(-30), moved) as robot:
        with pytest.raises(
            BadCamera, match="at -30 [+] moved: cameras 1 and 2 differ by .* did it m"
        ):
            robot.look()


def test_several_cameras_need_poses_and_a_view_from_above():
    unposed = played(30)
    unposed.camera = replace(unposed.camera, pose=None)
    with pytest.raises(BadCamera, match="at 30: has no pose; several cameras need one each"):
        robot_of(played(-30), unposed)
    with robot_of(played(-30), played(30)) as robot:
        robot.view = View(robot.depth_camera.camera, robot.depth_camera.camera, (0, 0))
        with pytest.raises(BadCamera, match="several cameras see a bed from above"):
            robot.look()


class Told(DryRun):
    """An arm that remembers where its tool was sent."""

    def __init__(self):
        super().__init__(say=lambda line: None)
        self.poses = []

    def move(self, pose, *, speed, threshold):
        self.poses.append(np.array(pose))
        return super().move(pose, speed=speed, threshold=threshold)


BASE = pose_at(np.array([0.6, 0.1, 0.2]), np.array([0.02, 0.03, 0.7, 0.7]))
PLACE = (100.25, 50.5)


def sent(tilt, turn):
    """Where the tool goes for one place of the map, seen from there; and what waypoints say."""
    camera, target = standing(tilt, turn_deg=turn), bed().camera()
    eye = Played("it", camera, 1e-5, calls(lambda: np.rint(seen_by(camera) / 1e-5).astype("u2")))
    eye.still, base, arm = True, BASE @ np.array(camera.pose), Told()
    with Robot(eye, arm, HAND, target, base_camera=base, frames=1) as robot:
        robot.view = View(camera, target)
        image = image_of_depth(robot.look(), target).image
        robot.act("poke", PLACE, yaw=0.4)
    u, v = positions = np.rint(PLACE).astype(int)
    plan = Plan(
        camera=target,
        actions=("poke",),
        positions=positions[None],
        offsets=(np.array(PLACE) - positions)[None].astype(np.float32),
        yaws=np.array([0.4], np.float32),
        rois=np.array([[2, 2]]),
        distances=np.zeros(2, np.float32),
        status=Status.PLAN_ENDED,
        initial=image,
        patches=(image[v - 1 : v + 1, u - 1 : u + 1],),
        view=robot.view,
    )
    path = waypoints_of(plan, HAND, base)["actions"][0]
    told = [one["matrix"] for one in path["operations"] if one["matrix"]]
    return np.array(arm.poses), np.array(told), path["surface_m"]


def test_a_place_is_one_point_of_the_base_frame_from_wherever_it_is_seen():
    above, told, surface = sent(0, 0)
    assert len(above) >= 4
    x, y = places_on(bed().camera(), PLACE)[0]
    truth = BASE @ [x, y, heights(x, y), 1.0]
    np.testing.assert_allclose(surface, truth[:3], atol=5e-4)  # a median over 14 mm of a slope
    np.testing.assert_allclose(told, above, atol=1e-6)
    for tilt, turn in ((30, 0), (30, 90), (-30, 180)):
        poses, told, _ = sent(tilt, turn)
        np.testing.assert_allclose(poses, above, atol=1e-4)
        np.testing.assert_allclose(told, poses, atol=1e-6)


def letter(x, y):
    """Where the strokes of an L are, 90 x 110 mm."""
    down = (abs(x + 0.12) < 0.015) & (abs(y) < 0.055)
    return down | ((abs(x + 0.09) < 0.045) & (abs(y + 0.04) < 0.015))


@pytest.fixture(scope="module")
def molded_from():
    """Molds an 8 mm deep letter beside the mound; what is left, %, and what was seen, a share."""
    plane = sim.flat_bed()
    x, y = (np.asarray(axis) for axis in plane.axes())
    raised = sim.loose_bed((np.asarray(plane.height) + mound(x, -y[:, None])).astype(np.float32))
    now = bed(0.003, (0.15, 0.105), mound)
    dug = (now.heights - 0.008 * letter(now.x, now.y[:, None])).astype(np.float32)
    wanted = HeightMap(dug, now.pitch, now.origin, None, as_frame(STRAIGHT))
    target = wanted.camera()
    given = bank_for(load_bank("pressed-flour-robot"), target)
    goal = image_of_depth(wanted.depth(target), target).image

    def distance(bed):
        true = image_of_depth(np.asarray(sim.render(bed, target)), target).image
        return float(metric.distance(true, goal))

    def run(*tilts):
        world = SimulatedWorld(jax.random.key(0), raised)
        cameras = [above_simulated(tilt) for tilt in tilts]
        eyes = [simulated_camera(world, jax.random.key(k), one) for k, one in enumerate(cameras)]
        how = {"base_camera": np.array(cameras[0].pose), "others": eyes[1:], "frames": 9}
        with Robot(eyes[0], SimulatedArm(world), HAND, target, **how) as robot:
            robot.view = View(cameras[0], target)
            done = mold(robot, goal, given, **options(max_steps=3, yaws=2))
        seen = float(np.isfinite(done.depths[0]).mean())
        return 100 * distance(world.bed) / distance(raised), seen

    return run


@pytest.mark.full
def test_two_cameras_at_30_degrees_mold_a_letter_as_one_from_above_does(molded_from):
    above, _ = molded_from(0)
    both, seen = molded_from(-30, 30)
    assert seen > 0.99
    assert above < 75 and both < above + 2


@pytest.mark.full
def test_a_run_of_two_cameras_goes_on_after_one_of_them_fell_out(tmp_path, capsys, monkeypatch):
    """A height map is wanted; what the fused looks were is on disk, and is shown."""
    wanted = dug_simulated(3)
    write_map(tmp_path / "wanted.npz", wanted)
    words = ["mold", "--arm", "sim:3", "--yes", "--out", str(tmp_path / "run"), "--frames", "3"]
    for name, tilt in (("left", -30), ("right", 30)):
        write_camera(tmp_path / f"{name}.json", above_simulated(tilt), 1e-4)
        words += ["--camera-file", str(tmp_path / f"{name}.json")]
    few = ["--stride", "6", "--strengths", "0.5", "--yaws", "1", "--max-steps", "2"]

    def short_lived(world, key, camera):
        made = simulated_camera(world, key, camera)
        made._frames = itertools.islice(made._frames, 4)
        return made

    with monkeypatch.context() as broken:
        broken.setattr("jshape.robot.arms.simulated.simulated_camera", short_lived)
        assert main([*words, str(tmp_path / "wanted.npz"), *few]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("jshape: error: simulated camera at (0, ")
    assert said[-1].endswith(" mm: has no more frames")
    assert any("jshape mold " in line and " --resume --out " in line for line in said)
    assert json.loads((tmp_path / "run/summary.json").read_text())["state"] == "aborted"
    before = read_episode(tmp_path / "run")
    assert before.camera.orthographic and len(before.steps) == 2
    assert np.isfinite(before.steps[0].bed[2:-2, 2:-2]).all()
    assert main([*words, "--resume"]) == 0
    meta = json.loads((tmp_path / "run/run.json").read_text())["meta"]
    assert meta["camera"].count("simulated camera at") == 2 and meta["view"]["orthographic"]
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert summary["state"] == "finished" and len(summary["steps"]) == 1
    assert summary["steps"][0]["obtained_mm"] < summary["steps"][0]["before_mm"]
    after = read_episode(tmp_path / "run")
    assert after.goal is not None and after.steps[-1].bed.shape == wanted.mask.shape
