"""`jshape heightmap`, and `jshape plan` on its maps: what is said, written and refused."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jshape import Plan
from jshape.cli.main import main
from jshape.height_map import as_frame
from jshape.io.cameras import write_camera
from jshape.io.images import write_depth_png
from jshape.io.maps import read_map, write_map
from tests.seen_beds import SMALL, bed, heights, seen_by, standing

UNIT = 1e-4


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def tilted():
    """A camera at 30 degrees and what it sees."""
    camera = standing(30)
    return camera, seen_by(camera)


def written(name, camera, depth, pose=True):
    """Write a frame and NAME.json, its camera."""
    write_depth_png(f"{name}.png", depth, UNIT)
    write_camera(f"{name}.json", camera if pose else replace(camera, pose=None), UNIT)


def made(capsys, *words):
    """The result of a command."""
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys, match, *words):
    """Exit code 2 and one line that says the words."""
    assert main(list(map(str, words))) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("jshape: error: ")
    assert match in err, err


def off(found):
    """Errors of a map's heights, mm; NaN where it has none."""
    return 1e3 * np.where(found.mask, found.heights - heights(found.x, found.y[:, None]), np.nan)


def test_a_tilted_camera_is_found_and_its_bed_seen_from_above(folder, tilted, capsys):
    camera, depth = tilted
    written("camera", camera, depth, pose=False)
    said = made(capsys, "heightmap", "camera.png", "--out", "maps/bed.npz")
    (stand,) = said["cameras"]
    assert stand["tilt_deg"] == pytest.approx(30, abs=0.1)
    assert stand["distance"] == pytest.approx(0.45, abs=5e-4) and stand["frames"] == 1
    # 2.2 mm per square metre at 0.45 m, over the cosine of the ray's angle.
    assert stand["noise_mm"] == pytest.approx(2.2 * 0.45**2 / np.cos(np.radians(30)), rel=0.05)
    found = read_map("maps/bed.npz")
    assert np.nanmedian(np.abs(off(found))) < 0.15 and np.nanmax(np.abs(off(found))) < 1.5
    assert said["seen"] == pytest.approx(found.mask.mean()) and said["seen"] > 0.95
    assert said["rows"], said["columns"] == found.mask.shape
    picture = cv2.imread("maps/bed.png")
    assert min(picture.shape[:2]) > 300 and picture.std() > 20


def test_frames_of_a_resting_bed_are_averaged(folder, tilted, capsys, rng):
    camera, depth = tilted
    (folder / "looks").mkdir()
    write_camera("looks/camera.json", replace(camera, pose=None), UNIT)
    for k in range(9):
        noisy = depth + 2.2e-3 * depth**2 * rng.standard_normal(depth.shape)
        write_depth_png(f"looks/{k}.png", noisy, UNIT)
    one = made(capsys, "heightmap", "looks/0.png", "--out", "one.npz")
    all_of_it = made(capsys, "heightmap", "looks", "--like", "one.npz", "--out", "all.npz")
    again = [f"looks/{k}.png" for k in range(9)]
    assert made(capsys, "heightmap", *again, "--like", "one.npz", "--out", "same.npz")
    assert all_of_it["cameras"][0]["frames"] == 9
    assert all_of_it["noise_mm"] == pytest.approx(one["noise_mm"] / 3, rel=0.02)
    spread = [np.nanstd(off(read_map(f"{name}.npz"))) for name in ("one", "all")]
    assert spread[1] < 0.5 * spread[0]
    np.testing.assert_array_equal(read_map("all.npz").heights, read_map("same.npz").heights)
    assert main(["heightmap", "looks", "--out", "rest.npz"]) == 0
    assert "resting" not in capsys.readouterr().out
    dug = depth.copy()
    dug[45:75, 60:100] += 0.008
    write_depth_png("looks/8.png", dug, UNIT)
    assert main(["heightmap", "looks", "--out", "dug.npz"]) == 0
    said = r"looks and 8 more: (\d+)% of what they show differs between them by more than 2.\d mm"
    (share,) = re.findall(said, capsys.readouterr().out)
    assert int(share) == pytest.approx(100 * 1200 / (depth > 0).sum(), abs=2)


