"""Hand-eye calibration: found where it is, told how well, and every refusal in one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jshape import D435_BAZAR
from jshape.cli.main import main
from jshape.errors import BadFile, JShapeError, UnknownName
from jshape.io.cameras import write_camera
from jshape.robot import pose_file as poses
from jshape.robot.calibration import calibrate
from jshape.robot.hand_eye import METHODS, least_turn_deg
from jshape.robot.rigid import (
    BadPose,
    angles_deg,
    check_rigid,
    mean_pose,
    pose_at,
    quaternion_of,
)
from tests.reference import hand_eye

SET_UPS = pytest.mark.parametrize("eye_in_hand", [False, True], ids=["to-hand", "in-hand"])


def pose(rng, turn_deg, move, at=(0.0, 0.0, 0.0)):
    """A pose near `at`, turned by about so many degrees."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(np.radians(turn_deg) * rng.normal(size=3)).as_matrix()
    found[:3, 3] = np.array(at) + move * rng.normal(size=3)
    return found


def pairs_of(rng, eye_in_hand, count=12, turn_deg=20.0, mm=0.0, deg=0.0):
    """(base_gripper, camera_target, the camera's pose), with noise in what the camera sees."""
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    camera = pose(rng, 5, 0.02, (0.0, 0.0, 0.1) if eye_in_hand else (0.6, 0.0, 0.9))
    if not eye_in_hand:
        camera[:3, :3] = camera[:3, :3] @ down[:3, :3]
    hands, targets = [], []
    for _ in range(count):
        seen = pose(rng, turn_deg, 0.05, (0.0, 0.0, 0.45))
        if eye_in_hand:  # T_base_target = base_gripper camera seen
            fixed = pose_at(np.array([0.6, 0.1, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
            hands.append(fixed @ np.linalg.inv(seen) @ np.linalg.inv(camera))
        else:  # T_gripper_target = np.linalg.inv(base_gripper) camera seen
            fixed = pose_at(np.array([0.0, 0.02, 0.12]), np.array([0.0, 0.6, 0.0, 0.8]))
            hands.append(camera @ seen @ np.linalg.inv(fixed))
        targets.append(seen @ pose(rng, deg, mm / 1e3))
    return np.array(hands), np.array(targets), camera


def off(found, truth):
    """(mm, degrees) between poses."""
    mm = 1e3 * np.linalg.norm(found[:3, 3] - truth[:3, 3])
    return mm, angles_deg(found[None], truth[None]).item()


@SET_UPS
@pytest.mark.parametrize("method", [None, *METHODS])
def test_exact_pairs_give_the_camera(rng, eye_in_hand, method):
    hands, targets, truth = pairs_of(rng, eye_in_hand)
    found = calibrate(hands, targets, eye_in_hand=eye_in_hand, method=method, camera=D435_BAZAR)
    mm, deg = off(found.pose, truth)
    assert mm < 1e-3 and deg < 1e-4
    assert found.residuals.mm.max() < 1e-3 and found.residuals.pixels.max() < 1e-3
    assert found.left_out.points_mm.max() < 1e-3 and found.warnings == ()
    assert set(found.tried_mm) == ({method} if method else set(METHODS))
    assert found.method in found.tried_mm and found.eye_in_hand is eye_in_hand


@SET_UPS
def test_noisy_pairs_give_the_camera_and_an_honest_error(rng, eye_in_hand):
    hands, targets, truth = pairs_of(rng, eye_in_hand, count=20, mm=0.5, deg=0.1)
    found = calibrate(hands, targets, eye_in_hand=eye_in_hand, camera=D435_BAZAR)
    mm, deg = off(found.pose, truth)
    assert mm < 3.0 and deg < 0.3
    # Per axis 0.5 mm of noise is 0.8 mm on average.
    assert 0.4 < found.residuals.mm.mean() < 1.6 and 0.05 < found.residuals.degrees.mean() < 0.5
    assert found.left_out.points_mm.mean() > found.residuals.points_mm.mean()
    assert found.tried_mm[found.method] == min(found.tried_mm.values())
    assert found.warnings == ()


@SET_UPS
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_park_is_the_closed_form(rng, eye_in_hand, noise):
    hands, targets, _ = pairs_of(rng, eye_in_hand, mm=noise, deg=noise / 3)
    found = calibrate(hands, targets, eye_in_hand=eye_in_hand, method="park")
    slow = hand_eye.park(hands if eye_in_hand else np.linalg.inv(hands), targets)
    np.testing.assert_allclose(found.pose, slow, atol=1e-7)


def test_the_target_is_where_it_was_put(rng):
    hands, targets, _ = pairs_of(rng, False)
    found = calibrate(hands, targets)
    np.testing.assert_allclose(found.target[:3, 3], [0.0, 0.02, 0.12], atol=1e-6)
    np.testing.assert_allclose(quaternion_of(found.target), [0.0, 0.6, 0.0, 0.8], atol=1e-6)


@pytest.mark.full
def test_pixels_are_those_of_the_camera(rng):
    """The target moved by 1 mm sideways in one pair, at 0.45 m: f / 450 px, less what is fitted."""
    hands, targets, _ = pairs_of(rng, False, count=40)
    targets[0, 0, 3] += 1e-3
    found = calibrate(hands, targets, camera=D435_BAZAR)
    expected = float(D435_BAZAR.fx) / (1e3 * targets[0, 2, 3])
    assert found.left_out.pixels[0] == pytest.approx(expected, rel=0.1)
    assert found.left_out.mm[0] == pytest.approx(1.0, rel=0.1)
    assert calibrate(hands, targets).residuals.pixels is None


def test_least_turn_is_that_of_all_motions(rng):
    hands, _, _ = pairs_of(rng, False, count=6)
    turns = [
        (a[:3, :3], b[:3, :3]) for i, a in enumerate(hands) for j, b in enumerate(hands) if i != j
    ]
    pile = [b.T @ a - np.eye(3) for a, b in turns]
    least = np.linalg.svd(np.concatenate(pile), compute_uv=False)[-1] / np.sqrt(len(pile))
    assert least_turn_deg(hands) == pytest.approx(np.degrees(2 * np.arcsin(least / 2)))


def test_three_pairs_are_enough_and_warned_of(rng):
    hands, targets, truth = pairs_of(rng, False, count=3)
    found = calibrate(hands, targets)
    assert off(found.pose, truth)[0] < 1e-3 and found.left_out is None
    assert any("only 3 pose pairs" in line for line in found.warnings)


def test_one_turned_pose_that_carries_all_is_left_out_as_nan(rng):
    hands, targets, truth = pairs_of(rng, False, count=9, turn_deg=0.0)
    for k, (x, y) in enumerate([(30.0, 0.0), *[(0.0, 30.0)] * 4]):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler("xy", [x, y], degrees=True).as_matrix()
        targets[k] = targets[k] @ turn
        hands[k] = truth @ targets[k] @ np.linalg.inv(calibrated_target())
    found = calibrate(hands, targets, method="park")
    assert np.isnan(found.left_out.mm[0]) and np.isfinite(found.left_out.mm[1:]).all()
    fields = poses.pose_of_calibration(found).residuals["left_out"]["mm"]
    assert fields["each"][0] is None and fields["mean"] is not None


def calibrated_target():
    return pose_at(np.array([0.0, 0.02, 0.12]), np.array([0.0, 0.6, 0.0, 0.8]))


def test_a_wrong_pair_is_named(rng):
    hands, targets, _ = pairs_of(rng, False, count=15, mm=0.2)
    targets[6, :3, 3] += 0.02
    found = calibrate(hands, targets)
    assert any(line.startswith("pair 7 is off by") for line in found.warnings)


@SET_UPS
def test_the_other_set_up_is_refused_and_suggested(rng, eye_in_hand):
    hands, targets, _ = pairs_of(rng, eye_in_hand, mm=0.2)
    expected = "with the camera in the hand" if eye_in_hand else "with a fixed camera"
    with pytest.raises(BadPose, match=f"contradict each other by .*{expected} they fit to 0"):
        calibrate(hands, targets, eye_in_hand=not eye_in_hand)


@SET_UPS
@pytest.mark.parametrize("what", ["base_gripper", "camera_target", "both"])
def test_quaternions_that_begin_with_w_are_refused_and_named(rng, eye_in_hand, what):
    hands, targets, _ = pairs_of(rng, eye_in_hand, mm=0.2)
    for name, moved in (("base_gripper", hands), ("camera_target", targets)):
        if what in (name, "both"):
            w_first = np.roll(Rotation.from_matrix(moved[:, :3, :3]).as_quat(), 1, axis=1)
            moved[:, :3, :3] = Rotation.from_quat(w_first).as_matrix()
    with pytest.raises(BadPose, match=f"the quaternions of {what} as w, x, y, z they fit to 0"):
        calibrate(hands, targets, eye_in_hand=eye_in_hand)


@SET_UPS
@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ((1e-3, 1e-3), r"base_gripper: .* than [01]\.\d+ mm from the base, 100 mm .* times 1000"),
        ((1.0, 1e-3), r"camera_target: .* than 0\.\d+ mm from the camera, 50 mm .* times 1000"),
        ((1e-2, 1e-2), r"base_gripper: the gripper is never farther than \d+\.\d* mm"),
        ((1e3, 1e3), "beyond 20 m; are these mm"),
    ],
)
def test_poses_in_another_unit_are_refused_with_the_factor(rng, eye_in_hand, scales, said):
    pairs = pairs_of(rng, eye_in_hand)[:2]
    for poses_, scale in zip(pairs, scales, strict=True):
        poses_[:, :3, 3] *= scale
    with pytest.raises(BadPose, match=said):
        calibrate(*pairs, eye_in_hand=eye_in_hand)


def test_a_method_that_fails_is_left_out_in_silence(capfd):
    """Of few poses that turn little, Tsai's makes nothing and OpenCV says so by itself."""
    fewer = 0
    for seed in range(12):
        hands, targets, _ = pairs_of(np.random.default_rng(seed), True, 4, 8.0, 0.4, 0.1)
        try:
            fewer += len(calibrate(hands, targets, eye_in_hand=True).tried_mm) < len(METHODS)
        except BadPose as problem:
            assert "turned by only" in str(problem)
    assert fewer > 0 and capfd.readouterr() == ("", "")


def test_pairs_of_different_moments_are_refused(rng):
    hands, targets, _ = pairs_of(rng, False)
    with pytest.raises(BadPose, match="each pair of one moment"):
        calibrate(hands, np.roll(targets, 1, 0))


def test_little_turning_is_warned_of(rng):
    hands, targets, _ = pairs_of(rng, False, turn_deg=5.0)
    assert any("least-turned" in line for line in calibrate(hands, targets).warnings)


def spoiled(rng, what):
    """A call that must be refused."""
    hands, targets, _ = pairs_of(rng, False)
    more = {}
    if what == "two":
        hands, targets = hands[:2], targets[:2]
    elif what == "none":
        hands, targets = hands[:0], targets[:0]
    elif what == "many":
        hands, targets = np.repeat(hands, 26, 0), np.repeat(targets, 26, 0)
    elif what == "uneven":
        hands = hands[:-1]
    elif what == "still":
        hands[:, :3, :3] = np.eye(3)
    elif what == "one axis":
        turns = Rotation.from_euler("z", np.linspace(0, 300, len(hands))[:, None], degrees=True)
        hands[:, :3, :3] = turns.as_matrix()
    elif what == "sheared":
        hands[4, 0, 1] += 0.01
    elif what == "scaled":
        targets[2, :3, :3] *= 1.1
    elif what == "mirrored":
        targets[2, :3, 0] *= -1
    elif what == "nan":
        targets[0, 0, 0] = np.nan
    elif what == "last row":
        hands[0, 3, 3] = 2.0
    elif what == "mm":
        hands[:, :3, 3] *= 1e3
    elif what == "shape":
        hands = hands[:, :3]
    elif what == "text":
        hands = [["a"]] * len(targets)
    elif what == "number":
        hands = 3
    elif what == "behind":
        targets[5, 2, 3], more = -0.45, {"camera": D435_BAZAR}
    elif what == "method":
        more = {"method": "best"}
    return hands, targets, more


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("two", "2 pose pairs; 3 to 300"),
        ("none", "0 pose pairs; 3 to 300"),
        ("many", "312 pose pairs; 3 to 300"),
        ("uneven", "11 poses of the gripper and 12 of the target"),
        ("still", "turned by only 0.0°"),
        ("one axis", "turned by only 0.0°"),
        ("sheared", "base_gripper of pair 5: is not rigid"),
        ("scaled", "camera_target of pair 3: is not rigid"),
        ("mirrored", "camera_target of pair 3: is not rigid: det R is -1"),
        ("nan", "camera_target of pair 1: holds NaN"),
        ("last row", "base_gripper of pair 1: the last row"),
        ("mm", "are these mm"),
        ("shape", "has shape (3, 4); expected a 4x4 matrix"),
        ("text", "is no array of numbers"),
        ("number", "is a int; expected (N, 4, 4)"),
        ("behind", "camera_target of pair 6: the target is at z = -0.450 m"),
        ("method", "unknown method 'best'; allowed: tsai, park"),
    ],
)
def test_refused_in_one_line(rng, what, said):
    hands, targets, more = spoiled(rng, what)
    with pytest.raises((BadPose, UnknownName)) as problem:
        calibrate(hands, targets, **more)
    assert said in str(problem.value) and "\n" not in str(problem.value)


