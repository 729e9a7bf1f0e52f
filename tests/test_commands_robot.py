"""`jshape mold` and `jshape execute` at the command line, with the simulated arm."""

import io
import json
import signal
import subprocess
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jshape import load_bank, metric, sim
from jshape.camera import PAPER_BOX
from jshape.cli.main import main
from jshape.cli.mold import MoldOptions, goal_of, keep_on, restored
from jshape.cli.parser import parse
from jshape.data.view import image_of_depth, view_above
from jshape.errors import BadCamera, BadFile
from jshape.height_map import ABOVE
from jshape.io.cameras import camera_from, write_camera
from jshape.io.images import write_depth_png
from jshape.robot.arms.names import open_arm
from jshape.robot.robot import Robot
from jshape.robot.simulated import SimulatedWorld, bed_of
from tests.conftest import ROOT
from tests.seen_beds import seen_by, standing

QUICK = ["--bank", "flour-robot", "--frames", "3"]
TRIED = ["--stride", "24", "--strengths", "1", "--yaws", "1", "--max-steps", "1"]


@pytest.fixture(scope="module")
def goal(tmp_path_factory):
    """The bed of `sim:3` after a knock."""
    folder = tmp_path_factory.mktemp("goal")
    world = SimulatedWorld(jax.random.key(5), bed_of(3)[0])
    world.act("knock", (230, 200))
    np.save(folder / "goal.npy", np.asarray(world.look(), np.float32))
    write_camera(folder / "camera.json", PAPER_BOX, 0.0001)
    return folder / "goal.npy"


@pytest.mark.full
def test_the_bed_is_molded_and_the_run_says_how(goal, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["mold", str(goal), "--arm", "sim:3", "--yes", "--out", str(out), *QUICK, *TRIED,
                 "--json"]) == 0  # fmt: skip
    summary = json.loads(capsys.readouterr().out)
    assert summary == json.loads((out / "summary.json").read_text())
    assert [step["action"] for step in summary["steps"]] == ["knock"]
    assert summary["obtained_mm"] < 0.7 * summary["before_mm"]
    u, v = summary["steps"][0]["position"]
    assert abs(u - 230) <= 4 and abs(v - 200) <= 4
    contact = summary["steps"][0]["operations"][2]
    assert contact["operation"] == "contact" and contact["contact"]
    written = {"goal.npy", "log.jsonl", "plan.json", "result.png", "run.json", "start.png"}
    assert written | {"steps.png", "summary.json"} <= {p.name for p in out.iterdir()}

    again = ["mold", "--resume", "--arm", "sim:3", "--yes", "--out", str(out), *QUICK]
    assert main(again) == 2
    found = capsys.readouterr()
    assert "all 1 actions of the run are done; a larger --max-steps goes on" in found.err
    assert "going on with: --stride 24 --strengths 1.0 --yaws 1 --max-steps 1\n" in found.out
    assert main([*again, "--arm", "sim:4"]) == 2
    assert "was begun with the arm sim:3, not sim:4" in capsys.readouterr().err
    assert main([*again, "--max-steps", "2"]) == 0  # the bed of this process is untouched
    assert len((out / "steps.jsonl").read_text().splitlines()) == 2


def test_a_run_goes_on_as_it_began(tmp_path):
    """The command line beats the run, the run beats defaults; older runs say nothing."""

    def kept(known, *words):
        options = parse(["mold", "--out", str(tmp_path), *words]).options
        with redirect_stdout(io.StringIO()) as said:
            return keep_on(known, options), said

    began = {
        "max_steps": 2, "min_gain_mm": 0.2, "tolerance_mm": 0.0, "strengths": [0.5, 1],
        "seconds": None,
    }  # fmt: skip
    options, said = kept(began, "--max-steps", "16")
    assert (options.max_steps, options.min_gain_mm, options.strengths) == (16, 0.2, [0.5, 1.0])
    assert said.getvalue() == "going on with: --strengths 0.5,1.0 --min-gain-mm 0.2\n"
    assert options.seconds is None
    assert kept(began)[0].max_steps == 2
    options, said = kept({"planner": "greedy"})
    assert (options.max_steps, options.min_gain_mm, said.getvalue()) == (16, None, "")
    with pytest.raises(BadFile, match="the run's max-steps: 'two' is not a whole number from 0"):
        kept({"max_steps": "two"})