def test_a_folder_of_recordings_says_what_it_holds(folder, tilted, capsys):
    for name in ("left", "right"):
        (folder / "both" / name).mkdir(parents=True)
        write_camera(f"both/{name}/camera.json", SMALL, UNIT)
        write_depth_png(f"both/{name}/0.png", tilted[1], UNIT)
    said = "both: has no camera.json, so it is not a recording; name one that it holds: both/left, "
    refused(capsys, f"{said}both/right", "heightmap", "both", "--out", "x.npz")


def test_what_is_odd_is_named(folder, tilted, capsys):
    """Among several frames and files; a wall; maps in two frames; a mask of nothing."""
    written("right", *tilted, pose=False)
    written("left", *tilted)
    both = ("heightmap", "left.png", "right.png", "--out", "x.npz", "--camera-file")
    both = (*both, "left.json", "right.json")
    refused(capsys, "right.png of right.json: has no", *both)
    steep = standing(60)
    written("steep", steep, seen_by(steep))
    assert main(["heightmap", "steep.png", "--camera-file", "steep.json", "--out", "b.npz"]) == 0
    assert "steep.png: the bed is seen 60 degrees from straight above" in capsys.readouterr().out
    write_map("level.npz", replace(bed(), frame=as_frame(np.eye(4))))
    write_map("b.npz", replace(bed(), frame=as_frame(np.diag([-1.0, -1.0, 1.0, 1.0]))))
    said = "level.npz and b.npz: the maps lie in different frames; make the second one like the "
    refused(capsys, said, "plan", "level.npz", "b.npz")
    cv2.imwrite("none.png", np.zeros(bed().mask.shape, np.uint8))
    words = ("plan", "level.npz", "level.npz", "--reachable", "none.png")
    refused(capsys, "none.png: is 0 everywhere;", *words)


@pytest.mark.full
def test_two_cameras_see_more_and_err_less(folder, tilted, capsys):
    written("left", *tilted)
    right = standing(30, turn_deg=180)
    written("right", right, seen_by(right))
    both = ("left.png", "right.png", "--camera-file", "left.json", "right.json")
    said = made(capsys, "heightmap", *both, "--out", "bed.npz")
    ones = said["cameras"]
    assert [one["name"] for one in ones] == ["left.png", "right.png"]
    assert [one["tilt_deg"] for one in ones] == pytest.approx([30, 30], abs=0.2)
    assert said["seen"] > max(one["seen"] for one in ones)
    assert said["noise_mm"] < 0.8 * min(one["noise_mm"] for one in ones)
    assert main(["heightmap", *both, "--out", "bed.npz", "--overwrite"]) == 0
    assert "together" in capsys.readouterr().out
    moved = replace(right, pose=(*right.pose[:2], (*right.pose[2][:3], 0.42), right.pose[3]))
    write_camera("right.json", moved, UNIT)
    refused(
        capsys, "is the pose of one wrong, or did it move?", "heightmap", *both, "--out", "x.npz"
    )
    write_camera("right.json", replace(right, pose=None), UNIT)
    refused(capsys, "right.png of right.json: has no pose;", "heightmap", *both, "--out", "x.npz")


def test_the_pitch_and_the_window_are_as_asked(folder, tilted, capsys):
    camera, depth = tilted
    written("camera", camera, depth, pose=False)
    words = ("heightmap", "camera.png", "--pitch-mm", "4", "--window", "60,40,40x40")
    said = made(capsys, *words, "--out", "part.npz")
    assert said["pitch_m"] == 0.004
    wide = 40 / 140 * 0.45  # of a window before the middle of the bed, metres
    assert said["columns"] * 0.004 == pytest.approx(wide, rel=0.15)


