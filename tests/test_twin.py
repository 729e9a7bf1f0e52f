"""The physics twin: its numbers, its eyes, its reach, and what it does to the bed."""

import itertools
import subprocess
import sys
import threading
import time
from dataclasses import replace

import jax
import numpy as np
import pytest

from jshape import sim
from jshape.camera import D435_BAZAR, PAPER_BOX
from jshape.data.view import View
from jshape.errors import JShapeError
from jshape.height_map import camera_above, looking_down, places_on
from jshape.robot.arms.base import Arm, ArmError, Doing, EffortLimit, PoseRefused
from jshape.robot.cameras.base import CameraLost, DepthCamera, look
from jshape.robot.cameras.played import Played
from jshape.robot.perform import perform
from jshape.robot.procedure import Hand, turned
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from tests.conftest import ROOT
from tests.seen_beds import above_simulated

IDLE = Doing("poke", "above", 1.0, 0.0)


@pytest.fixture(scope="module", autouse=True)
def engine():
    """MuJoCo through our own door, which chooses how to draw before it is imported."""
    from jshape.robot.twin.engine import mink, mujoco

    try:
        mink()
        return mujoco()
    except JShapeError as problem:
        pytest.skip(str(problem))


@pytest.fixture(scope="module")
def hand():
    return load_hand()


@pytest.fixture(scope="module")
def flat(engine):
    """(arm, camera, base_camera) over a flat bed in the paper's box, with perfect eyes."""
    from jshape.robot.arms.mujoco import make_twin

    ready = make_twin(0, sim.flat_bed(size=(0.5, 0.4)), camera=PAPER_BOX, noise=0.0)
    with ready.camera:
        yield ready


@pytest.fixture
def fresh(flat):
    """The same with the bed as at first and the arm at home."""
    arm = flat.arm
    arm.begin(IDLE, np.eye(4))  # whatever a test left half done
    arm.twin.put(sim.flat_bed(size=(0.5, 0.4)))
    arm.home()
    arm.twin.collisions.clear()
    yield flat


# --- the model ----------------------------------------------------------------------------------


def test_links_and_limits_are_those_of_the_data_sheet(flat, engine):
    from jshape.robot.twin.world import JOINTS

    model, upright = flat.arm.twin.model, engine.MjData(flat.arm.twin.model)
    engine.mj_forward(model, upright)
    height = [upright.body(f"link{k}").xpos[2] for k in range(1, 8)]
    flange = upright.site("flange").xpos[2]
    # Base to shoulder, to elbow, to wrist, to flange: KUKA LBR iiwa 14 R820, metres.
    parts = [height[1], height[3] - height[1], height[5] - height[3], flange - height[5]]
    np.testing.assert_allclose(parts, [0.360, 0.420, 0.400, 0.126], atol=1e-9)
    limits = np.degrees([model.joint(name).range for name in JOINTS])
    most = np.array([170, 120, 170, 120, 170, 120, 175])
    np.testing.assert_allclose(limits, np.stack([-most, most], -1), atol=1e-9)
    torques = [model.actuator(name).forcerange[1] for name in JOINTS]
    assert torques == [320, 320, 176, 176, 110, 40, 40]


def test_fingertips_stand_where_the_strokes_of_the_simulator_begin(flat, hand, engine):
    from jshape.robot.twin import fingers

    twin, names = flat.arm.twin, fingers.FINGERS
    apart = {
        "grasp": (("claw", 1), ("closed", 2), ["thumb", *names]),
        "pinch": (("pinch_open", 1), ("pinch_closed", 2), ["index", "middle"]),
        "poke": (("point", 1), ("point", 2), ["index"]),
    }
    for action, (*moments, tips) in apart.items():
        path = np.asarray(sim.stroke(action).path)
        for posture, moment in moments:
            data = engine.MjData(twin.model)
            for name, angle in zip(fingers.JOINTS, fingers.angles(posture), strict=True):
                data.joint(name).qpos = angle
            engine.mj_forward(twin.model, data)
            flange = np.eye(4)
            flange[:3, :3] = data.site("flange").xmat.reshape(3, 3)
            flange[:3, 3] = data.site("flange").xpos
            for finger, tip in enumerate(tips):
                length = 2 * twin.model.geom(f"hand/{tip}_3").size[1]
                bone = data.body(f"hand/{tip}_3")
                end = bone.xpos + bone.xmat.reshape(3, 3)[:, 2] * length
                end = np.linalg.inv(flange @ hand.procedures[action].tool) @ np.append(end, 1.0)
                off = np.linalg.norm(end[:2] - path[moment, finger].mean(0)[:2])
                # Four closed fingers cannot be 9 mm apart, as those of the simulator are.
                assert off < (0.013 if posture == "closed" else 0.001), (posture, tip, off)


