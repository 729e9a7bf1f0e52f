"""Plans as waypoints: at the plan's pixels, on the predicted surface, the same in JSON and YAML."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from jshape import D435_BAZAR, PAPER_BOX, Plan, Status, metric
from jshape.actions import PAPER_Z
from jshape.cli.main import main
from jshape.data.view import View
from jshape.errors import BadFile, BadPosition, JShapeError, UnknownName
from jshape.height_map import as_frame
from jshape.planning.plan import successive
from jshape.planning.plan_file import write_plan
from jshape.robot import waypoints
from jshape.robot.arms.base import PoseRefused
from jshape.robot.pose_file import CameraPose, write_pose
from jshape.robot.procedure import Hand, Operation, Procedure, surface_point
from jshape.robot.procedure_file import load_hand
from jshape.robot.rigid import BadPose, pose_at
from jshape.robot.waypoints import waypoints_of


def poses_in(action):
    """The tool's poses in each operation of an action: none, one, or those of its path."""
    moved = [one.get("path", [one]) for one in action["operations"]]
    return [[np.array(one["matrix"]) for one in some if one["matrix"]] for some in moved]


NAMES = ("above", "prepare", "contact", "act", "up", "clear")
ROI = (60, 40)
PLACES = [[239, 197], [239, 197], [60, 330]]
BASE = pose_at(np.array([0.6, 0.1, 0.9]), np.array([1.0, 0.02, 0.03, 0.0]))
FLAT, DENT = 0.44, 0.012


def image(depth):
    return np.asarray(metric.weigh(PAPER_BOX.luminance(depth, quantize=False), PAPER_BOX))


def plan_of(depths, positions, **more):
    """A plan whose predicted depths before and after each action are these."""
    images, (w, h), patches = [image(d) for d in depths], ROI, []
    for after, (u, v) in zip(images[1:], positions, strict=True):
        patches.append(after[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w])
    count = len(positions)
    return Plan(
        camera=PAPER_BOX,
        actions=("knock", "poke", "knock")[:count],
        positions=np.array(positions, np.int32),
        rois=np.array([ROI] * count, np.int32),
        distances=np.linspace(0.03, 0.01, count + 1).astype(np.float32),
        status=Status.CONVERGED,
        initial=images[0],
        goal=images[-1],
        patches=tuple(patches),
        **more,
    )


@pytest.fixture
def plan():
    """A knock and a poke at one place, and a knock elsewhere, each making a flat dent."""
    depths = [np.full(PAPER_BOX.shape, FLAT)]
    for u, v in PLACES:
        depths.append(depths[-1].copy())
        depths[-1][v - 20 : v + 20, u - 30 : u + 30] += DENT
    found = plan_of(
        depths,
        PLACES,
        strengths=np.array([1.0, 0.5, 1.25], np.float32),
        yaws=np.array([0.0, np.pi / 3, -np.pi / 2], np.float32),
        offsets=np.array([[0.0, 0.0], [0.25, -0.4], [0.0, 0.5]], np.float32),
        clipped=np.zeros(3, np.float32),
    )
    for seen, depth in zip(successive(found.initial, found.patches, firsts()), depths, strict=True):
        np.testing.assert_array_equal(seen, image(depth))
    return found


def firsts():
    return np.array(PLACES) - np.array(ROI) // 2


def pixel(point, z):
    """(u, v) of a point that is brought to depth z."""
    x, y = point[:2]
    return np.array([433.0 * x / z + float(PAPER_BOX.u0), 433.0 * y / z + float(PAPER_BOX.v0)])


def test_places_are_the_plans_pixels(plan):
    ways = waypoints_of(plan, load_hand())
    for path, expected in zip(ways["actions"], plan.exact_positions, strict=True):
        np.testing.assert_allclose(path["position_px"], expected, rtol=0, atol=1e-9)
        # Places are meant at one depth (Hypothesis 3), whatever the surface.
        np.testing.assert_allclose(pixel(path["surface_m"], PAPER_Z), expected, atol=1e-6)
        for poses in poses_in(path):
            for pose in poses:
                np.testing.assert_allclose(pixel(pose[:3, 3], PAPER_Z), expected, atol=1e-6)


