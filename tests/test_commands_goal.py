"""`jshape goal`, as people use it: every source, what is written, and every refusal."""

import json
import shlex
from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest
from PIL import Image

from jshape import PAPER_BOX, Camera, load_bank, rollout, sim
from jshape.actions import PlacedAction
from jshape.cli.main import main
from jshape.data.view import View, image_of_depth
from jshape.height_map import ABOVE, as_frame
from jshape.io.cameras import read_camera, write_camera
from jshape.io.formats import read_drawing
from jshape.io.images import read_depth, write_depth_png
from jshape.reproject import reproject

OTHER = Camera(320, 240, 280.0, 280.0, 161.0, 118.0, 0.3, 1.0)
UNIT = 1e-4


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A hilly bed, the same after a knock, as counts of the paper's box; the working directory."""
    monkeypatch.chdir(tmp_path)
    bed = sim.irregular_bed(jax.random.key(1), 0.003)
    after = sim.apply_action(jax.random.key(2), bed, "flour", ("knock", "robot"), (0.05, 0.02))
    for name, state in (("now", bed), ("after", after)):
        write_depth_png(f"{name}.png", np.asarray(sim.render(state, PAPER_BOX)), UNIT)
    write_camera("camera.json", PAPER_BOX, UNIT)
    return tmp_path