def test_unknown_postures_are_refused(flat):
    with pytest.raises(ArmError, match="unknown posture 'salute'; allowed: flat, claw"):
        flat.arm.posture("salute", seconds=0.1, threshold=10.0)


def without(hand, action, **changes):
    """The hand with another act of one action."""
    old = hand.procedures[action]
    act = replace(old.operations[3], **changes)
    new = replace(old, operations=(*old.operations[:3], act, *old.operations[4:]))
    return replace(hand, procedures={**hand.procedures, action: new})


@pytest.mark.parametrize(
    ("action", "changes", "said"),
    [
        (
            "sweep",
            {"path_mm": None, "depth_mm": 8.6},
            "sweep: goes along a path, and the",
        ),
        (
            "poke",
            {"path_mm": ((-9.0, 9.0), (9.0, 9.0)), "depth_mm": None},
            "poke: has a path_mm",
        ),
    ],
)
def test_a_path_that_the_bed_does_not_know_is_refused_before_the_arm_moves(
    flat, hand, action, changes, said
):
    before = flat.arm.twin.joints()
    with pytest.raises(ArmError, match=said):
        perform(
            *(flat.arm, without(hand, action, **changes), action),
            *(np.array([0.0, 0.0, 0.45]), flat.base_camera),
        )
    np.testing.assert_allclose(flat.arm.twin.joints(), before, atol=1e-6)


def test_the_twin_is_an_arm_and_a_camera(flat):
    assert isinstance(flat.arm, Arm) and isinstance(flat.camera, DepthCamera)


@pytest.mark.full
def test_the_package_does_not_import_mujoco_by_itself():
    code = "import sys, jshape.robot.arms.mujoco; assert 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_a_missing_mujoco_is_one_line(monkeypatch):
    from jshape.robot.twin import engine

    monkeypatch.setitem(sys.modules, "mink", None)
    with pytest.raises(JShapeError, match=r"the twin needs mink.*pip install 'jshape\[sim\]'"):
        engine.mink()


def test_nothing_to_draw_with_is_one_line(flat, monkeypatch):
    from jshape.robot.twin import engine

    def broken(*_, **__):
        raise RuntimeError("no\ndisplay")

    monkeypatch.setattr(engine.mujoco(), "Renderer", broken)
    with pytest.raises(engine.NoPicture, match="no display.*libosmesa6.*libegl1 libegl-mesa0"):
        engine.renderer(flat.arm.twin.model, 64, 48)


# --- the camera ---------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("camera", [PAPER_BOX, D435_BAZAR], ids=["box", "whole"])
def test_depth_equals_the_simulators_for_every_posture_at_home(camera):
    from jshape.robot.arms.mujoco import make_twin
    from jshape.robot.twin import fingers

    bed = sim.irregular_bed(jax.random.key(3), std=0.008)
    ready = make_twin(0, bed, camera=camera, noise=0.0)
    window = np.s_[:] if camera is PAPER_BOX else np.s_[46:441, 181:661]
    want = np.asarray(sim.render(bed, camera))[window]
    with ready.camera as eye:
        for posture in ("flat", "side") if camera is PAPER_BOX else fingers.POSTURES:
            ready.arm.posture(posture, seconds=0.1, threshold=1e3)
            depth = eye.depth()
            off = np.abs(depth[window] - want)
            assert off.mean() < 0.0001 and off.max() < 0.001, posture  # metres
            assert depth.min() > 0.40, posture  # nothing of the hand in the whole image