def test_from_the_base_they_go_back_through_the_camera(plan):
    ways = waypoints_of(plan, load_hand(), BASE)
    beside = waypoints_of(plan, load_hand())
    assert (ways["frame"], beside["frame"]) == ("base", "camera")
    assert beside["T_base_camera"] is None
    for path, seen, expected in zip(
        ways["actions"], beside["actions"], plan.exact_positions, strict=True
    ):
        back = (np.linalg.inv(BASE) @ np.append(path["surface_m"], 1.0))[:3]
        np.testing.assert_allclose(pixel(back, PAPER_Z), expected, atol=1e-6)
        for a, b in zip(poses_in(path), poses_in(seen), strict=True):
            np.testing.assert_allclose(a, [BASE @ pose for pose in b], atol=1e-12)


def test_a_surface_at_the_places_depth_is_seen_at_the_plans_pixels():
    depths = [np.full(PAPER_BOX.shape, PAPER_Z)] * 2
    (path,) = waypoints_of(plan_of(depths, [[100, 300]]), load_hand())["actions"]
    assert path["surface_m"][2] == pytest.approx(PAPER_Z, abs=1e-7)
    np.testing.assert_allclose(
        pixel(path["surface_m"], path["surface_m"][2]), [100, 300], atol=1e-4
    )


def test_heights_follow_the_predicted_surface(plan):
    first, second, third = (
        path["surface_m"][2] for path in waypoints_of(plan, load_hand())["actions"]
    )
    assert first == pytest.approx(FLAT, abs=1e-7)
    assert second == pytest.approx(FLAT + DENT, abs=1e-7)
    assert third == pytest.approx(FLAT, abs=1e-7)


def test_operations_are_the_hands(plan):
    hand = load_hand()
    for k, path in enumerate(waypoints_of(plan, hand)["actions"]):
        fields, operations = path["operations"], hand.procedures[path["action"]].operations
        assert tuple(one["operation"] for one in fields) == NAMES
        for poses, one, operation in zip(poses_in(path), fields, operations, strict=True):
            assert one["posture"] == operation.posture
            assert one["speed_m_s"] == pytest.approx(operation.speed_mm_s / 1e3)
            assert one["effort_Nm"] == operation.effort_nm
            if operation.name == "clear":
                assert not poses
                continue
            (pose,) = poses
            down = 1e3 * (pose[2, 3] - path["surface_m"][2])
            if operation.depth_mm is not None:
                assert down == pytest.approx(operation.depth_mm * plan.strengths[k])
            else:
                assert down == pytest.approx(-operation.height_mm)
            turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
            np.testing.assert_allclose(turn, [0, 0, plan.yaws[k]], atol=1e-6)