REFUSED = {
    "no npz": ("a height map's file ends in .npz", "now.png", "--out", "map.png"),
    "its own frame": ("would replace now.png, a frame", "now.png", "--out", "now.npz"),
    "no camera": ("no camera.json beside it says which", "now.png", "--out", "x.npz"),
    "too few": ("3 frames and 2 camera files", *3 * ["now.png"], "--camera-file", "c.json",
                "c.json", "--out", "x.npz"),
    "a pitch": ("the map of --like has its own", "now.png", "--camera-file", "c.json", "--like",
                "bed.npz", "--pitch-mm", "2", "--out", "x.npz"),
    "too fine": ("nodes 0.001 mm apart are too many for a bed of", "now.png", "--camera-file",
                 "c.json", "--pitch-mm", "0.001", "--out", "x.npz"),
    "another unit": ("0.0001 instead of 0.001 would fit", "now.png", "--camera-file", "c.json",
                     "--depth-unit", "0.001", "--out", "x.npz"),
    "a window": ("leaves the 160x120 image", "now.png", "--camera-file", "c.json", "--window",
                 "0,0,999x9", "--out", "x.npz"),
    "there already": ("bed.npz: exists", "now.png", "--camera-file", "c.json", "--out", "bed.npz"),
    "no frame": ("nowhere.png: no such file", "nowhere.png", "--camera-file", "c.json", "--out",
                 "x.npz"),
    "no map": ("has no height_m", "now.png", "--camera-file", "c.json", "--like", "other.npz",
               "--out", "x.npz"),
    "no bed": ("the bed's plane is not found: ", "noise.png", "--camera-file", "c.json", "--out",
               "x.npz"),
    "moved": ("did the camera move?", "now.png", "--camera-file", "c.json", "--like", "bed.npz",
              "--out", "x.npz"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_words_are_refused_in_one_line(case, folder, tilted, capsys, rng):
    depth = tilted[1]
    write_depth_png("now.png", depth, UNIT)
    write_depth_png("noise.png", rng.uniform(0.3, 0.7, depth.shape), UNIT)
    write_camera("c.json", SMALL, UNIT)
    moved = np.eye(4)
    moved[2, 3] = 0.02
    frame = as_frame(np.linalg.inv(np.array(tilted[0].pose)) @ moved)
    write_map("bed.npz", replace(bed(), frame=frame))
    np.savez("other.npz", a=np.zeros(3))
    match, *words = REFUSED[case]
    refused(capsys, match, "heightmap", *words)
    assert not (folder / "x.npz").exists()


@pytest.mark.full
def test_a_plan_on_two_maps(folder, capsys):
    now = bed(0.004)
    holes = np.ones(now.mask.shape, bool)
    holes[:6, :9] = False
    write_map("now.npz", replace(now, seen=holes))
    write_map("wanted.npz", bed(0.004, of=lambda x, y: 0 * x * y))
    words = ("plan", "now.npz", "wanted.npz", "--max-steps", "1", "--yaws", "1", "--stride", "8")
    assert main([*words, "--out", "my-plan"]) == 0
    text = capsys.readouterr().out
    assert "x (mm)  y (mm)" in text and "of it known in both" in text
    found = Plan.from_json("my-plan/plan.json")
    step = json.loads((folder / "my-plan/plan.json").read_text())["steps"][0]
    # The mound is the most that is wrong: at x 40, y -20 mm.
    assert step["map_m"] == pytest.approx((0.04, -0.02), abs=0.03)
    (u, v), (x, y) = found.positions[0], step["map_m"]
    assert (x, y) == pytest.approx((-0.16 + 0.004 * u, 0.12 - 0.004 * v), abs=2e-3)
    np.testing.assert_array_equal(found.seen, holes[::-1])
    assert np.isnan(found.height_maps[0].heights[~holes]).all()
    for name in ("plan.png", "actions.png", "steps.png"):
        pink = (cv2.imread(f"my-plan/{name}") == (225, 228, 255)).all(-1)
        assert pink.mean() > 5e-4, "what was not seen is not shown as a height"


def test_a_map_without_a_frame_is_taken_for_the_others_and_that_is_said(folder, capsys):
    write_map("my now.npz", replace(bed(), frame=None))
    write_map("wanted.npz", replace(bed(), frame=as_frame(np.eye(4))))
    words = ("--max-steps", "1", "--positions", "2x2", "--strengths", "1", "--yaws", "1")
    for path in ("my now.npz", "wanted.npz"):
        assert main(["plan", path, "wanted.npz", *words]) == 0
        said = "my now.npz: has no frame; that of the other map is taken for its own"
        assert (said in capsys.readouterr().out) == (path == "my now.npz")
    write_depth_png("a look.png", np.ones((9, 9)), UNIT)
    makes = "jshape heightmap 'a look.png' --like 'my now.npz' --out MAP.npz makes one"
    refused(capsys, makes, "plan", "my now.npz", "a look.png")


def test_maps_and_frames_are_not_mixed(folder, tilted, capsys):
    write_map("now.npz", bed())
    write_depth_png("wanted.png", tilted[1], UNIT)
    refused(capsys, "wanted.png: is no height map, and now.npz is", "plan", "now.npz", "wanted.png")
    refused(capsys, "wanted.png: is no height map, and now.npz is", "plan", "wanted.png", "now.npz")
    refused(capsys, "--window: for frames", "plan", "now.npz", "now.npz", "--window", "0,0,9x9")
    write_depth_png("mask.png", tilted[1], UNIT)
    words = ("plan", "now.npz", "now.npz", "--reachable", "mask.png")
    refused(capsys, "has (120, 160) (rows, columns); the map makes (121, 161)", *words)


def test_where_the_hand_may_go_is_said_in_metres(folder, monkeypatch, capsys):
    """Of the map, and of the base that the map's cameras stand in; every odd file is one line."""
    frame = np.diag([-1.0, -1.0, 1.0, 1.0])  # the map lies the other way round in the base
    frame[:3, 3] = 0.5, 0.1, 0.02
    write_map("now.npz", replace(bed(), frame=as_frame(frame)))
    write_map("own.npz", replace(bed(), frame=None))
    given = {}
    triangle = np.array([[-0.021, -0.011], [0.021, -0.011], [0, 0.031]])
    with monkeypatch.context() as patch:
        patch.setattr("jshape.planning.api.plan", lambda *_, **words: given.update(words) or 1 / 0)
        for name, area in (("map", (0.03, -0.03) + triangle), ("base", (0.47, 0.13) - triangle)):
            corners = area.tolist()
            Path(f"{name}.json").write_text(json.dumps({"frame": name, "polygon_m": corners}))
            with pytest.raises(ZeroDivisionError):
                main(["plan", "now.npz", "now.npz", "--reachable", f"{name}.json"])
            x, y = np.meshgrid(bed().x - 0.03, bed().y + 0.03)
            inside = (y > -0.011) & (y < 0.031 - 2 * np.abs(x))
            np.testing.assert_array_equal(given["constraints"].reachable[::-1], inside)
            assert f"reachable: {inside.mean():.1%} of the bed" in capsys.readouterr().out

    def area(*corners):
        return {"frame": "map", "polygon_m": corners}

    for content, said in (
        ({"frame": "world", "polygon_m": corners}, "frame is 'world'; allowed: base, map"),
        ({"frame": "map", "polygon_m": corners}, "in frame map the bed is x -0.160 to 0.160, y"),
        ({"frame": "map", "polygon_m": corners[:2]}, "polygon_m has 2 corners; an area has 3"),
        ({"frame": "map"}, "area.json: missing polygon_m"),
        (area([-100, -80], [100, -80], [100, 80]), "(in millimetres it would be -0.1 m)"),
        (area([1e308, 0], [0, 1], [0, 0]), "a corner at 1e+308; it is in metres, at most 10"),
        (area([0, 0], [0.1, 0.1], [0.3, 0.3]), "no area: its corners lie on one line"),
        (area([0, 0], [1, 1], [1, 0], [0, 1]), "between corners 1-2 and 3-4; give them in order"),
    ):
        Path("area.json").write_text(json.dumps(content))
        refused(capsys, said, "plan", "now.npz", "now.npz", "--reachable", "area.json")
    said = "base.json: frame is 'base', and nothing says where the arm's base is"
    refused(capsys, said, "plan", "own.npz", "own.npz", "--reachable", "base.json")
