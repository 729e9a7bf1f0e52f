"""The command line as a user meets it: what is printed, what is written, and every refusal."""

import contextlib
import io
import json
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera, Plan, metric, save_bank
from jshape.cli import COMMANDS
from jshape.cli.commands import build_app, leaves
from jshape.cli.examples import EXAMPLES, of
from jshape.cli.main import main
from jshape.cli.options import duration
from jshape.cli.parser import parse
from jshape.cli.tables import coloured, shows_colours
from jshape.errors import UnknownName
from jshape.height_map import as_frame
from jshape.io.banks import MANIFEST
from jshape.io.cameras import write_camera
from jshape.planning.options import GROUPS
from jshape.reproject import reproject
from tests.conftest import ROOT


@pytest.fixture
def folder(tmp_path, bank, molded, monkeypatch):
    """A folder with two frames, a camera and a bank; the working directory."""
    now, goal, _ = molded
    for name, image in (("now", now), ("goal", goal)):
        depth = np.asarray(PAPER_BOX.depth(metric.unweigh(image, PAPER_BOX)))
        counts = np.rint(depth / 1e-5).astype(np.uint16)
        cv2.imwrite(str(tmp_path / f"{name}.png"), counts)
    write_camera(tmp_path / "camera.json", PAPER_BOX, 1e-5)
    save_bank(bank, tmp_path / "bank")
    places = [[91, 92], [239, 197], [387, 302]]
    (tmp_path / "places.json").write_text(json.dumps({"positions": places}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


PLAN = [
    *("plan", "now.png", "goal.png", "--bank", "bank", "--strengths", "1", "--yaws", "1"),
    *("--positions", "places.json"),
]


@pytest.mark.full
def test_plan_prints_the_actions_and_writes_pictures(folder, capsys, molded):
    assert main([*PLAN, "--out", "out"]) == 0
    text = capsys.readouterr().out
    assert text.count("knock") == 2 and text.count("poke") == 1 and "to the goal (mm)" in text
    found = Plan.from_json(folder / "out" / "plan.json")
    assert sorted(found.actions) == sorted(name for name, *_ in molded[2])
    for name in ("plan.png", "actions.png", "steps.png"):
        picture = cv2.imread(str(folder / "out" / name))
        assert picture.shape[0] > 200 and picture.std() > 10


def test_json_output_is_json_and_nothing_else(folder, capsys):
    assert main([*PLAN, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [s["action"] for s in result["steps"]].count("knock") == 2
    assert result["distances_mm"][-1] < result["distances_mm"][0]
    assert [s["camera_position"] for s in result["steps"]] == [
        s["position"] for s in result["steps"]
    ]


def test_pictures_that_cannot_be_drawn_cost_no_plan(folder, capsys, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("Failed to process string with tex because latex could not be found")

    for name in ("plan_figure", "overlay_figure"):
        monkeypatch.setattr(f"jshape.viz.pictures.{name}", broken)
    assert main([*PLAN, "--out", "out"]) == 0
    assert sorted(os.listdir("out")) == ["plan.json", "steps.png"]
    said = capsys.readouterr().err.splitlines()
    assert [line.split(":")[1] for line in said] == [
        " plan.png could not be drawn", " actions.png could not be drawn"
    ]  # fmt: skip


def test_limits_reach_the_planner(folder, capsys):
    assert main([*PLAN, "--json", "--max-steps", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "MAX_STEPS"
    assert main([*PLAN, "--json", "--min-gain-mm", "50"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == []


@pytest.mark.parametrize("kind", ["npy", "tiff", "8-bit", "float-tiff"])
def test_every_kind_of_image(folder, capsys, kind):
    counts = {n: cv2.imread(f"{n}.png", cv2.IMREAD_UNCHANGED) for n in ("now", "goal")}
    for name, image in counts.items():
        metres = image.astype(np.float32) * 1e-5
        if kind == "npy":
            np.save(f"{name}.npy", metres)
        elif kind == "tiff":
            cv2.imwrite(f"{name}.tiff", image)
        elif kind == "float-tiff":
            cv2.imwrite(f"{name}.tiff", metres)
        else:
            cv2.imwrite(f"{name}8.png", np.asarray(PAPER_BOX.luminance(metres)).astype(np.uint8))
    suffix = {"npy": ".npy", "8-bit": "8.png"}.get(kind, ".tiff")
    options = ["plan", f"now{suffix}", f"goal{suffix}", *PLAN[3:], "--json"]
    assert main(options) == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(s["action"] for s in found["steps"])[:3] == ["knock", "knock", "poke"]
    light = "8 bits are luminance: white is 0.42 m away, black 0.47 m"
    assert (light in found["source"]) == (kind == "8-bit")


def test_a_goal_as_a_point_cloud(folder, capsys):
    import trimesh

    counts = cv2.imread("goal.png", cv2.IMREAD_UNCHANGED)
    level = PAPER_BOX.luminance(counts.astype(np.float32) * 1e-5, quantize=False)
    cloud = np.asarray(PAPER_BOX.points(level)).reshape(-1, 3)
    (folder / "goal.ply").write_bytes(trimesh.PointCloud(cloud).export(file_type="ply"))
    assert main(["plan", "now.png", "goal.ply", *PLAN[3:], "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert sorted(s["action"] for s in steps) == ["knock", "knock", "poke"]


def test_holes_are_filled_and_counted(folder, capsys):
    counts = cv2.imread("now.png", cv2.IMREAD_UNCHANGED)
    counts[100:110, 200:230] = 0
    cv2.imwrite("now.png", counts)
    assert main([*PLAN, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["filled"] == [300, 0]


def _png(name, array):
    assert cv2.imwrite(name, array)
    return name


def _bytes(name, content):
    with open(name, "wb") as file:
        file.write(content)
    return name


def _npy(name, array):
    np.save(name, array)
    return name


BOX = (395, 480)
BAD_IMAGES = {
    "wrong size": (lambda: _png("x.png", np.full((100, 100), 450, np.uint16)), "100x100"),
    "wrong type": (lambda: _npy("x.npy", np.full(BOX, 450, np.int64)), "int64"),
    "RGB": (lambda: _png("x.png", np.zeros((*BOX, 3), np.uint8)), "channel"),
    "empty": (lambda: _bytes("x.png", b""), "empty"),
    "not an image": (lambda: _bytes("x.png", b"hello"), "x.png"),
    "truncated": (lambda: _bytes("x.png", Path("now.png").read_bytes()[:2000]), "x.png"),
    "all zero": (lambda: _png("x.png", np.zeros(BOX, np.uint16)), "no pixel has a reading"),
    "all NaN": (lambda: _npy("x.npy", np.full(BOX, np.nan)), "no pixel has a reading"),
    "too many NaN": (
        lambda: _npy("x.npy", np.where(np.arange(480) < 240, np.nan, 0.45) * np.ones(BOX)),
        "50.0 %",
    ),
    "out of range": (lambda: _png("x.png", np.full(BOX, 60000, np.uint16)), "0.42 to 0.47"),
    "pickle": (lambda: _npy("x.npy", np.array([{"a": 1}], object)), "x.npy"),
    "missing file": (lambda: "no-such-file.png", "no-such-file.png"),
    "folder": (lambda: "bank", "bank"),
}


def refused(arguments, capsys, words):
    """Exit code 2, one line that says the words, nothing on stdout."""
    try:
        code = main(arguments)
    except SystemExit as exit_:
        code = exit_.code
    out, err = capsys.readouterr()
    assert code == 2 and out == ""
    assert err.count("\n") == 1 and err.startswith("jshape") and "error: " in err
    assert words in err


@pytest.mark.parametrize("case", BAD_IMAGES)
@pytest.mark.parametrize("place", [1, 2])
def test_bad_images_are_refused_and_nothing_is_written(folder, capsys, case, place):
    make, words = BAD_IMAGES[case]
    arguments = [*PLAN, "--out", "out", "--camera", "camera.json"]
    arguments[place] = make()
    refused(arguments, capsys, words)
    assert not (folder / "out").exists()
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


def _edit_json(path, **changes):
    content = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del content[key]
        else:
            content[key] = value
    path.write_text(json.dumps(content))


def _break_checksum(folder):
    path = folder / "bank" / "effects.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def _file_at(path):
    path.write_text("in the way")


BAD_SETTINGS = {
    "camera without fx": (lambda f: _edit_json(f / "camera.json", fx=None), [], "fx"),
    "camera with negative fy": (lambda f: _edit_json(f / "camera.json", fy=-433.0), [], "fy"),
    "camera with text": (lambda f: _edit_json(f / "camera.json", u0="left"), [], "u0"),
    "camera of no JSON": (lambda f: (f / "camera.json").write_text("{"), [], "camera.json"),
    "no such camera": (None, ["--camera", "no-camera"], "no-camera"),
    "camera of another size": (
        lambda f: _edit_json(f / "camera.json", width=470), [], "the camera makes 470x395",
    ),
    "wrong checksum": (_break_checksum, [], "effects.npz"),
    "bank without manifest": (lambda f: (f / "bank" / MANIFEST).unlink(), [], "manifest.json"),
    "no such bank": (None, ["--bank", "no-bank"], "no-bank"),
    "ROI outside": (
        lambda f: (f / "places.json").write_text('{"positions": [[5, 5]]}'), [], "knock at (5, 5)",
    ),
    "positions of no sense": (None, ["--positions", "many"], "COLUMNSxROWS"),
    "no such planner": (None, ["--planner", "magic"], "magic"),
    "out is a file": (lambda f: _file_at(f / "out"), [], "out"),
    "out below a file": (lambda f: _file_at(f / "file"), ["--out", "file/out"], "file"),
    "no stride": (None, ["--stride", "0"], "'0' is not a whole number from 1"),
    "no strength": (None, ["--strengths", "0.5,0"], "'0' is not a positive number"),
    "an empty strength": (None, ["--strengths", "1,,2"], "'' is not a positive number"),
    "no yaw": (None, ["--yaws", "0"], "'0' is not a whole number from 1"),
    "too many yaws": (None, ["--yaws", "65"], "from 1 to 64"),
    "no time": (None, ["--seconds", "0"], "'0' is not a time above 0, such as 5s"),
    "hours": (None, ["--seconds", "1h"], "'1h' is not a time above 0"),
    "no evaluations": (None, ["--evaluations", "0"], "'0' is not a whole number from 1"),
    "negative caution": (None, ["--error-margin", "-1"], "'-1' is not a number from 0"),
    "negative clearance": (None, ["--clearance-mm", "-1"], "'-1' is not a number from 0"),
    "too much clearance": (None, ["--clearance-mm", "900"], "leaves no pixel"),
    "no use": (None, ["--max-uses", "knock"], "'knock' is not an action and a number"),
    "use of nothing": (None, ["--max-uses", "=2"], "'=2' is not an action"),
    "a negative use": (None, ["--max-uses", "knock=-1"], "'knock=-1' is not an action"),
    "use of an unknown action": (None, ["--max-uses", "tap=2"], "'tap'; allowed: knock, poke"),
    "no device": (None, ["--devices", "0"], "'0' is not a number of devices from 1 to 64"),
    "too many devices": (None, ["--devices", "65"], "'65' is not a number of devices"),
    "no such mask": (None, ["--reachable", "no-mask.png"], "no-mask.png"),
    "a mask of nothing": (
        lambda f: _png("mask.png", np.zeros(BOX, np.uint8)), ["--reachable", "mask.png"],
        "mask.png: is 0 everywhere; other numbers mark where the hand may be placed",
    ),
    "a small mask": (
        lambda f: _png("mask.png", np.ones((40, 50), np.uint8)), ["--reachable", "mask.png"],
        "mask.png: has (40, 50) (rows, columns); the camera makes (395, 480)",
    ),
    "a mask with NaN": (
        lambda f: _npy("mask.npy", np.full(BOX, np.nan)), ["--reachable", "mask.npy"],
        "mask.npy: has",
    ),
    "negative steps": (None, ["--max-steps", "-1"], "-1"),
    "no number": (None, ["--min-gain-mm", "much"], "much"),
    "unknown option": (None, ["--fast"], "--fast"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SETTINGS)
def test_bad_settings_are_refused_and_nothing_is_written(folder, capsys, case):
    spoil, options, words = BAD_SETTINGS[case]
    if spoil is not None:
        spoil(folder)
    before = sorted(folder.rglob("*"))
    refused([*PLAN, "--out", "out", *options], capsys, words)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.full
def test_what_is_there_is_not_overwritten_unless_asked(folder, capsys):
    assert main([*PLAN, "--out", "out"]) == 0
    capsys.readouterr()
    stamp = (folder / "out" / "plan.json").stat().st_mtime_ns
    refused([*PLAN, "--out", "out"], capsys, "exists")
    assert (folder / "out" / "plan.json").stat().st_mtime_ns == stamp
    assert main([*PLAN, "--out", "out", "--overwrite"]) == 0
    shutil.copytree("out", "precious")
    (folder / "precious" / "plan.json").unlink()
    capsys.readouterr()
    refused([*PLAN, "--out", "precious", "--overwrite"], capsys, "precious")


def higher(depth, camera):
    """What a camera 0.1 m above the bank's sees of what the bank's saw; beyond the box a table."""
    pose = np.eye(4)
    pose[2, 3] = -0.1
    posed, span = replace(camera, pose=as_frame(pose)), np.array([0.4, 0.7], np.float32)
    seen = np.asarray(reproject(depth, PAPER_BOX, posed, span))
    return np.where(np.isfinite(seen), seen, 0.56)


@pytest.mark.full
def test_another_camera_is_planned_for_in_its_own_pixels(folder, capsys):
    """A 640x480 camera at 0.55 m sees the same two beds; places come back in its own pixels."""
    other = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, 0.3, 1.0)
    for name in ("now", "goal"):
        depth = cv2.imread(f"{name}.png", cv2.IMREAD_UNCHANGED).astype(np.float32) * 1e-5
        cv2.imwrite(f"{name}.png", np.rint(higher(depth, other) / 1e-5).astype(np.uint16))
    write_camera(folder / "camera.json", other, 1e-5)
    assert main([*PLAN, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert sorted(s["action"] for s in result["steps"])[-3:] == ["knock", "knock", "poke"]
    right = _png("right.png", np.where(np.arange(640) < 400, 0, 255) * np.ones((480, 1), np.uint8))
    assert main([*PLAN, "--reachable", right, "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert {tuple(s["position"]) for s in steps} == {(387, 302)}
    poke = [s["action"] for s in result["steps"]].index("poke")
    # The poke at (239, 197) of the box is a pixel left of the axis: (320 - 1, 240) of this camera.
    assert np.abs(np.subtract(result["steps"][poke]["camera_position"], [319, 240])).max() <= 1


@pytest.mark.full
def test_from_simulated_pairs_to_a_plan(tmp_path, capsys, monkeypatch):
    """The whole way: simulate, look, evaluate, train, plan; on two actions to be quick."""
    monkeypatch.chdir(tmp_path)
    simulate = ["dataset", "simulate", "pairs", "--pairs", "4", "--actions", "knock", "poke"]
    assert main([*simulate, "--frames", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs"] == 8
    assert main(["dataset", "info", "pairs"]) == 0
    text = capsys.readouterr().out
    assert "knock" in text and "112x104" in text
    assert main(["evaluate", "pairs", "--json", "--out", "scores"]) == 0
    scores = {s["action"]: s for s in json.loads(capsys.readouterr().out)["scores"]}
    assert scores["knock"]["mean_mm"] < 0.5 * scores["knock"]["change_mm"]
    assert (tmp_path / "scores" / "scores.csv").read_text().startswith("action,agent,count")
    assert main(["train", "pairs", "--out", "bank", "--json"]) == 0
    assert main(["evaluate", "pairs", "--bank", "bank", "--json"]) == 0
    capsys.readouterr()
    rows = (tmp_path / "pairs" / "pairs.csv").read_text().splitlines()
    first = dict(zip(rows[0].split(","), rows[1].split(","), strict=True))
    place = {"positions": [[int(first["u"]), int(first["v"])]]}
    (tmp_path / "place.json").write_text(json.dumps(place))
    frames = [f"pairs/{first[k]}" for k in ("prior", "posterior")]
    options = [
        "--camera",
        "pairs/camera.json",
        "--positions",
        "place.json",
        "--out-of-bounds",
        "shift",
    ]
    assert main(["plan", *frames, "--bank", "bank", *options, "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert steps[0]["action"] == first["action"]
    refused([*simulate[:3], "--actions", "tap"], capsys, "exists")
    refused(["dataset", "simulate", "new", "--actions", "tap"], capsys, "'tap'; allowed: grasp")
    refused(["train", "pairs", "--out", "new", "--kind", "Z"], capsys, "'Z'; allowed: D")
    assert not (tmp_path / "new").exists()


@pytest.mark.full
def test_commands_as_processes(folder):
    """A real process: exit codes, one line on stderr, no traceback, help that is quick to read."""

    def run(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "jshape", *arguments], capture_output=True, text=True
        )

    for arguments in (["--help"], ["plan", "--help"], ["dataset", "simulate", "--help"]):
        done = run(*arguments)
        assert done.returncode == 0 and "Usage: jshape" in done.stdout
        assert "examples:\n  jshape " in done.stdout
    assert run("--version").stdout.strip().count(".") == 2
    assert run().returncode == 2 and run("dataset").returncode == 2
    done = run("plan", "now.png", "no.png", "--bank", "bank")
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1
    done = run(*PLAN, "--json")
    assert done.returncode == 0 and done.stderr == "" and json.loads(done.stdout)


@pytest.mark.full
def test_overwrite_spares_what_no_command_wrote(folder, capsys):
    """Every command that replaces a folder, on one that looks like its own but holds notes."""
    commands = {
        "out": ("plan.json", [*PLAN, "--out"]),
        "bank": (MANIFEST, ["train", "pairs", "--out"]),
        "scores": ("scores.csv", ["evaluate", "pairs", "--out"]),
        "run": ("run.json", ["demo", "--out"]),
        "pairs": ("pairs.csv", ["dataset", "simulate"]),
    }
    for name, (first, arguments) in commands.items():
        (folder / name).mkdir(exist_ok=True)
        (folder / name / first).touch()
        notes = folder / name / "my_notes.txt"
        notes.write_text("years of work")
        before = sorted(folder.rglob("*"))
        refused([*arguments, name, "--overwrite"], capsys, "also holds my_notes.txt")
        assert sorted(folder.rglob("*")) == before and notes.read_text() == "years of work"
        notes.unlink()
    assert main([*PLAN, "--out", "out", "--overwrite"]) == 0
    assert Plan.from_json(folder / "out" / "plan.json").actions


def test_a_black_picture_is_no_goal(folder, capsys):
    arguments = ["plan", "now.png", _png("x.png", np.zeros(BOX, np.uint8)), *PLAN[3:]]
    refused(arguments, capsys, "every pixel is black: nothing within the camera's range")


def test_a_mesh_mostly_out_of_range_is_no_goal(folder, capsys):
    import trimesh

    slab = np.array([[-1, -1, 0.9], [1, -1, 0.9], [1, 1, 0.9], [-1, 1, 0.9]])
    chip = np.array([[-0.02, -0.02, 0.45], [0.02, -0.02, 0.45], [0, 0.02, 0.45]])
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    mesh = trimesh.Trimesh(np.concatenate([slab, chip]), faces, process=False)
    (folder / "goal.ply").write_bytes(bytes(mesh.export(file_type="ply")))
    refused(["plan", "now.png", "goal.ply", *PLAN[3:]], capsys, "goal.ply: 0.3% of the bed is seen")


def test_a_bundled_bank_and_a_folder_of_one_name(folder, capsys):
    shutil.copytree("bank", "pressed-flour-robot")
    options = [*PLAN[:3], *PLAN[5:], "--json"]
    words = "write ./pressed-flour-robot for the folder"
    refused([*options, "--bank", "pressed-flour-robot"], capsys, words)
    refused(options, capsys, words)  # the default is that name
    assert main([*options, "--bank", "./pressed-flour-robot"]) == 0
    assert json.loads(capsys.readouterr().out)["bank"] == "./pressed-flour-robot"


def test_a_wrong_unit_is_not_taken_for_another_height(folder, capsys):
    """A camera that says 0.3 to 1 m does not see a bed at 4.5 m, however it is looked at again."""
    other = Camera(480, 395, 433.0, 433.0, 240.0, 197.0, 0.3, 1.0)
    write_camera(folder / "camera.json", other, 1e-4)
    refused(PLAN, capsys, "depth_unit 1e-05 instead of 0.0001 would fit it")
    assert main([*PLAN, "--depth-unit", "1e-5"]) == 0


def test_an_empty_plan_says_what_to_try(folder, capsys):
    (folder / "places.json").write_text('{"positions": [[240, 60]]}')
    assert main(PLAN) == 0
    assert "no action of the bank helps at these positions" in capsys.readouterr().out


@pytest.mark.full
def test_the_default_grid_finds_actions_off_the_papers_places(folder, capsys, bank):
    now = np.full(PAPER_BOX.shape, 0.5, np.float32)
    goal, (w, h) = now.copy(), bank.roi("knock")
    window = np.s_[200 - h // 2 : 200 - h // 2 + h, 160 - w // 2 : 160 - w // 2 + w]
    goal[window] = bank.predict("knock", goal[window])
    depth = np.asarray(PAPER_BOX.depth(metric.unweigh(goal, PAPER_BOX)))
    cv2.imwrite("goal.png", np.rint(depth / 1e-5).astype(np.uint16))
    assert main([*PLAN[:-2], "--json"]) == 0
    step = json.loads(capsys.readouterr().out)["steps"][0]
    assert step["action"] == "knock" and np.hypot(*np.subtract(step["position"], [160, 200])) < 15


def _put(bank, action, place, strength=1.0, turned=False):
    """goal.png: what one action of the bank makes of a flat bed."""
    predictor = bank.predictor(action)
    predictor = predictor.turned(np.pi / 2) if turned else predictor
    (w, h), (u, v) = predictor.roi, place
    for name in ("now", "goal"):
        image = np.full(PAPER_BOX.shape, 0.5, np.float32)
        top, left = v - h // 2, u - w // 2
        if name == "goal":
            window, corner = np.s_[top : top + h, left : left + w], jnp.array([left, top])
            image[window] = predictor(jnp.asarray(image[window]), corner, strength)
        depth = np.asarray(PAPER_BOX.depth(metric.unweigh(image, PAPER_BOX)))
        _png(f"{name}.png", np.rint(depth / 1e-5).astype(np.uint16))


@pytest.mark.full
def test_strength_and_direction_of_the_hand(folder, capsys, bank):
    """A knock 1.5 times as deep, turned a quarter: as such in the table, the JSON and the files."""
    _put(bank, "knock", (239, 197), 1.5, turned=True)
    hand = ["--strengths", "1,1.5", "--yaws", "2", "--min-gain-mm", "0.02"]
    assert main([*PLAN, *hand, "--out", "out"]) == 0
    text = capsys.readouterr().out
    head, _, step = text.splitlines()[2:5]
    assert head.split()[:7] == ["step", "action", "u", "v", "strength", "yaw", "(°)"]
    assert step.split()[:6] == ["1", "knock", "239", "197", "1.50", "90"]
    assert "(greedy, " in text and " predictions)" in text
    found = Plan.from_json(folder / "out" / "plan.json")
    assert found.actions == ("knock",) and found.rois.tolist() == [[100, 100]]
    np.testing.assert_allclose((found.strengths[0], found.yaws[0]), (1.5, np.pi / 2), rtol=1e-6)
    assert main([*PLAN, *hand, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["planner"] == "greedy" and result["seconds"] > 0
    assert (result["steps"][0]["strength"], result["steps"][0]["yaw"]) == (1.5, found.yaws[0])
    assert main([*PLAN, "--strengths", "1.5"]) == 0
    assert "yaw" not in capsys.readouterr().out  # nothing is turned


@pytest.mark.full
def test_dense_positions_are_tried_with_several_strengths(folder, capsys, bank):
    _put(bank, "knock", (171, 211), 0.25)
    dense = [*PLAN[:5], "--yaws", "1", "--stride", "9", "--json", "--max-steps", "1"]
    assert main(dense) == 0
    (step,) = json.loads(capsys.readouterr().out)["steps"]
    assert step["position"] == [171, 211] and abs(step["strength"] - 0.25) < 0.02


def test_what_the_hand_can_reach(folder, capsys):
    """In the bank's image, and in the whole image of the camera that the bank sees a window of."""
    everywhere = np.ones(BOX, np.uint8)
    everywhere[190:205, 230:250] = 0
    assert main([*PLAN, "--reachable", _png("mask.png", everywhere), "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert sorted(s["position"] for s in steps) == [[91, 92], [387, 302]]
    whole = {}
    for name in ("now", "goal"):
        box = cv2.imread(f"{name}.png", cv2.IMREAD_UNCHANGED)
        whole[name] = np.pad(box, ((46, 39), (181, 187)), mode="edge")
        _png(f"{name}.png", whole[name])
    seen = ["--camera", "d435_bazar", "--depth-unit", "1e-5"]
    mask = np.zeros((480, 848), np.uint8)
    mask[302 + 46, 387 + 181] = 1
    assert main([*PLAN, *seen, "--reachable", _png("mask.png", mask), "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert [s["position"] for s in steps] == [[387, 302]]
    assert main([*PLAN, *seen, "--reachable", _png("mask.png", everywhere), "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert sorted(s["position"] for s in steps) == [[91, 92], [387, 302]]
    assert main([*PLAN, *seen, "--clearance-mm", "150", "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert [s["position"] for s in steps] == [[239, 197]]


@pytest.mark.full
def test_uses_and_budgets(folder, capsys):
    assert main([*PLAN, "--max-uses", "knock=1", "--max-uses", "poke=0", "--json"]) == 0
    assert [s["action"] for s in json.loads(capsys.readouterr().out)["steps"]] == ["knock"]
    assert main([*PLAN, "--evaluations", "1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == "BUDGET" and len(result["steps"]) <= 1
    assert main([*PLAN, "--planner", "careful", "--seconds", "2min", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["planner"] == "careful" and len(result["steps"]) == 3


def fields_of(keywords):
    """All fields of the records among keywords of `plan`, by name."""
    return {
        k: v for name, kind in GROUPS.items() for k, v in vars(keywords.get(name, kind())).items()
    }


def test_every_option_reaches_the_planner(folder, monkeypatch):
    given = {}
    monkeypatch.setattr(
        "jshape.planning.api.plan_views",
        lambda *images, **keywords: given.update(keywords) or 1 / 0,
    )
    expected = {
        "stride": 4, "seconds": 0.5, "evaluations": 70, "error_margin": 0.5, "clearance_mm": 8.0,
        "max_uses": {"poke": 2}, "yaws": 4, "strengths": [0.5, 2.0], "reachable": None,
        "max_steps": 5, "min_gain_mm": 0.1, "tolerance_mm": 0.2, "max_missing": 0.3,
        "out_of_bounds": "drop", "positions": None, "lengths": [1.0, 2.0], "stock_cm3": 50.0,
        "carries": {"dig": "fill"},
    }  # fmt: skip
    options = ["--stride", "4", "--planner", "refine", "--seconds", "500ms", "--evaluations", "70"]
    options += ["--error-margin", "0.5", "--clearance-mm", "8", "--max-uses", "poke=2"]
    options += ["--yaws", "4", "--strengths", "0.5,2", "--max-steps", "5"]
    options += ["--min-gain-mm", "0.1", "--tolerance-mm", "0.2", "--max-missing", "0.3"]
    options += ["--out-of-bounds", "drop", "--devices", "1", "--lengths", "1,2"]
    options += ["--stock-cm3", "50", "--carries", "dig=fill"]
    with pytest.raises(ZeroDivisionError):
        main([*PLAN[:5], *options])
    assert fields_of(given) == expected and given["planner"] == "refine"
    given.clear()
    with pytest.raises(ZeroDivisionError):
        main(PLAN[:5])
    assert fields_of(given) == fields_of({})


@pytest.mark.parametrize(
    "text, seconds", [("5", 5), ("0.5s", 0.5), ("500ms", 0.5), ("2min", 120), ("1e-3", 0.001)]
)
def test_times(text, seconds):
    assert duration(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "s", "ms", "-1s", "0ms", "inf", "nan", "5m", "5 h", "min5"])
def test_what_is_no_time(text):
    with pytest.raises(ValueError, match="is not a time above 0"):
        duration(text)


@pytest.mark.full
def test_devices_are_made_once():
    """In a new process: three of them, then no more, and as few as asked for."""
    code = """
from jshape.planning.devices import over_devices
print(over_devices(3).mesh.size, over_devices(5).mesh.size, over_devices(2).mesh.size)
print(over_devices(1).mesh)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout.split(), done.stderr) == (["3", "3", "2", "None"], "")


@pytest.mark.full
@pytest.mark.parametrize(
    ("words", "loads"),
    [("--help", False), ("--version", False), ("plna", False), ("config --init", False),
     ("demo --help", True)],
)  # fmt: skip
def test_what_needs_no_jax_does_not_load_it(words, loads, tmp_path):
    """Help, a misspelt command and a new configuration file are there at once."""
    code = (
        "import sys\nfrom jshape.cli.main import main\n"
        f"try:\n    main({words.split()!r})\nexcept SystemExit:\n    pass\n"
        "print([n for n in ('jax', 'cv2', 'matplotlib', 'scipy') if n in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path
    )
    assert ("'jax'" in done.stdout.splitlines()[-1]) == loads, done
    assert loads or done.stdout.splitlines()[-1] == "[]"


def test_every_public_name_is_where_it_is_said_to_be():
    import jshape

    assert sorted(jshape.__all__) == sorted(jshape._HOME)
    for name in jshape.__all__:
        value = getattr(jshape, name)
        assert getattr(sys.modules[jshape._HOME[name]], name) is value
    assert set(jshape.__all__) <= set(dir(jshape)) and jshape.metric.weigh is jshape.weigh
    with pytest.raises(AttributeError, match="has no attribute 'plam'"):
        jshape.plam  # noqa: B018


LEAVES = {" ".join(leaf.words): leaf for leaf in leaves(build_app())}


def test_the_table_of_commands_is_true(capsys):
    assert {name.split()[0] for name in LEAVES} == set(COMMANDS)
    assert {row for name in LEAVES for row in of(name)} == set(EXAMPLES), "of no such command"
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out
    for name, what in COMMANDS.items():
        assert f"│ {name} " in listed and what.split()[0] in listed
        assert main([name, "--help"]) == 0
        assert what[:70] in capsys.readouterr().out


@pytest.mark.parametrize("name", LEAVES)
def test_every_command_has_examples_that_parse(name, capsys):
    examples = of(name)
    assert examples, "its help ends with two or three examples: commands/examples.py"
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    for line, what in examples:
        assert f"\n  {line}\n      {what}\n" in text and len(line) < 120
        words = shlex.split(line.partition(" > ")[0])
        assert words[0] == "jshape" and " ".join(words[1:]).startswith(name)
        assert parse(words[1:]).run is LEAVES[name].run


WITHOUT_DATA = [
    "jshape config --init",
    "jshape config",
    "jshape config plan",
    "jshape camera list",
    "jshape setup sim:7 --frames 5",
    "jshape record sim --frames 3 --out simulated",
    "jshape dataset simulate few --pairs 2 --actions knock poke --frames 2",
    "jshape dataset simulate-recording recording --actions poke --count 2",
    "jshape completion fish > ~/.config/fish/completions/jshape.fish",
]


@pytest.mark.full
def test_examples_that_need_no_data_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    known = {line for name in LEAVES for line, _ in of(name)}
    for line in WITHOUT_DATA:
        assert line in known
        assert main(shlex.split(line.partition(" > ")[0])[1:]) == 0, capsys.readouterr().err
    assert {"few", "recording", "simulated"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["plna"], "unknown command 'plna'; allowed: demo, samples, plan"),
        (["plna"], "did you mean plan? (see jshape --help)"),
        (["Train"], "did you mean train?"),
        (["dataset", "anotate", "x"], "did you mean annotate? (see jshape dataset --help)"),
        ([*PLAN, "--plannr", "refine"], "unknown option --plannr; did you mean --planner?"),
        (["plan", "--plannr=refine"], "unknown option --plannr; did you mean --planner?"),
        (
            [*PLAN, "--planner", "refin"],
            "unknown value of --planner 'refin'; allowed: greedy, careful, refine",
        ),
        ([*PLAN, "--planner", "refin"], "did you mean refine?"),
        ([*PLAN, "--out-of-bounds", "shfit"], "did you mean shift?"),
        (
            [*PLAN, "--max-uses", "knok=2"],
            "unknown action 'knok'; allowed: knock, poke; did you mean",
        ),
        ([*PLAN[:3], "--bank", "flour-robt"], "did you mean flour-robot?"),
        ([*PLAN, "--camera", "d435_bazr"], "did you mean d435_bazar?"),
        ([*PLAN, "--camera-file", "realsense"], "neither a camera.json nor a preset"),
        ([*PLAN, "--camera", "none.json"], "none.json: no such file"),
        (
            [*PLAN, "--max-steps", "٣"],
            "--max-steps: '٣': numbers are written with the digits 0 to 9",
        ),
        ([*PLAN, "--seconds", "²s"], "digits 0 to 9"),
        ([*PLAN, "--max-uses", "knock=٣"], "digits 0 to 9"),
        ([*PLAN[:-1], "٣x٣"], "a grid is written COLUMNSxROWS"),
        ([*PLAN[:-1], ""], "--positions: is empty"),
        ([*PLAN, "--out", ""], "--out: is empty"),
        (["plan", "", "goal.png"], "INITIAL: is empty"),
        ([*PLAN, "--strengths", ","], "--strengths: '' is not a positive number"),
        ([*PLAN, "--tolerance-mm", "1e999"], "'1e999' is not a number from 0"),
        ([*PLAN, "--min-gain-mm", "nan"], "'nan' is not a number from 0"),
        ([*PLAN, "--planner", "x" * 999], "xxx...xxx"),
        ([*PLAN, "--max-steps", "\x1b[2J"], "'\\x1b[2J' is not a whole number"),
        (["demo", "--material", "flower"], "did you mean flour?"),
        (["demo", "--agent", "robbot"], "did you mean robot?"),
        (["record", "realsens", "--out", "x"], "did you mean realsense?"),
        (["train", "x", "--out", "y", "--morphology", "erod"], "did you mean erode?"),
    ],
)
def test_misspelt_names_are_guessed_and_values_quoted(folder, capsys, words, said):
    refused(words, capsys, said)


def test_a_misspelt_arm_is_guessed(folder, capsys):
    words = ["mold", "goal.npy", "--out", "run", "--yes", "--bank", "bank", "--arm", "mujoko:3"]
    np.save("goal.npy", np.full(BOX, 0.45, np.float32))
    write_camera(folder / "camera.json", PAPER_BOX, 1e-5)
    refused(words, capsys, "did you mean mujoco?")


@pytest.mark.parametrize("name", ["zebra", "", "12", None])
def test_what_is_near_to_nothing_is_not_guessed(name):
    said = str(UnknownName("bank", name, ("flour-robot", "sand")))
    assert said == f"unknown bank {name!r}; allowed: flour-robot, sand"
    assert str(UnknownName("bank", "FLOUR-ROBOT", iter(["flour-robot"]))).endswith("flour-robot?")


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "environment", "expected"),
    [
        (Terminal(), {}, True),
        (Terminal(), {"NO_COLOR": "1"}, False),
        (Terminal(), {"NO_COLOR": ""}, True),  # no-color.org: only what is not empty counts
        (Terminal(), {"TERM": "dumb"}, False),
        (io.StringIO(), {}, False),
        (None, {}, False),
    ],
)
def test_colours_are_for_terminals(monkeypatch, stream, environment, expected):
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert shows_colours(stream) is expected
    if stream is not None:
        plain = coloured("error:", "error", stream)
        assert plain == ("\033[1;31merror:\033[0m" if expected else "error:")


@pytest.mark.full
def test_colours_on_a_real_terminal(folder, tmp_path):
    """In a pseudo-terminal the head of a table is bold and an error red; elsewhere nothing is."""
    pty = pytest.importorskip("pty")

    def run(words, **more):
        off = "NO_COLOR", "JSHAPE_CONFIG"
        usual = {name: value for name, value in os.environ.items() if name not in off}
        environment = usual | {"TERM": "xterm", "PYTHONPATH": str(ROOT)} | more
        main_end, its_end = pty.openpty()
        with subprocess.Popen(
            [sys.executable, "-m", "jshape", *words], stdout=its_end, stderr=its_end,
            env=environment,
        ) as process:  # fmt: skip
            os.close(its_end)
            text = b""
            with contextlib.suppress(OSError):  # the end, on Linux
                while part := os.read(main_end, 4096):
                    text += part
            process.wait(timeout=120)
        os.close(main_end)
        return text.decode()

    assert "\033[1;31merror:\033[0m unknown command 'plna'" in run(["plna"])
    assert "\033[" not in run(["plna"], NO_COLOR="1")
    (folder / "jshape.toml").write_text('bank = "bank"\n')
    assert "\033[1moption" in run(["config"]) and "\033[1m" in run(["plan", "--help"])
    assert "\033[" not in run(["plan", "--help"], NO_COLOR="1")


@pytest.mark.full
@pytest.mark.parametrize(
    ("closed", "environment", "said", "code"),
    [
        (">&-", {}, "jshape: error: stdout is closed: there is nowhere to print", 2),
        ("<&-", {}, "", 0),
        ("2>&-", {}, "", 0),
        ("", {"JAX_ENABLE_X64": "maybe"}, "invalid truth value 'maybe'", 2),
        (
            "",
            {"JAX_PLATFORMS": "tpux"},
            "JAX cannot use JAX_PLATFORMS='tpux' of the environment",
            2,
        ),
        ("", {"HOME": "/nowhere", "TERM": "dumb", "LC_ALL": "C", "MPLBACKEND": "none"}, "", 0),
    ],
)
def test_surroundings_that_a_process_may_have(tmp_path, closed, environment, said, code):
    (tmp_path / "matplotlibrc").write_bytes(b"image.origin: lower\n\xff")  # matplotlib stops at it
    (tmp_path / "now.png").write_bytes(b"")
    run = ["camera", "list"] if code == 0 else ["plan", "now.png", "now.png"]
    process = subprocess.run(
        ["sh", "-c", f'exec "$0" "$@" {closed}', sys.executable, "-m", "jshape", *run],
        cwd=tmp_path, text=True, capture_output=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
    )  # fmt: skip
    assert process.returncode == code and said in process.stderr
    assert process.stderr.count("\n") == (code > 0)


@pytest.mark.full
def test_a_goal_of_another_folder_is_read_with_its_own_camera(folder, capsys):
    """Its unit is its own; through another lens it is looked at again."""
    (folder / "other").mkdir()
    goal = cv2.imread("goal.png", cv2.IMREAD_UNCHANGED)
    cv2.imwrite("other/goal.png", np.rint(goal / 5.0).astype(np.uint16))
    write_camera("other/camera.json", PAPER_BOX, 5e-5)
    elsewhere = ["plan", "now.png", "other/goal.png", "--bank", "bank",
                 "--positions", "places.json"]  # fmt: skip
    assert main([*PLAN, "--json"]) == 0
    ours = json.loads(capsys.readouterr().out)
    for more in ([], ["--camera", "camera.json"], ["--depth-unit", "1e-5"]):
        assert main([*elsewhere, *more, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["goal_source"] == "other/camera.json"
        assert [s["action"] for s in found["steps"]] == [s["action"] for s in ours["steps"]]
        np.testing.assert_allclose(found["distances_mm"], ours["distances_mm"], atol=0.03)

    other = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, 0.3, 1.0)
    seen = higher(goal * np.float32(1e-5), other)
    cv2.imwrite("other/goal.png", np.rint(seen / 5e-5).astype(np.uint16))
    write_camera("other/camera.json", other, 5e-5)
    assert main([*elsewhere, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [s["action"] for s in found["steps"]].count("knock") >= 2
    # Both beds' planes are taken to be the same one: 0.2 mm of what the actions move is.
    assert found["distances_mm"][0] == pytest.approx(ours["distances_mm"][0], abs=0.3)


KINECT = Camera(640, 576, 504.0, 504.0, 320.0, 288.0, 0.3, 1.2, bits=16)


def on_a_table(folder):
    """A bed of 251x209 pixels, 30 mm above the table that fills the rest of the view."""
    v, u = np.mgrid[0:576, 0:640]
    now = np.full((576, 640), 630.0)
    bed = (np.abs(u - 320) < 126) & (np.abs(v - 288) < 105)
    now[bed] = 600 + 2 * np.sin(u[bed] / 21)
    goal = now + 9 * ((np.abs(u - 320) < 60) & (np.abs(v - 288) < 18))
    for name, depth in (("now", now), ("goal", goal)):
        cv2.imwrite(f"{name}.png", depth.astype(np.uint16))
    write_camera(folder / "camera.json", KINECT, 1e-3)


@pytest.mark.full
def test_a_bed_smaller_than_the_view_is_found_and_planned_on(folder, capsys):
    """By itself, in the map's pixels and the camera's own; a window says so where it is known."""
    on_a_table(folder)
    assert main(["setup", "now.png"]) == 0
    assert "\ngood enough\n" in capsys.readouterr().out
    quick = ["--positions", "5x5", "--max-steps", "2", "--json"]
    for part in ([], ["--window", "197,186,247x205"], ["--depth-range", "0.58,0.62"]):
        assert main(["plan", "now.png", "goal.png", *part, *quick]) == 0
        found = json.loads(capsys.readouterr().out)
        # 9 mm over 119 x 35 of the bed's pixels.
        expected = 9 * 119 * 35 / (247 * 205)
        assert found["distances_mm"][0] == pytest.approx(expected, rel=0.06)
        assert found["steps"]
        for step in found["steps"]:
            assert np.abs(np.subtract(step["camera_position"], [320, 288])).max() < 126
    window = ["--window", "300,300,90x90"]
    refused(["plan", "now.png", "goal.png", *window], capsys, "mm of bed are seen; grasp changes")
    window = ["--window", "600,500,90x90"]
    refused(["plan", "now.png", "goal.png", *window], capsys, "leaves the 640x576 image")
    window = ["--window", "197,186,9x9"]
    said = "pixels have a reading; a plane needs 100"
    refused(["plan", "now.png", "goal.png", *window], capsys, said)
    empty = ["--depth-range", "0.7,0.8"]
    refused(["plan", "now.png", "goal.png", *empty], capsys, "no reading lies within the --window")
    # A bank of images sees 50 mm of depth: not the table too.
    images = ["plan", "now.png", "goal.png", "--bank", "bank"]
    refused(images, capsys, "--window or --depth-range says which part")
    assert main([*images, "--window", "197,186,247x205", "--positions", "places.json"]) == 0


@pytest.mark.full
def test_a_goal_for_a_window_is_planned_for_with_what_it_prints(folder, capsys):
    on_a_table(folder)
    words = ["goal", "now.png", "--window", "197,186,247x205", "--text", "O", "--out", "mine"]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["level_m"] == pytest.approx(0.600, abs=2e-3)
    plan = said["next"].split()[1:4]
    quick = ["--positions", "3x3", "--max-steps", "1", "--json"]
    assert main([*plan, *quick]) == 0
    one = json.loads(capsys.readouterr().out)["distances_mm"][0]
    # The same from the whole frame: the goal's folder says that it is the window.
    assert main(["plan", "now.png", plan[2], "--window", "197,186,247x205", *quick]) == 0
    # Of a bed among what does not count two pixels are left out at each edge: 4 % of it.
    assert json.loads(capsys.readouterr().out)["distances_mm"][0] == pytest.approx(one, rel=0.05)
    # The whole frame is cut to the bed's window; one of another lens is not taken for it.
    refused(["goal", "mine/now.png", "--frame", "now.png"], capsys, "nothing of it would change")
    (folder / "other").mkdir()
    shutil.copy("now.png", "other")
    write_camera("other/camera.json", replace(KINECT, fx=615.0), 1e-3)
    refused(["goal", "now.png", "--frame", "other/now.png"], capsys, "fx 615 (bed: 504)")


@pytest.mark.full
def test_a_heap_taller_than_the_banks_range_is_planned_on(folder, capsys):
    """83 mm of relief, of which the bank's camera sees 50: on a height map, with no option."""
    v, u = np.mgrid[0:395, 0:480]
    heap = 4500 - 900 * np.exp(-((u - 240) ** 2 + (v - 197) ** 2) / 7000.0)
    for name, depth in (("now", heap), ("goal", np.maximum(heap, 3900))):
        cv2.imwrite(f"{name}.png", depth.astype(np.uint16))
    write_camera(folder / "camera.json", replace(PAPER_BOX, z_min=0.3, z_max=0.6), 1e-4)
    quick = ["--positions", "5x5", "--max-steps", "1", "--json"]
    assert main(["plan", "now.png", "goal.png", *quick]) == 0
    found = json.loads(capsys.readouterr().out)
    # Seen from straight above the heap's top is not larger, as it is to the camera: by its depth.
    part = (np.minimum(heap, 3900) / 4500) ** 2
    gone = (np.abs(np.maximum(heap, 3900) - heap) * part).mean() / 10
    assert found["distances_mm"][0] == pytest.approx(gone, rel=0.1)
    assert np.abs(np.subtract(found["steps"][0]["camera_position"], [240, 197])).max() < 60


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"z_min": 420, "z_max": 470}, "z_min is 420; it is in metres, at most 50 (in milli"),
        ({"z_min": 420, "z_max": 470}, "it would be 0.42 m)"),
        ({"z_min": 0.5, "z_max": 0.6}, "z_min and z_max of camera.json must say so"),
    ],
)
def test_advice_on_a_range_that_cannot_be_is_of_use(folder, capsys, fields, said):
    """Metres are meant."""
    _edit_json(folder / "camera.json", **fields)
    refused(PLAN, capsys, said)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda name: os.symlink("gone", name)])
def test_a_camera_json_that_is_no_file_is_not_passed_over(folder, capsys, make):
    (folder / "camera.json").rename("mine.json")
    make("camera.json")
    refused(PLAN, capsys, "camera.json: is ")
    (folder / "other").mkdir()
    shutil.copy("goal.png", "other")
    make("other/camera.json")
    goal = ["plan", "now.png", "other/goal.png", "--camera", "mine.json", *PLAN[3:]]
    refused(goal, capsys, "other/camera.json: is ")


def test_a_tilted_camera_is_levelled(folder, capsys):
    v, u = np.mgrid[0:395, 0:480]
    z = (0.445 / (1 + np.tan(np.radians(8.0)) * (u - 240) / 433.0) / 1e-5).astype(np.uint16)
    for name in ("now", "goal"):
        cv2.imwrite(f"{name}.png", z)
    assert main([*PLAN, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    turn = np.array(found["camera"]["pose"])[:3, :3]
    assert np.degrees(np.arccos(turn[2, 2])) == pytest.approx(8.0, abs=0.05)
    assert found["distances_mm"] == [0.0] and found["status"] == "CONVERGED"