def made(capsys, *words):
    """The JSON of a goal that is made in the folder "goal"."""
    assert main(["goal", *words, "--out", "goal", "--overwrite", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def change_mm(folder, suffix="png"):
    """What the written goal asks of the written bed, mm up."""
    _, unit = read_camera(folder / "goal" / "camera.json")
    now, goal = (
        read_depth(folder / "goal" / f"{name}.{suffix}", depth_unit=unit)
        for name in ("now", "goal")
    )
    return 1e3 * (now - goal)


def refused(capsys, said, *words):
    assert main(["goal", *words]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1, error


@pytest.mark.full
def test_a_newcomer_makes_a_goal_without_a_camera_and_plans_for_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["goal", "flat", "--text", "J", "--out", "my own"]) == 0
    said = capsys.readouterr().out
    assert "cm³ sunk" in said and "jshape plan 'my own/now.png' 'my own/goal.png'" in said
    assert sorted(path.name for path in (tmp_path / "my own").iterdir()) == [
        "camera.json", "goal.png", "now.png", "picture.png", "report.json"
    ]  # fmt: skip
    goal = read_depth("my own/goal.png", depth_unit=UNIT)
    now = read_depth("my own/now.png", depth_unit=UNIT)
    assert now.std() < 1e-6 and (goal - now).max() == pytest.approx(0.008, abs=2e-4)
    assert (goal - now).min() > -1e-6
    assert cv2.imread("my own/picture.png").std() > 10
    assert (
        main(
            [
                "plan",
                "my own/now.png",
                "my own/goal.png",
                "--stride",
                "24",
                "--strengths",
                "0.3,0.6",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert found["distances_mm"][-1] < found["distances_mm"][0]
    # Again: not over what is there, unless that is said.
    assert main(["goal", "flat", "--text", "J", "--out", "my own"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["goal", "flat", "--text", "L", "--out", "my own", "--overwrite"]) == 0


@pytest.mark.full
def test_texts_are_raised_balanced_and_placed(folder, capsys):
    said = made(capsys, "now.png", "--text", "+", "--raise-mm", "5", "--balance",
                "--at", "150,120", "--size-mm", "80", "--turn", "45")  # fmt: skip
    change = change_mm(folder)
    v, u = np.nonzero(change > 3)
    assert abs(u.mean() - 150) < 2 and abs(v.mean() - 120) < 2
    assert abs(said["net_cm3"]) < 0.01 * said["raised_cm3"] and said["raised_cm3"] > 3
    assert said["balance"]["how"] == "around" and said["at"] == [150, 120]
    written = json.loads((folder / "goal" / "report.json").read_text())
    assert written["raised_cm3"] == said["raised_cm3"] and written["next"] == said["next"]
    moved = written["transport"]
    assert moved == said["transport"] and 20 < moved["way_mm"] < 60
    assert moved["bring_cm3"] == pytest.approx(said["raised_cm3"], rel=0.05)
    carried = sum(one["volume_cm3"] for one in moved["carries"])
    assert carried == pytest.approx(moved["take_cm3"]) and 3 < carried < moved["bring_cm3"]


@pytest.mark.full
def test_what_is_made_small_near_the_edge_is_said(folder, capsys):
    small = made(capsys, "now.png", "--text", "J", "--at", "30,30")
    middle = made(capsys, "now.png", "--text", "J")
    asked = made(capsys, "now.png", "--text", "J", "--at", "30,30", "--size-mm", "20")
    assert f"{max(small['size_mm']):.0f} mm large" in small["assumed"][0]
    assert f"not {max(middle['size_mm']):.0f} as in its middle" in small["assumed"][0]
    assert not middle["assumed"] and not asked["assumed"]


@pytest.mark.full
def test_masks_lie_on_the_frame_or_where_they_are_placed(folder, capsys):
    mask = np.zeros(PAPER_BOX.shape, np.uint8)
    cv2.circle(mask, (200, 150), 40, 255, -1)
    cv2.imwrite("mask.png", mask)
    made(capsys, "now.png", "--mask", "mask.png", "--depth-mm", "6")
    v, u = np.nonzero(change_mm(folder) < -4)
    assert abs(u.mean() - 200) < 1.5 and abs(v.mean() - 150) < 1.5 and u.size > 2500
    ink = np.full((100, 100, 3), 255, np.uint8)  # dark on bright, in colour
    cv2.circle(ink, (50, 50), 45, (160, 0, 0), -1)
    cv2.imwrite("ink.png", ink)
    said = made(capsys, "now.png", "--mask", "ink.png", "--invert", "--size-mm", "60")
    assert said["size_mm"] == [60, 60] and said["sunk_cm3"] == pytest.approx(12, rel=0.2)
    words = ["now.png", "--mask", "ink.png"]
    refused(capsys, "ink.png: has 100x100 pixels and the bed 480x395", *words)


@pytest.mark.full
def test_height_maps_meshes_and_another_unit(folder, capsys):
    import trimesh

    grey = np.linspace(0, 255, 200).astype(np.uint8).reshape(10, 20)
    cv2.imwrite("grey.png", cv2.resize(grey, (200, 100)))
    made(capsys, "now.png", "--height-map", "grey.png", "--raise-mm", "6", "--depth-mm", "3",
         "--size-mm", "150")  # fmt: skip
    assert change_mm(folder).max() == pytest.approx(6, abs=0.5)  # white is at the edge
    assert change_mm(folder).min() == pytest.approx(-3, abs=0.3)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=15.0)
    for kind in ("stl", "obj", "ply"):
        ball.export(f"ball.{kind}")
        said = made(capsys, "now.png", "--mesh", f"ball.{kind}", "--depth-mm", "5")
        np.testing.assert_allclose(said["size_mm"], 30, rtol=0.02)
        assert "taken for mm" in said["assumed"][0]
        assert change_mm(folder).min() == pytest.approx(-5, abs=0.2)
    ball.apply_scale(1e-3).export("metres.stl")
    assert "taken for m;" in made(capsys, "now.png", "--mesh", "metres.stl")["assumed"][0]
    refused(capsys, "--size-mm", "now.png", "--mesh", "ball.stl", "--mesh-unit", "m")
    said = made(capsys, "now.png", "--mesh", "ball.stl", "--mesh-unit", "inch", "--size-mm", "40")
    assert not said["assumed"] and max(said["size_mm"]) == pytest.approx(40)


@pytest.mark.full
def test_a_frame_is_a_goal_as_it_is(folder, capsys):
    said = made(capsys, "now.png", "--frame", "after.png")
    after = read_depth("after.png", depth_unit=UNIT)
    goal = read_depth("goal/goal.png", depth_unit=UNIT)
    assert np.abs(goal - after).mean() < 2e-6
    assert said["allowed_deg"] > 70 and said["sunk_cm3"] > 10
    loose = made(capsys, "now.png", "--frame", "after.png", "--slope", "30")
    assert loose["left"]["too steep"]["volume_cm3"] > 5
    words = ["now.png", "--frame", "after.png", "--size-mm", "9"]
    refused(capsys, "--size-mm says nothing of --frame", *words)


@pytest.mark.full
def test_actions_are_what_the_bank_predicts(folder, capsys):
    words = "knock 240,197; press 120,110x1.5@30"
    made(capsys, "now.png", "--actions", words)
    bank = load_bank("pressed-flour-robot")
    now = image_of_depth(read_depth("now.png", depth_unit=UNIT), bank.camera).image
    plan = rollout(now, now, ["knock", "press"], [[240, 197], [120, 110]], strengths=[1, 1.5],
                   yaws=[0, np.pi / 6])  # fmt: skip
    goal = image_of_depth(read_depth("goal/goal.png", depth_unit=UNIT), bank.camera).image
    moved = np.abs(plan.images[-1] - now).mean()
    assert np.abs(goal - plan.images[-1]).mean() < 0.1 * moved
    plan.to_json("plan.json")
    first = change_mm(folder)
    assert made(capsys, "now.png", "--actions", "plan.json")["made_from"] == "2 actions"
    np.testing.assert_allclose(change_mm(folder), first, atol=0.11)


@pytest.mark.full
def test_actions_may_be_longer_than_trained(folder, capsys):
    bank = "moving-flour-robot"
    made(capsys, "now.png", "--actions", "sweep 240,197x0.8@90 length 1.4", "--bank", bank)
    now = image_of_depth(read_depth("now.png", depth_unit=UNIT), PAPER_BOX).image
    goal = image_of_depth(read_depth("goal/goal.png", depth_unit=UNIT), PAPER_BOX).image
    off = []
    for length in (1.0, 1.4):
        act = PlacedAction("sweep", (240, 197), 0.8, np.pi / 2, length)
        off.append(np.abs(rollout(now, now, [act], bank=bank).images[-1] - goal).mean())
    assert off[1] < 0.1 * np.abs(goal - now).mean() and off[1] < 0.3 * off[0]


@pytest.mark.full
def test_another_camera_keeps_its_own_pixels_and_format(folder, capsys):
    depth = np.asarray(sim.render(sim.flat_bed(), OTHER))
    np.save("other.npy", depth)
    write_camera("other.json", OTHER, 0.001)
    said = made(capsys, "other.npy", "--camera-file", "other.json", "--actions", "knock 100,90")
    change = change_mm(folder, "npy")
    v, u = np.unravel_index(np.argmin(cv2.blur(change, (15, 15))), change.shape)
    assert abs(u - 100) < 15 and abs(v - 90) < 15 and change.min() < -5
    assert "another one" in said["assumed"][0]
    assert main([*shlex.split(said["next"])[1:4], "--positions", "5x5", "--max-steps", "1"]) == 0
    capsys.readouterr()
    luminance = np.full(PAPER_BOX.shape, 102, np.uint8)
    cv2.imwrite("dark.png", luminance)
    made(capsys, "dark.png", "--text", "I")
    assert read_camera("goal/camera.json")[1] == UNIT
    assert change_mm(folder).min() == pytest.approx(-8, abs=0.2)


TILTED = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, 0.3, 1.0)


def seen_at_30_degrees(depth):
    """What `TILTED`, 0.5 m from the middle of the bed, sees of what the bank's camera saw."""
    a, pose = np.radians(30.0), np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]]
    pose[:3, 3] = [0.0, 0.0, 0.45] - 0.5 * pose[:3, 2]
    posed, span = replace(TILTED, pose=as_frame(pose)), np.array([0.3, 0.8], np.float32)
    return np.nan_to_num(np.asarray(reproject(depth, PAPER_BOX, posed, span)))


@pytest.mark.full
def test_a_goal_on_a_tilted_bed_is_made_and_planned_for_from_above(folder, capsys):
    """Places, drawings, frames and masks are those of the camera; what is written is a map."""
    flat = np.asarray(sim.render(sim.flat_bed(), PAPER_BOX))
    np.save("tilted.npy", seen_at_30_degrees(flat))
    write_camera("tilted.json", TILTED, 0.001)
    bed = "tilted.npy", "--camera-file", "tilted.json"

    def dug(*words, share=0.5):
        """What is asked for, and the camera's pixel in its middle."""
        said = made(capsys, *bed, *words)
        now, goal = np.load("goal/now.npy"), np.load("goal/goal.npy")
        np.testing.assert_array_equal(np.isnan(now), np.isnan(goal))
        assert np.abs(np.nanmedian(now) - ABOVE) < 5e-4
        change = np.nan_to_num(goal - now)
        middle = np.argwhere(change > share * change.max())[:, ::-1].mean(0)
        view = View(TILTED, read_camera("goal/camera.json")[0])
        return said, change, middle, view.pixels(middle[None], [ABOVE])[0]

    said, change, middle, own = dug("--text", "I", "--at", "320,200", "--depth-mm", "6")
    assert "tilted by 30.0 degrees" in said["assumed"][0]
    assert read_camera("goal/camera.json")[0].orthographic and 0.005 < change.max() < 0.0065
    np.testing.assert_allclose(own, [320, 200], atol=3)
    quick = ["--positions", "9x9", "--max-steps", "1", "--json"]
    assert main([*shlex.split(said["next"])[1:4], *quick]) == 0
    (step,) = json.loads(capsys.readouterr().out)["steps"]
    assert np.abs(np.subtract(step["position"], middle)).max() < 60

    # A drawing of the camera's own size, at the same place; and a mask that ends in its middle.
    drawn, free = np.zeros(TILTED.shape, np.uint8), np.zeros(TILTED.shape, np.uint8)
    drawn[180:221, 300:341], free[:, 320:] = 255, 255
    cv2.imwrite("drawn.png", drawn)
    cv2.imwrite("free.png", free)
    words = "--mask", "drawn.png", "--depth-mm", "6"
    _, whole, _, own = dug(*words)
    np.testing.assert_allclose(own, [320, 200], atol=3)
    _, part, _, _ = dug(*words, "--reachable", "free.png")
    assert 0.4 < part.sum() / whole.sum() < 0.6

    # Another frame of that camera, and actions at its pixels.
    after = flat.copy()
    after[150:200, 200:280] += 0.006
    np.save("after.npy", seen_at_30_degrees(after))
    _, change, _, _ = dug("--frame", "after.npy")
    assert np.median(change[change > 0.003]) == pytest.approx(0.006, abs=5e-4)
    _, _, _, own = dug("--actions", "knock 320,200")
    np.testing.assert_allclose(own, [320, 200], atol=15)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(
    "kind", ["grey.png", "sixteen.png", "colour.png", "photo.JPG", "sixteen.tif"]
)
def test_what_a_phone_turned_comes_in_upright(tmp_path, kind, orientation):
    """An arrow with a spot, written as each EXIF orientation stores it."""
    upright = np.zeros((48, 32), np.uint8)
    upright[8:40, 8:24], upright[32:40, 8:16] = 120, 240
    backwards = {1: None, 2: "FLIP_LEFT_RIGHT", 3: "ROTATE_180", 4: "FLIP_TOP_BOTTOM",
                 5: "TRANSPOSE", 6: "ROTATE_90", 7: "TRANSVERSE", 8: "ROTATE_270"}  # fmt: skip
    image = Image.fromarray(upright)
    if orientation > 1:
        image = image.transpose(Image.Transpose[backwards[orientation]])
    if kind.startswith("sixteen"):
        image = Image.fromarray(np.asarray(image).astype(np.uint16) * 200)
        upright = upright.astype(np.uint16) * 200
    if kind.startswith(("colour", "photo")):
        image = image.convert("RGB")
    exif = Image.Exif()
    exif[0x0112] = orientation
    more = {"tiffinfo": {0x0112: orientation}} if kind.endswith("tif") else {"exif": exif}
    image.save(tmp_path / kind, **more, **({"quality": 100} if "photo" in kind else {}))
    found = read_drawing(tmp_path / kind)
    assert found.dtype == upright.dtype and found.shape == upright.shape
    assert np.abs(found.astype(int) - upright).max() <= (9 if "photo" in kind else 0)


@pytest.mark.parametrize(
    "words, said",
    [
        (["--text", ""], "--text: is empty"),
        (["--text", "J", "--at", "900,100"], "the place (900, 100) is outside the view"),
        (["--text", "HELLO", "--size-mm", "900"], "is the largest that fits"),
        (["--text", "J", "--depth-mm", "5", "--raise-mm", "5"], "not both"),
        (["--text", "J", "--material", "mud"], "unknown material 'mud'"),
        (["--mesh", "no.stl"], "no.stl: no such file"),
        (["--mesh", "empty.stl"], "has no face"),
        (["--mesh", "now.png"], "is no point cloud or mesh; allowed: .ply, .obj, .stl"),
        (["--mask", "empty.stl"], "not an image"),
        (["--mask", "cut.jpg"], "cut.jpg: the painting is cut off"),
        (["--height-map", "after.png"], "need a height"),
        (["--frame", "mask.npy"], "has 7x5 pixels"),
        (["--actions", "stir 1,2"], "unknown action 'stir'"),
        (["--actions", "knock at 3"], "'knock at 3' is not an action like"),
        (["--actions", ";"], "no action is given"),
        (["--actions", "bad.json"], "bad.json: format is None"),
        (["--actions", "knock 900,2"], "outside"),
        (["--text", "J", "--reachable", "mask.npy"], "the camera makes (395, 480)"),
        (["--mask", "mask.npy", "--size-mm", "50"], "nothing is drawn"),
    ],
)
def test_odd_input_is_one_clear_line(folder, capsys, words, said):
    (folder / "empty.stl").write_text("solid nothing\nendsolid nothing\n")
    (folder / "cut.jpg").write_bytes(b"\xff\xd8\xff" + b"x" * 40)
    (folder / "bad.json").write_text('{"actions": [{"action": "knock", "at": "here"}]}')
    np.save("mask.npy", np.full((5, 7), np.nan, np.float32))
    if words[0] == "--frame":
        np.save("mask.npy", np.full((5, 7), 0.45, np.float32))
    refused(capsys, said, "now.png", *words)


def test_beds_that_cannot_be(folder, capsys):
    refused(capsys, "no.png: no such file", "no.png", "--text", "J")
    refused(capsys, "leave --camera out", "flat", "--text", "J", "--camera-file", "camera.json")
    write_depth_png(
        "gone.png", np.where(np.arange(480) < 100, np.nan, 0.45) * np.ones((395, 1)), UNIT
    )
    refused(capsys, "gone.png: 20.8 % of the pixels", "gone.png", "--text", "J")
    assert main(["goal", "now.png"]) == 2
    assert "--text" in capsys.readouterr().err
    for option, value in (("--at", "3"), ("--turn", "nan"), ("--slope", "90"), ("--floor-mm", "0")):
        assert main(["goal", "now.png", "--text", "J", option, value]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and value in error