def test_poses_written_with_three_decimals_are_taken(rng):
    hands, targets, camera = pairs_of(rng, False)
    found = calibrate(hands.round(3), targets.round(3))
    mm, degrees = off(found.pose, camera)
    assert mm < 1.0 and degrees < 0.2  # 0.27 mm and 0.10 degrees


def test_a_method_that_finds_nothing_is_refused(rng, monkeypatch):
    import cv2

    hands, targets, _ = pairs_of(rng, False)
    nothing = np.full((3, 3), np.nan), np.zeros((3, 1))
    monkeypatch.setattr(cv2, "calibrateHandEye", lambda *args, method: nothing)
    with pytest.raises(BadPose, match="park finds no rigid pose"):
        calibrate(hands, targets, method="park")


def test_rigid_laws(rng):
    some = np.array([pose(rng, 40, 0.5) for _ in range(5)])
    np.testing.assert_allclose(
        np.linalg.inv(some) @ some, np.tile(np.eye(4), (5, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(mean_pose(np.repeat(some[:1], 4, 0)), some[0], atol=1e-12)
    for one in some:
        again = pose_at(one[:3, 3], quaternion_of(one))
        np.testing.assert_allclose(again, one, atol=1e-12)
        assert quaternion_of(one)[3] >= 0
    slack = some[0] + 0.0
    slack[0, 0] += 9e-5 / 2
    check_rigid(slack, "slack")


# On disk


def as_json(hands, targets, quaternions=False):
    def one(matrix):
        if not quaternions:
            return matrix.tolist()
        return {"xyz_mm": (1e3 * matrix[:3, 3]).tolist(), "quat": quaternion_of(matrix).tolist()}

    return [
        {"base_gripper": one(a), "camera_target": one(b)}
        for a, b in zip(hands, targets, strict=True)
    ]


@pytest.mark.parametrize("quaternions", [False, True])
@pytest.mark.parametrize("wrapped", [False, True])
def test_pairs_are_read_as_written(rng, tmp_path, quaternions, wrapped):
    hands, targets, _ = pairs_of(rng, False)
    content = as_json(hands, targets, quaternions)
    text = json.dumps({"poses": content, "note": "monday"} if wrapped else content)
    (tmp_path / "pairs.json").write_text("\ufeff" + text)
    found = poses.read_pairs(tmp_path / "pairs.json")
    np.testing.assert_allclose(found.base_gripper, hands, atol=1e-12)
    np.testing.assert_allclose(found.camera_target, targets, atol=1e-12)


GOOD = {"base_gripper": np.eye(4).tolist(), "camera_target": np.eye(4).tolist()}
SHORT = {"xyz_mm": [0, 0], "quat": [0, 0, 0, 1]}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ([], "expected [{"),
        ({}, "expected [{"),
        ([3], "pair 1: has no base_gripper"),
        ([GOOD, {"base_gripper": GOOD["base_gripper"]}], "pair 2: has no camera_target"),
        ([GOOD] * 301, "holds 301 pairs; at most 300"),
        ([GOOD | {"base_gripper": "x"}], "base_gripper is 'x'; expected 4 x 4 numbers"),
        ([GOOD | {"base_gripper": [[1, 2]] * 4}], "base_gripper is [[1, 2]"),
        ([GOOD | {"base_gripper": [[True] * 4] * 4}], "base_gripper is [[True"),
        ([GOOD | {"base_gripper": [[2, 0, 0, 0]] * 4}], "the last row"),
        ([GOOD | {"base_gripper": SHORT}], "xyz_mm is [0, 0]; expected 3 numbers"),
        ([GOOD | {"base_gripper": {"xyz": [0, 0, 0]}}], "unknown 'xyz'; allowed: xyz_mm, quat"),
        (
            [GOOD | {"base_gripper": {"xyz_mm": [0, 0, 0], "quat": [0, 0, 0, 2]}}],
            "quat has length 2",
        ),
        (
            [GOOD | {"base_gripper": {"xyz_mm": [1e9, 0, 0], "quat": [0, 0, 0, 1]}}],
            "beyond 20 m",
        ),
    ],
)
def test_pairs_that_are_none_are_refused(tmp_path, content, said):
    (tmp_path / "pairs.json").write_text(json.dumps(content))
    with pytest.raises(JShapeError) as problem:
        poses.read_pairs(tmp_path / "pairs.json")
    assert said in str(problem.value) and "\n" not in str(problem.value)
    assert "pairs.json" in str(problem.value)


@pytest.mark.parametrize("text", ["[", "[NaN]", "", '[], "poses": []', "{}{}"])
def test_broken_json_is_refused(tmp_path, text):
    (tmp_path / "pairs.json").write_text(text)
    with pytest.raises(BadFile):
        poses.read_pairs(tmp_path / "pairs.json")


@SET_UPS
def test_a_pose_is_read_as_written(rng, tmp_path, eye_in_hand):
    hands, targets, _ = pairs_of(rng, eye_in_hand, mm=0.3)
    found = calibrate(hands, targets, eye_in_hand=eye_in_hand, camera=D435_BAZAR)
    pose = poses.pose_of_calibration(found, "above")
    poses.write_pose(tmp_path / "pose.json", pose)
    again = poses.read_pose(tmp_path / "pose.json")
    np.testing.assert_array_equal(again.matrix, pose.matrix)
    assert (again.parent, again.camera) == ("gripper" if eye_in_hand else "base", "above")
    assert again.found == pose.found and again.residuals == pose.residuals
    assert again.residuals["pairs"]["mm"]["max"] == found.residuals.mm.max()


def test_a_pose_written_by_hand_needs_little(tmp_path):
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    content = {"format": "jshape-pose", "version": 1, "T_base_camera": matrix.tolist()}
    (tmp_path / "pose.json").write_text(json.dumps(content))
    np.testing.assert_array_equal(poses.read_base_camera(tmp_path / "pose.json"), matrix)


EYE = np.eye(4).tolist()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "jshape-plan"}, "format is 'jshape-plan'"),
        ({"version": 2}, "version 2 is newer than this program reads (1)"),
        ({"version": True}, "version is True"),
        ({"T_base_camera": None}, "T_base_camera is None"),
        ({"T_gripper_camera": EYE}, "has 2 of T_base_camera, T_gripper_camera"),
        ({"T_base_camera": np.diag([1, 1, 1.0002, 1]).tolist()}, "is not rigid"),
        ({"T_base_camera": np.diag([1, 1, -1, 1]).tolist()}, "det R is -1"),
        ({"T_base_camera": [[1, 0, 0, 900], *EYE[1:]]}, "are these mm"),
        (
            {"T_base_camera": [[1, 0, 0, 8e-4], *EYE[1:]]},
            "never farther than 0.8 mm from the base, 100 mm or more is expected; times 1000",
        ),
        ({"camera": 3}, "camera is 3; expected text"),
        ({"found": []}, "found is []; expected an object"),
    ],
)
def test_a_pose_that_is_none_is_refused(tmp_path, change, said):
    good = {"format": "jshape-pose", "version": 1, "T_base_camera": EYE}
    (tmp_path / "pose.json").write_text(json.dumps(good | change))
    with pytest.raises(JShapeError) as problem:
        poses.read_pose(tmp_path / "pose.json")
    assert said in str(problem.value) and "\n" not in str(problem.value)