def test_frames_are_counts_with_noise_and_lost_once_closed(flat):
    from jshape.robot.cameras.mujoco import MuJoCoCamera

    with MuJoCoCamera(flat.arm.twin, jax.random.key(1)) as eye:
        frame = eye.frame()
        assert frame.dtype == np.uint16 and frame.shape == PAPER_BOX.shape
        assert (frame != eye.frame()).mean() > 0.5
    with pytest.raises(CameraLost, match="closed"):
        eye.frame()
    eye.close()


def test_without_noise_the_camera_is_still(fresh):
    depth = look(fresh.camera, frames=3)
    assert np.abs(depth - 0.45).mean() < 0.0005


# --- inverse kinematics -------------------------------------------------------------------------


def test_inverse_kinematics_reaches_what_it_says(flat):
    from jshape.robot.twin.world import REST

    reach = flat.arm.twin.reach
    for yaw in (0.0, 0.7, np.pi / 2):
        pose = flat.base_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ turned(yaw)
        pose[:3, 3] += [0.05, -0.1, -0.2]
        got = reach.pose(reach.solve(pose, REST))
        assert np.linalg.norm(got[:3, 3] - pose[:3, 3]) < 1e-4
        assert np.arccos(np.clip((np.trace(got[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1)) < 1e-3


def test_lines_are_straight_and_within_the_limits(flat):
    twin = flat.arm.twin
    end = flat.base_camera.copy()
    end[:3, 3] += [0.1, 0.1, -0.22]
    _, line = twin.reach.line(twin.home, end)
    points = np.stack([twin.reach.pose(joints)[:3, 3] for joints in line])
    along = (end[:3, 3] - points[0]) / np.linalg.norm(end[:3, 3] - points[0])
    aside = (points - points[0]) - ((points - points[0]) @ along)[:, None] * along
    assert np.linalg.norm(aside, axis=1).max() < 1e-4
    assert (np.abs(line) < twin.reach.ranges).all()


def test_poses_out_of_reach_are_refused_and_the_arm_stays(fresh):
    arm, before = fresh.arm, fresh.arm.twin.joints()
    pose = fresh.base_camera.copy()
    pose[0, 3] += 0.8
    with pytest.raises(PoseRefused, match=r"no joint angles for the flange at \(\d+, "):
        arm.move(pose, speed=0.2, threshold=40.0)
    np.testing.assert_allclose(arm.twin.joints(), before, atol=1e-4)


# --- acting -------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize(
    "posture, action, low, high", [("point", "poke", 6, 25), ("fist", "knock", 8, 40)]
)
def test_material_gives_way_before_the_bed_changes(
    fresh, hand, engine, posture, action, low, high
):  # docs/twin.md: a fingertip meets about 3 N per millimetre, a fist about 5
    arm, twin = fresh.arm, fresh.arm.twin
    arm.begin(IDLE, hand.procedures[action].tool)
    for height in (-0.05, 0.004):
        pose = fresh.base_camera.copy()
        pose[:3, 3] += pose[:3, :3] @ [0.0, 0.0, 0.45 + height]
        arm.move(pose, speed=0.1, threshold=100.0)
        arm.posture(posture, seconds=0.3, threshold=100.0)
    force, sum_of = np.zeros(6), 0.0
    for k in range(twin.data.ncon):
        engine.mj_contactForce(twin.model, twin.data, k, force)
        sum_of += force[0]
    assert (twin.data.contact.geom == twin.model.geom("bed").id).any() and low < sum_of < high


@pytest.mark.full
def test_a_poke_changes_the_bed_as_the_simulator_says(fresh, hand):
    arm, bed = fresh.arm, fresh.arm.twin.bed
    point, done, places = np.array([0.06, -0.04, 0.45]), [], []

    def told(one):
        done.append(one)
        places.append((np.linalg.inv(fresh.base_camera) @ arm.pose())[:3, 3])

    perform(arm, hand, "poke", point, fresh.base_camera, strength=0.9, on_operation=told)
    assert [one.operation for one in done] == ["above", "prepare", "contact", "act", "up", "clear"]
    contact, act, up = done[2], done[3], done[4]
    assert contact.contact and not act.contact
    assert contact.effort_nm < 6.0 < act.effort_nm < 30.0
    assert np.linalg.norm(places[2][:2] - point[:2]) < 0.001  # contact, metres
    assert 0.45 < places[2][2] < 0.454  # it touched
    np.testing.assert_allclose(places[3][2], 0.45 + 0.9 * 0.0198, atol=0.0005)
    np.testing.assert_allclose(up.tool_mm[2], 330.0, atol=0.5)
    want = sim.apply_action(
        jax.random.key(0), bed, "flour", "poke", places[2][:2].astype(np.float32),
        strength=0.9, spread=0.0,
    )  # fmt: skip
    np.testing.assert_allclose(arm.twin.bed.height, want.height, atol=2e-4)
    seen = fresh.camera.depth()
    assert np.abs(seen - np.asarray(sim.render(want, PAPER_BOX)))[20:-20].mean() < 0.001
    assert not arm.twin.collisions
    np.testing.assert_allclose(arm.twin.eye(), fresh.base_camera, atol=1e-4)  # home again


@pytest.mark.full
def test_a_turned_grasp_closes_and_is_within_its_thresholds(fresh, hand):
    arm, bed = fresh.arm, fresh.arm.twin.bed
    done = perform(arm, hand, "grasp", np.array([-0.05, 0.02, 0.45]), fresh.base_camera, yaw=0.8)
    assert [one.contact for one in done] == [False, False, True, False, False, False]
    want = sim.apply_action(
        jax.random.key(0), bed, "flour", "grasp", (-0.05, 0.02), yaw=0.8, spread=0.0
    )
    assert np.abs(np.asarray(arm.twin.bed.height) - np.asarray(want.height)).mean() < 1e-4


@pytest.mark.full
def test_a_sweep_follows_its_path_and_the_bed_moves_with_it(fresh, hand):
    """Turned beyond what the wrist does the short way round; the bed recedes before the hand."""
    arm, bed, way, felt = fresh.arm, fresh.arm.twin.bed, [], []
    yaw, middle = -2.9, np.array([0.0, 0.05])
    axes = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])

    def watch(twin):
        if arm._doing is not None and arm._doing.operation == "act":
            at = (np.linalg.inv(fresh.base_camera) @ arm.pose())[:3, 3]
            way.append((*axes @ (at[:2] - middle), at[2]))
            felt.append(twin.effort())

    arm.watch = watch
    try:
        how = {"yaw": yaw, "length": 0.6}
        done = perform(arm, hand, "sweep", np.array([*middle, 0.45]), fresh.base_camera, **how)
    finally:
        arm.watch = lambda twin: None
    assert [one.contact for one in done] == [False, False, True, False, False, False]
    along, aside, depth = np.array(way).T
    np.testing.assert_allclose(along[[0, -1]], (-0.023, 0.028), atol=0.001)
    assert np.abs(aside).max() < 0.001 and (np.diff(along) > -2e-5).all()
    moved = along > -0.022
    np.testing.assert_allclose(depth[moved], 0.4586, atol=0.0008)
    assert 4.0 < max(felt) < 40.0 and not arm.twin.collisions
    want = sim.apply_action(
        jax.random.key(0), bed, "flour", "sweep", middle.astype(np.float32), yaw=yaw, length=0.6,
        spread=0.0,
    )  # fmt: skip
    assert np.abs(np.asarray(arm.twin.bed.height - want.height)).mean() < 1e-5
    assert np.abs(np.asarray(want.height - bed.height)).max() > 0.008