def moved(turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)), z=0.0):
    """The pose of a camera that is turned and moved along the axis."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[2, 3] = turn, z
    return as_frame(matrix)


def test_on_a_map_of_cameras_in_the_base_frame_no_pose_is_counted_twice(plan):
    """Each pose turns a bed seen from above upside down: two of them stand it up again."""
    looking_down = as_frame(BASE)
    above = replace(PAPER_BOX, orthographic=True, fx=962.0, fy=962.0, pose=looking_down)
    on_map, limits = replace(plan, camera=above), load_hand().limits
    hand = replace(
        load_hand(), limits=replace(limits, low_mm=(-1e3, -1e3, 0.0), high_mm=(1e3,) * 3)
    )
    with pytest.raises(BadPose, match="upside down in the base frame; .* leave --base out"):
        waypoints_of(on_map, hand, BASE)
    ways, seen = (
        waypoints_of(on_map, hand),
        waypoints_of(replace(plan, camera=replace(above, pose=None)), hand),
    )
    assert ways["frame"] == "cameras" and seen["frame"] == "camera"
    for path, other in zip(ways["actions"], seen["actions"], strict=True):
        expected = BASE[:3, :3] @ other["surface_m"] + BASE[:3, 3]
        np.testing.assert_allclose(path["surface_m"], expected, atol=1e-12)
    beside = replace(on_map, camera=replace(above, pose=moved(z=-0.2)))  # in its camera's own frame
    assert waypoints_of(beside, hand, BASE)["frame"] == "base"


def test_a_camera_elsewhere_looks_from_where_it_is(plan):
    """The bank's camera is imitated from 0.2 m above the one that looks, 0.3 m below, and aside."""
    beside = waypoints_of(plan, load_hand())["actions"]
    limits = replace(load_hand().limits, low_mm=(-400.0, -400.0, 0.0), high_mm=(400.0, 400.0, 1e3))
    hand = replace(load_hand(), limits=limits)
    for higher in (0.2, -0.3):
        view = View(D435_BAZAR, replace(PAPER_BOX, pose=moved(z=-higher)))
        ways = waypoints_of(replace(plan, view=view), hand)
        for path, other in zip(ways["actions"], beside, strict=True):
            np.testing.assert_allclose(
                path["surface_m"], np.subtract(other["surface_m"], [0, 0, higher]), atol=1e-12
            )
    # A camera at 30 degrees: what the straight one has at (x, y, z) is turned into its frame.
    turn = Rotation.from_euler("x", 30, degrees=True).as_matrix()
    view = View(D435_BAZAR, replace(PAPER_BOX, pose=moved(turn, z=0.1)))
    for path, other in zip(
        waypoints_of(replace(plan, view=view), hand)["actions"], beside, strict=True
    ):
        np.testing.assert_allclose(
            path["surface_m"], turn @ other["surface_m"] + [0, 0, 0.1], atol=1e-12
        )
    window = View(D435_BAZAR, PAPER_BOX, (181, 46))
    for path, other in zip(
        waypoints_of(replace(plan, view=window), hand)["actions"], beside, strict=True
    ):
        np.testing.assert_array_equal(path["surface_m"], other["surface_m"])


def test_the_surface_is_looked_up_where_it_is_seen():
    """A slope: the point of the surface above (x, y) is at another pixel than the place."""
    camera, (x, y) = PAPER_BOX, PAPER_BOX.rays()
    slope = 0.1
    # z = 0.44 + slope * X with X = x z: the depth image of a tilted plane.
    depth = np.asarray(0.44 / (1.0 - slope * x) + 0.0 * y)
    point = surface_point(depth, camera, (400, 100))
    assert point[2] == pytest.approx(0.44 + slope * point[0], abs=1e-4)


@pytest.mark.parametrize("place", [(0, 0), (479, 394), (-3, 400)])
def test_places_at_the_edge_have_a_surface(place):
    point = surface_point(np.full(PAPER_BOX.shape, 0.43), PAPER_BOX, place)
    assert point[2] == pytest.approx(0.43)


def test_one_wild_pixel_does_not_move_the_hand():
    depth = np.full(PAPER_BOX.shape, 0.44)
    u, v = np.rint(pixel(surface_point(depth, PAPER_BOX, (300, 200)), 0.44)).astype(int)
    depth[v, u] = 0.3
    assert surface_point(depth, PAPER_BOX, (300, 200))[2] == 0.44


# Refused


def test_refused_without_what_it_takes(plan):
    hand = load_hand()
    with pytest.raises(JShapeError, match="no actions"):
        waypoints_of(plan.rest(3), hand)
    with pytest.raises(JShapeError, match="without its images"):
        waypoints_of(replace(plan, initial=None, patches=()), hand)
    some = Hand({"knock": hand.procedures["knock"]})
    with pytest.raises(UnknownName, match="unknown action 'poke'; allowed: knock"):
        waypoints_of(plan, some)
    with pytest.raises(UnknownName, match=r"unknown action 'knock'; allowed: \(none\)"):
        waypoints_of(plan, Hand({}))
    with pytest.raises(BadPosition, match="places are meant at 0.6 m, beyond the range"):
        waypoints_of(plan, hand, place_depth=0.6)
    with pytest.raises(BadPose, match="T_base_camera: is not rigid"):
        waypoints_of(plan, hand, 2 * BASE + np.diag([0, 0, 0, -1.0]))
    low = replace(hand, limits=replace(hand.limits, high_mm=(400.0, 400.0, 440.0)))
    with pytest.raises(PoseRefused, match="workspace"):
        waypoints_of(plan, low)