def test_a_pose_of_the_gripper_in_metres_is_refused(tmp_path):
    pose = {"xyz_mm": [0.4, 0.1, 0.3], "quat": [0, 0, 0, 1]}
    (tmp_path / "now.json").write_text(json.dumps({"base_gripper": pose}))
    with pytest.raises(BadPose, match="than 0.51 mm from the base.* times 1000 would fit"):
        poses.read_gripper(tmp_path / "now.json")


def test_a_pose_that_is_none_is_not_written(tmp_path):
    good = poses.CameraPose(np.eye(4))
    for bad in (replace(good, matrix=2 * np.eye(4)), replace(good, parent="world")):
        with pytest.raises(JShapeError):
            poses.write_pose(tmp_path / "pose.json", bad)
    assert not list(tmp_path.iterdir())


# The command


@SET_UPS
def test_calibrate_prints_and_writes(rng, tmp_path, capsys, eye_in_hand):
    hands, targets, truth = pairs_of(rng, eye_in_hand, mm=0.3, deg=0.05)
    (tmp_path / "pairs.json").write_text(json.dumps(as_json(hands, targets)))
    write_camera(tmp_path / "camera.json", D435_BAZAR, 0.001)
    out = tmp_path / "pose.json"
    command = ["calibrate", str(tmp_path / "pairs.json"), "--out", str(out)]
    command += ["--eye-in-hand"] if eye_in_hand else []
    assert main([*command, "--camera", str(tmp_path / "camera.json")]) == 0
    text = capsys.readouterr().out
    assert "12 pose pairs" in text and "100 mm square (px)" in text and "left out: mean" in text
    found = poses.read_pose(out)
    assert off(found.matrix, truth)[0] < 5 and found.camera == "camera.json"
    assert str(tmp_path) not in out.read_text()

    assert main(command) == 2
    assert "exists; choose another name, or --overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--json", "--method", "horaud", "--name", "top"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["found"]["method"] == "horaud" and result["camera"] == "top"
    assert "pixels" not in result["residuals"]["pairs"]


def test_calibrate_refuses_in_one_line(rng, tmp_path, capsys):
    hands, targets, _ = pairs_of(rng, False, count=2)
    (tmp_path / "pairs.json").write_text(json.dumps(as_json(hands, targets)))
    command = ["calibrate", str(tmp_path / "pairs.json"), "--out", str(tmp_path / "pose.json")]
    assert main(command) == 2
    assert "2 pose pairs" in capsys.readouterr().err
    assert main([*command, "--camera", "nothing"]) == 2
    assert "neither a camera.json nor a preset" in capsys.readouterr().err
    assert not (tmp_path / "pose.json").exists()