@pytest.mark.full
def test_a_plan_is_carried_out(goal, tmp_path, capsys):
    start = tmp_path / "start.npy"
    np.save(start, np.asarray(SimulatedWorld(jax.random.key(5), bed_of(3)[0]).look(), np.float32))
    write_camera(tmp_path / "camera.json", PAPER_BOX, 0.0001)
    assert main(["plan", str(start), str(goal), "--bank", "flour-robot", "--stride", "24",
                 "--strengths", "1", "--yaws", "1", "--max-steps", "1",
                 "--out", str(tmp_path / "plan")]) == 0  # fmt: skip
    plan = str(tmp_path / "plan" / "plan.json")
    out = ["--out", str(tmp_path / "run"), "--yes", *QUICK]
    assert main(["execute", plan, "--arm", "sim:3", *out]) == 0
    said = capsys.readouterr().out
    assert "stopped: the plan is at its end" in said and "knock" in said
    dry = ["--out", str(tmp_path / "dry"), "--yes", *QUICK]
    assert main(["execute", plan, "--arm", "dry", "--camera", str(start), *dry]) == 0
    said = capsys.readouterr().out
    assert "knock x1.00: contact" in said and "tool to (" in said and "  home" in said


def test_where_the_hand_may_go_lies_on_the_bed_as_it_is(goal, tmp_path, monkeypatch):
    """A rectangle in metres of the arm's base, which stands below the camera's image, z up."""
    given, corners = {}, [[0.512, -0.1], [0.612, -0.1], [0.612, 0.06], [0.512, 0.06]]
    (tmp_path / "area.json").write_text(json.dumps({"frame": "base", "polygon_m": corners}))
    (tmp_path / "jshape.toml").write_text('reachable = "area.json"')
    monkeypatch.setattr("jshape.cli.mold.molded", lambda *_, **words: given.update(words) or 1 / 0)
    words = ["mold", str(goal), "--arm", "sim:3", "--yes", "--out", str(tmp_path / "run"), *QUICK]
    with pytest.raises(ZeroDivisionError):
        main([*words, "--config", str(tmp_path / "jshape.toml")])
    depth = np.asarray(sim.render(bed_of(3)[0], PAPER_BOX))
    x, y = PAPER_BOX.rays(depth)
    off = np.maximum(np.abs(x - 0.02) - 0.08, np.abs(y - 0.03) - 0.05)  # from its edge
    wrong = given["constraints"].reachable != (off < 0)
    assert np.ptp(depth) > 0.01 and np.abs(off[wrong]).max(initial=0.0) < 5e-4