@pytest.mark.full
def test_what_is_scooped_in_the_twin_is_what_it_pours(fresh, hand):
    arm, before = fresh.arm, float(sim.mass(fresh.arm.twin.bed))
    there = np.array([0.12, 0.08, 0.45])
    perform(arm, hand, "pour", there, fresh.base_camera)
    np.testing.assert_array_equal(arm.twin.bed.height, sim.flat_bed(size=(0.5, 0.4)).height)
    done = perform(arm, hand, "scoop", np.array([-0.1, 0.05, 0.45]), fresh.base_camera)
    held = float(arm.twin.bed.stock)
    assert 30e-6 < held < 60e-6 and not done[3].contact and 5.0 < done[3].effort_nm < 40.0
    seen = [np.asarray(arm.twin.bed.height).max()]
    arm.watch = lambda twin: seen.append(float(twin.model.hfield_data.max()))
    try:
        done = perform(arm, hand, "pour", there, fresh.base_camera, strength=2.0)
    finally:
        arm.watch = lambda twin: None
    assert not any(one.contact for one in done) and len(np.unique(np.round(seen, 4))) > 10
    assert abs(float(arm.twin.bed.stock)) < 1e-8 and not arm.twin.collisions
    assert float(sim.mass(arm.twin.bed)) == pytest.approx(before, rel=1e-5)