# On disk


def test_yaml_equals_json(plan, tmp_path):
    ways = waypoints_of(plan, load_hand(), BASE)
    for name in ("ways.json", "ways.yaml", "ways.yml"):
        waypoints.write_waypoints(tmp_path / name, ways)
    content = json.loads((tmp_path / "ways.json").read_text())
    assert content == ways
    for name in ("ways.yaml", "ways.yml"):
        assert yaml.safe_load((tmp_path / name).read_text()) == content


def test_a_file_can_be_followed_without_jshape(plan, tmp_path):
    waypoints.write_waypoints(tmp_path / "ways.yaml", waypoints_of(plan, load_hand(), BASE))
    content = yaml.safe_load((tmp_path / "ways.yaml").read_text())
    assert content["frame"] == "base" and content["frame_is"] == "the base of the arm"
    camera_base = np.linalg.inv(content["T_base_camera"])
    assert [action["action"] for action in content["actions"]] == ["knock", "poke", "knock"]
    for action in content["actions"]:
        *moves, clear = action["operations"]
        assert clear["operation"] == "clear" and clear["matrix"] is None
        assert clear["position_m"] is clear["quaternion_xyzw"] is None
        for one in moves:
            matrix = np.array(one["matrix"])
            again = pose_at(np.array(one["position_m"]), np.array(one["quaternion_xyzw"]))
            np.testing.assert_allclose(again, matrix, atol=1e-9)
            back = (camera_base @ matrix)[:3, 3]
            np.testing.assert_allclose(pixel(back, PAPER_Z), action["position_px"], atol=1e-6)
            assert 0 < one["speed_m_s"] <= 0.25 and 0 < one["effort_Nm"] <= 120
            assert (one["posture"] is None) == (one["posture_s"] is None)


def test_without_a_base_the_file_says_so(plan):
    fields = waypoints_of(plan, load_hand())
    assert fields["frame"] == "camera" and fields["T_base_camera"] is None
    assert "NOT the arm" in fields["frame_is"]


def test_every_number_has_a_unit(plan):
    fields = waypoints_of(plan, load_hand(), BASE)
    action = fields["actions"][0]
    for name, value in (action | action["operations"][3]).items():
        numbers = isinstance(value, float) or (isinstance(value, list) and name != "operations")
        if numbers:
            assert name.endswith((*waypoints.UNITS, "_mm")), name


def test_an_operation_without_motion_stays(plan):
    still = (Operation("above", height_mm=50.0), Operation("act", posture="fist", seconds=2.0))
    hand = Hand({name: Procedure(name, still) for name in ("knock", "poke")})
    act = waypoints_of(plan, hand)["actions"][0]["operations"][1]
    assert act["matrix"] is None and (act["posture"], act["posture_s"]) == ("fist", 2.0)