def test_an_area_that_is_refused_leaves_no_folder(goal, tmp_path, capsys):
    """Also where the arm had to go home and look before it could be judged; it is said once."""
    words = ["mold", str(goal), "--arm", "sim:3", "--yes", "--out", str(tmp_path / "run"), *QUICK]
    for corners, said in (
        ([[0, 0], [1, 1]], "polygon_m has 2 corners; an area has 3 or more"),
        ([[0.1, 0], [0.2, 0], [0.2, 0.1]], "the polygon x 0.100 to 0.200, y 0.000 to 0.100 m"),
    ):
        (tmp_path / "area.json").write_text(json.dumps({"frame": "base", "polygon_m": corners}))
        assert main([*words, "--reachable", str(tmp_path / "area.json")]) == 2
        assert capsys.readouterr().err.count(said) == 1
        assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--arm", "dry", "--yes"], "the arm dry brings no camera; name one with --camera"),
        (["--arm", "kuka", "--yes"], "'kuka' is not an arm; allowed: dry, sim[:SEED], mujoco"),
        (["--arm", "sim:x", "--yes"], "a seed is a whole number"),
        (["--arm", "sim"], "nobody can be asked here; --yes acts without asking"),
        (["--arm", "sim", "--yes", "--hand", "nowhere"], "nowhere: no such folder"),
        (["--arm", "sim", "--yes", "--base", "nowhere.json"], "nowhere.json"),
        (["--arm", "sim", "--yes", "--camera", "nowhere"], "nowhere: is not a camera; allowed:"),
        (["--arm", "sim", "--yes", "--resume"], "give either the image DESIRED, or --resume"),
        (["--arm", "sim", "--yes", "--camera", "GOAL"], "nothing says where"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(goal, tmp_path, capsys, options, said):
    options = [str(goal) if option == "GOAL" else option for option in options]
    command = ["mold", str(goal), "--out", str(tmp_path / "run"), *QUICK, *options]
    assert main(command) == 2
    error = capsys.readouterr().err.splitlines()
    assert said in error[-1] and error[-1].startswith("jshape: error: ")
    assert not (tmp_path / "run").exists()


def test_every_arm_by_name_acts(capsys):
    from jshape.robot.arms.base import Arm, ArmSettings

    for name in ("dry", "sim:1"):
        assert isinstance(open_arm(name, ArmSettings(PAPER_BOX)).arm, Arm)


HUNG = """
import sys, threading
from jshape.cli.main import main
from jshape.robot.arms.simulated import SimulatedArm

def hang(*given, **named):
    print("hangs", file=sys.stderr, flush=True)
    threading.Event().wait()

SimulatedArm.slowness = 1.0
for name in {hangs}:
    setattr(SimulatedArm, name, hang)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.full
def test_an_arm_that_hangs_in_everything_does_not_keep_the_program(goal, tmp_path):
    """Its way home, `stop` and `close`; SIGTERM twice, the second while it is being stopped."""
    out = tmp_path / "run two"
    words = ["mold", str(goal), "--arm", "sim:3", "--yes", "--out", str(out), *QUICK, *TRIED]
    code = HUNG.format(hangs=["home", "stop", "close"])
    program = subprocess.Popen(
        [sys.executable, "-c", code, *words], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        assert "hangs" in program.stderr.readline()
        program.send_signal(signal.SIGTERM)
        assert "hangs" in program.stderr.readline()  # it is told to stop, and does not answer
        program.send_signal(signal.SIGTERM)
        said = program.communicate(timeout=60)[1]
    finally:
        program.kill()
    assert program.returncode == 130
    assert "interrupted; the arm was told to stop" in said
    assert "simulated arm: did not stop: no answer for 2 s" in said
    assert f"jshape mold --bank flour-robot --arm sim:3 --resume --out '{out}' goes on" in said
    assert "simulated arm: close has not ended after 5 s" in said
    assert json.loads((out / "summary.json").read_text())["state"] == "interrupted"


def blank_robot(eye, bank):
    """A robot without an arm, which nobody asks to look or act."""
    robot = Robot.__new__(Robot)
    robot.depth_camera, robot.view, robot.camera, robot._eyes = eye, None, bank.camera, [eye]
    return robot


def nobody():
    raise AssertionError("the robot was asked to look")


def goal_for(tmp_path, camera, bank, **more):
    """What `jshape mold` takes for a goal whose whole middle is dug 6 mm, and the bed before."""
    now = np.full(camera.shape, 0.55, np.float32)
    h, w = camera.shape
    wanted = now.copy()
    wanted[h // 5 : h - h // 5, w // 5 : w - w // 5] += 0.006
    write_depth_png(tmp_path / "wanted.png", wanted, 1e-4)
    eye = SimpleNamespace(camera=camera, depth_unit=1e-4, name="it")
    robot = blank_robot(eye, bank)
    given = {"camera_file": None, "depth_unit": None, "window": None,
             "depth_range": None, "max_missing": 0.1} | more  # fmt: skip
    options = MoldOptions(out=tmp_path, **given)
    with redirect_stdout(io.StringIO()) as said:
        found = goal_of(tmp_path / "wanted.png", robot, bank, options, nobody)
    return now, robot, said.getvalue().splitlines(), *found


def test_a_goal_of_the_robots_own_camera_is_seen_as_the_bed_is(tmp_path, bank):
    """From the same place above it: a dug middle is not taken for raised surroundings."""
    camera = replace(PAPER_BOX, fx=350.0, fy=350.0, z_min=0.3, z_max=1.0)
    now, robot, _, goal, seen_by, known = goal_for(tmp_path, camera, bank)
    assert camera_from(known["view"], "it") == robot.view.target == seen_by.camera
    # The plane is where most of the bed lies, its rim, which is brought to 0.445 m.
    assert robot.view.to_source[2, 3] == pytest.approx(0.55 - 0.445, abs=1e-4)
    before = image_of_depth(now, PAPER_BOX, view=robot.view).image
    dug = float(metric.to_mm(metric.distance(before, goal), PAPER_BOX))
    assert 4.8 < dug < 6  # 6 mm over 84 % of the bank's view, along slanted rays
    assert (before - goal).max() > 0.06 and (goal - before).max() < 0.01  # nothing is raised
    again = blank_robot(robot.depth_camera, bank)
    restored(known, again, bank)
    np.testing.assert_array_equal(image_of_depth(now, PAPER_BOX, view=again.view).image, before)
    for spoiled in (3, {"width": 480}):
        with pytest.raises((BadFile, BadCamera), match="the run's view"):
            restored({"view": spoiled}, again, bank)


def test_a_bank_in_metres_molds_on_a_height_map_of_the_bed(tmp_path):
    """One pixel of the robot's camera is one of the map, and effects keep their size in metres."""
    camera = replace(PAPER_BOX, fx=350.0, fy=350.0, z_min=0.3, z_max=1.0)
    given = load_bank("pressed-flour-robot")
    now, robot, _, goal, bank, known = goal_for(tmp_path, camera, given)
    assert bank.camera.orthographic and goal.shape == bank.camera.shape
    assert np.abs(np.subtract(goal.shape, camera.shape)).max() < 15
    assert robot.camera == bank.camera == camera_from(known["view"], "it")
    assert float(bank.camera.fx) == pytest.approx(350 / 0.55, rel=1e-3)
    trained = float(given.predictor("knock").grid.depth)
    smaller = given.roi("knock")[0] * 350 / 433 * trained / 0.55
    assert bank.roi("knock")[0] == pytest.approx(smaller, abs=1)  # whole pixels
    seen = image_of_depth(now, bank.camera, view=robot.view)
    depth = np.asarray(bank.camera.depth(metric.unweigh(seen.image, bank.camera)))
    assert np.median(depth[seen.known]) == pytest.approx(ABOVE, abs=2e-4)


def test_a_goal_beside_its_own_camera_is_read_with_it(tmp_path, bank):
    other = replace(PAPER_BOX, fx=615.0, z_min=0.3, z_max=1.0)
    write_camera(tmp_path / "camera.json", other, 1e-4)
    with pytest.raises(BadCamera, match=r"wanted.png: of another .*fx 615 \(its: 433\).*a pose"):
        goal_for(tmp_path, PAPER_BOX, bank)


@pytest.mark.parametrize("posed", [True, False])
def test_a_goal_from_above_lies_on_the_plane_of_the_first_look(tmp_path, posed):
    """As `jshape goal` writes it of a tilted bed, or somebody's map without a pose."""
    camera = replace(standing(30), pose=None)
    depth = np.where(seen_by(standing(30)) > 0, seen_by(standing(30)), np.nan)
    made = view_above(camera, depth)
    wanted = made.depth(depth, "bed")
    wanted[40:60, 50:80] += 0.006
    np.save(tmp_path / "goal.npy", wanted)
    target = made.target if posed else replace(made.target, pose=None)
    write_camera(tmp_path / "camera.json", target, 1e-4)
    eye = SimpleNamespace(camera=camera, depth_unit=1e-4, name="it")
    given, options = load_bank("pressed-flour-robot"), MoldOptions(out=tmp_path)
    robot = blank_robot(eye, given)
    with redirect_stdout(io.StringIO()):
        goal, bank, known = goal_of(
            tmp_path / "goal.npy", robot, given, options, lambda: np.nan_to_num(depth)
        )
    assert camera_from(known["view"], "it") == robot.view.target == bank.camera
    np.testing.assert_allclose(robot.view.target.pose, made.target.pose, atol=1e-6)
    np.testing.assert_array_equal(np.isnan(goal), np.isnan(wanted))
    again = robot.view.depth(depth, "the look")
    change = np.asarray(bank.camera.depth(metric.unweigh(np.nan_to_num(goal), bank.camera))) - again
    assert np.nanmedian(change[42:58, 52:78]) == pytest.approx(0.006, abs=1e-4)
    assert np.abs(np.nanmedian(change)) < 1e-5


def test_cameras_and_their_files_go_in_pairs(goal, tmp_path, capsys):
    files = [tmp_path / "left.json", tmp_path / "right.json"]
    for file, tilt in zip(files, (-30, 30), strict=True):
        write_camera(file, standing(tilt), 1e-4)
    words = ["mold", str(goal), "--out", str(tmp_path / "run"), "--yes", *QUICK]
    two = ["--camera", "sim", "--camera", "sim"]
    assert main([*words, *two, "--camera-file", str(files[0])]) == 2
    assert "2 cameras and 1 camera files; give one --camera-file for" in capsys.readouterr().err
    write_camera(files[1], replace(standing(30), pose=None), 1e-4)
    assert (
        main([*words, *two, *("--camera-file", str(files[0]), "--camera-file", str(files[1]))]) == 2
    )
    said = capsys.readouterr().err
    assert "right.json: has no pose; several cameras need one each, in one frame" in said
    assert main([*words, "--arm", "mujoco", "--camera-file", str(files[0])]) == 2
    assert "sees through the camera on its wrist" in capsys.readouterr().err