@pytest.mark.full
def test_a_stone_in_the_way_ends_a_sweep_and_the_rest_of_the_bed_stays(hand):
    from jshape.robot.arms.mujoco import make_twin
    from jshape.robot.twin.model import Obstacle

    bed = sim.flat_bed(size=(0.5, 0.4))
    stone = Obstacle((0.06, 0.0), top=sim.DEPTH - 0.002)  # from x = 20 mm on
    ready = make_twin(0, bed, obstacle=stone, noise=0.0)
    gentle = without(hand, "sweep", effort_nm=35.0)
    done = perform(ready.arm, gentle, "sweep", np.array([0.0, 0.0, 0.45]), ready.base_camera)
    act = done[3]
    assert len(done) == 6 and act.contact and -30.0 < act.tool_mm[0] < 20.0
    want = sim.cut(sim.stroke("sweep"), (act.tool_mm[0] + 40) / 85)
    after = sim.apply_action(jax.random.key(0), bed, "flour", want, (0.0, 0.0), spread=0.0)
    assert np.abs(np.asarray(ready.arm.twin.bed.height - after.height)).max() < 0.002
    x, _ = bed.axes()
    whole = sim.apply_action(jax.random.key(0), bed, "flour", "sweep", (0.0, 0.0), spread=0.0)
    lowest = [float(one.height[:, x > 0.045].min()) for one in (ready.arm.twin.bed, whole)]
    assert lowest[0] > 0.055 > lowest[1]


@pytest.mark.full
def test_a_buried_obstacle_ends_the_act_and_the_action_goes_on(hand):
    from jshape.robot.arms.mujoco import make_twin
    from jshape.robot.twin.model import Obstacle

    bed = sim.flat_bed(size=(0.5, 0.4))
    stone = Obstacle((0.05, 0.0), top=sim.DEPTH - 0.008)
    ready = make_twin(0, bed, obstacle=stone, noise=0.0, spread=1.0)
    done = perform(ready.arm, hand, "poke", np.array([0.05, 0.0, 0.45]), ready.base_camera)
    act = done[3]
    assert len(done) == 6 and act.contact and 30.0 < act.effort_nm < 60.0
    assert 457.0 < act.tool_mm[2] < 461.0  # on the stone, 8 mm down; the finger gives way a little
    deepest = float((np.asarray(bed.height) - np.asarray(ready.arm.twin.bed.height)).max())
    assert 0.005 < deepest < 0.011
    assert ready.arm.twin.effort() < 1.0  # home, free again


def test_the_hard_limit_stops_the_arm(fresh, hand):
    arm, knock = fresh.arm, hand.procedures["knock"]
    weak = [replace(one, effort_nm=2.0) for one in knock.operations]
    procedures = {"knock": replace(knock, operations=tuple(weak))}
    weak_hand = Hand(procedures, replace(hand.limits, effort_nm=2.0))
    with pytest.raises(EffortLimit, match="the arm stops at 2"):
        perform(arm, weak_hand, "knock", np.array([0.0, 0.0, 0.45]), fresh.base_camera)
    arm.limit(effort=120.0, speed=0.25)  # the arm is every test's
    before = arm.twin.joints()
    for _ in range(50):
        arm.twin.step()
    assert np.abs(arm.twin.joints() - before).max() < 0.01


def test_stop_is_always_possible_and_home_lifts_first(fresh, hand):
    arm = fresh.arm
    pose = fresh.base_camera.copy()
    pose[:3, 3] += [0.1, 0.15, -0.455]  # beside a wall, 5 mm in the material
    arm.stop()
    arm.begin(IDLE, hand.procedures["poke"].tool)
    arm.move(pose, speed=0.25, threshold=100.0)
    heights = []
    arm.watch = lambda twin: heights.append((arm.pose()[2, 3], *arm.pose()[:2, 3]))
    arm.home()
    arm.watch = lambda twin: None
    low = np.array([h for h in heights if h[0] < -0.10 + 0.075])
    assert np.ptp(low[:, 1:], axis=0).max() < 0.005  # straight up until above the rim
    assert not arm.twin.collisions
    arm.stop()