def test_a_path_is_in_the_file_between_two_heights(plan, tmp_path):
    """A sweep of twice the length across the dents: its depth is below the bed where it begins."""
    there = replace(
        plan, actions=("knock", "sweep", "knock"), lengths=np.array([1.0, 2.0, 1.0], np.float32)
    )
    ways, hand = waypoints_of(there, load_hand(), BASE), load_hand()
    fields = ways
    assert fields["version"] == 2 and waypoints_of(plan, hand)["version"] == 1
    sweep, camera_base = fields["actions"][1], np.linalg.inv(BASE)
    assert sweep["length"] == 2.0 and fields["actions"][0]["length"] == 1.0
    assert [one["operation"] for one in sweep["operations"] if "path" in one] == ["act"]
    act = sweep["operations"][3]
    assert act["path"][-1] == {name: act[name] for name in act["path"][-1]}
    points = np.array([np.array(one["matrix"]) @ [0, 0, 0, 1] for one in act["path"]])
    seen = (camera_base @ points.T).T[:, :3]
    # The hand goes down 82.5 mm before the place: beside the dent of 62 mm, and 60 degrees turned.
    np.testing.assert_allclose(seen[:, 2], FLAT + 0.5 * 0.0086, atol=1e-6)
    way = seen[1] - seen[0]
    assert np.linalg.norm(way) == pytest.approx(0.170)
    assert np.arctan2(way[1], way[0]) == pytest.approx(np.pi / 3)
    middle = pixel(seen.mean(0) - 0.0025 * way / 0.170, PAPER_Z)
    np.testing.assert_allclose(middle, plan.exact_positions[1], atol=1e-4)
    up = sweep["operations"][4]["matrix"]
    np.testing.assert_allclose((camera_base @ up)[:2, 3], seen[1, :2], atol=1e-9)
    for name in ("ways.json", "ways.yaml"):
        waypoints.write_waypoints(tmp_path / name, ways)
    assert json.loads((tmp_path / "ways.json").read_text()) == fields
    assert yaml.safe_load((tmp_path / "ways.yaml").read_text()) == fields


# The command


@pytest.fixture
def folder(plan, tmp_path, monkeypatch):
    write_plan(tmp_path / "my-plan" / "plan.json", plan)
    write_pose(tmp_path / "base.json", CameraPose(BASE))
    write_pose(tmp_path / "inhand.json", CameraPose(np.eye(4), "gripper"))
    (tmp_path / "gripper.json").write_text(json.dumps({"base_gripper": BASE.tolist()}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_waypoints_prints_and_writes(folder, capsys):
    command = ["waypoints", "my-plan", "--base", "base.json", "--out", "ways.yaml"]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "the arm's base" in text and text.count("knock") == 2 and "waypoints: ways.yaml" in text
    content = yaml.safe_load((folder / "ways.yaml").read_text())

    assert main(command) == 2
    assert "ways.yaml: exists" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result.pop("out") == "ways.yaml" and result == content

    inhand = ["waypoints", "my-plan/plan.json", "--base", "inhand.json", "--out", "same.json"]
    assert main([*inhand, "--gripper", "gripper.json"]) == 0
    np.testing.assert_allclose(
        json.loads((folder / "same.json").read_text())["T_base_camera"], BASE, atol=1e-9
    )
    capsys.readouterr()
    assert main(["waypoints", "my-plan", "--out", "seen.json"]) == 0
    assert "no --base was given" in capsys.readouterr().out
    assert json.loads((folder / "seen.json").read_text())["frame"] == "camera"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["my-plan", "--out", "ways.txt"], "ends in '.txt'; allowed: .json, .yaml, .yml"),
        (["nothing.json", "--out", "w.json"], "no such file"),
        (["my-plan", "--out", "w.json", "--hand", "nothing"], "nothing: no such folder"),
        (["my-plan", "--out", "w.json", "--hand", "my-plan"], "holds no limits.yaml"),
        (["my-plan", "--out", "w.json", "--base", "my-plan/plan.json"], "expected 'jshape-pose'"),
        (["my-plan", "--out", "w.json", "--base", "inhand.json"], "(--gripper)"),
        (["my-plan", "--out", "w.json", "--gripper", "gripper.json"], "goes with --base"),
        (
            ["my-plan", "--out", "w.json", "--base", "base.json", "--gripper", "gripper.json"],
            "a fixed camera needs no pose of the gripper",
        ),
        (["my-plan", "--out", "w.json", "--place-depth", "2"], "places are meant at 2 m"),
    ],
)
def test_waypoints_refuses_in_one_line(folder, capsys, arguments, said):
    assert main(["waypoints", *arguments]) == 2
    problem = capsys.readouterr().err
    assert said in problem and problem.count("\n") == 1
    assert not (folder / "w.json").exists()


def test_another_ending_is_refused(plan, tmp_path):
    with pytest.raises(BadFile, match="allowed: .json, .yaml, .yml"):
        waypoints.write_waypoints(tmp_path / "ways.toml", waypoints_of(plan, load_hand()))