# --- pictures and experiments -------------------------------------------------------------------


def test_a_bystander_sees_the_robot(fresh):
    from benchmarks.experiments.bystander import Bystander, strip

    with Bystander(fresh.arm.twin, size=(160, 120)) as bystander:
        picture = bystander.picture()
    assert picture.shape == (120, 160, 3) and picture.std() > 20
    assert strip([picture] * 3, ["one", "two", "three"], columns=2).shape == (300, 320, 3)


@pytest.mark.full
def test_the_check_reports_what_happened(tmp_path, hand):
    from benchmarks.experiments.twin import check_twin

    lines = []
    found = check_twin(tmp_path / "check", names=("poke",), columns=2, rows=1, say=lines.append)
    (row,) = found["actions"]
    assert row["completed"] == row["trials"] == 2 and row["collisions"] == 0
    assert row["place_error_mm"]["max"] < 2.0 and len(lines) == 2
    assert "act" in found["obstacle"]["on it"]["ended_by_contact"]
    assert "act" not in found["obstacle"]["beside it"]["ended_by_contact"]
    assert "| poke | 2 of 2 | 0 |" in (tmp_path / "check" / "report.md").read_text()


@pytest.mark.slow
def test_all_places_of_the_paper():
    from benchmarks.experiments.twin import check_twin

    for row in check_twin()["actions"]:
        assert row["completed"] == row["trials"] == 15, row
        assert row["collisions"] == 0 and row["joint_margin_degrees"] > 0, row
        assert row["place_error_mm"]["mean"] <= 2.0, row


def test_another_thread_stops_a_motion_from_its_first_moment(fresh):
    """Also while its way is still being worked out; it raises, and the tool stands still."""
    arm = fresh.arm
    pose = arm.pose()
    pose[2, 3] -= 0.1
    entered = threading.Event()
    line = arm.twin.reach.line

    def slowly(*given):
        entered.set()
        time.sleep(0.3)
        return line(*given)

    arm.twin.reach.line = slowly
    ended = []

    def move():
        try:
            ended.append(arm.move(pose, speed=0.1, threshold=1e9))
        except ArmError as problem:
            ended.append(problem)

    before = arm.pose()
    mover = threading.Thread(target=move)
    mover.start()
    assert entered.wait(60)
    arm.stop()
    mover.join(120)
    assert isinstance(ended[0], ArmError) and "stopped" in str(ended[0])
    assert np.abs(arm.pose() - before).max() < 0.002
    arm.twin.reach.line = line
    moved = arm.move(pose, speed=0.1, threshold=1e9)  # and it obeys again
    assert abs(moved.pose[2, 3] - pose[2, 3]) < 0.002


@pytest.mark.full
def test_a_place_seen_from_the_side_is_where_the_twin_presses(fresh, hand):
    """The same place of the map from above, at 30 degrees, and at 30 degrees from another side."""
    twin, size = fresh.arm.twin, (161, 121)
    frame, level = looking_down(sim.SURFACE), np.asarray(twin.bed.height).max()
    target = camera_above(frame, size, 0.002, (-0.16, -0.12))
    place = (110.0, 40.0)
    x, y = places_on(target, place)[0]
    for tilt in (0, 30, -30):
        twin.put(sim.flat_bed(size=(0.5, 0.4)))
        camera = above_simulated(tilt)
        depth = np.array(sim.to_uint16(sim.render(twin.bed, camera)))
        eye = Played(f"at {tilt}", camera, 1e-4, itertools.repeat(depth), still=True)
        base = twin.base_camera @ np.array(camera.pose)
        with Robot(eye, fresh.arm, hand, target, base_camera=base, frames=1) as robot:
            robot.view = View(camera, target)
            robot.look()
            robot.act("poke", place, yaw=0.3)
        dug = level - np.asarray(twin.bed.height)
        rows, columns = np.nonzero(dug > dug.max() / 2)
        across, down = (np.asarray(axis) for axis in twin.bed.axes())
        at = across[columns].mean(), down[rows].mean()
        np.testing.assert_allclose(at, (x, -y), atol=2e-3)
