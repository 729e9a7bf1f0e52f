"""Beds that the project did not make: an independent simulation, real sand, raw camera frames.

Everything here skips where the shared data are absent.
"""

import json

import numpy as np
import pytest

from benchmarks.experiments.shapes import depth_of_relief
from jshape import PAPER_BOX, fit, load_bank, load_pairs, plan_depth
from jshape.cli.main import main
from jshape.io.images import read_depth
from jshape.learn.evaluate import cross_validate
from tests.conftest import paper

SEQUENCES = {
    "dev1_flour_flat": "flat_flour_robot",
    "dev2_sand_irregular": "irregular_sand_human",
    "dev3_sand_irregular": "irregular_sand_human",
    "dev4_flour_irregular": "irregular_flour_robot",
}


@pytest.mark.full
@pytest.mark.parametrize("bundled", [False, True], ids=["fitted", "bundled"])
@pytest.mark.parametrize("noise", ["", "_noisy"])
@pytest.mark.parametrize("name", SEQUENCES)
def test_the_applied_actions_are_found(shared_data, name, noise, bundled):
    """Type and place of every applied action, from the first and the last frame alone.

    With a bank fitted to the same engine's pairs, and with the bundled one, which was fitted to
    the project's own simulator.
    """
    folder = shared_data / "mpm" / f"seqs{noise}" / name
    sequence = json.loads((folder / "sequence.json").read_text())
    pairs = shared_data / "mpm" / f"pairs{noise}" / SEQUENCES[name]
    bank = load_bank("flour-robot") if bundled else fit(load_pairs(pairs))
    first, last = (
        read_depth(folder / f"{k}.png", depth_unit=1e-4) for k in (0, len(sequence["applied"]))
    )
    found = plan_depth(
        first, last, bank=bank, **paper(positions=sequence["positions"], out_of_bounds="drop")
    )
    applied = {(a["action"], *a["position"]) for a in sequence["applied"]}
    planned = list(zip(found.actions, *found.positions.T.tolist(), strict=True))
    assert applied <= set(planned)
    assert (np.diff(found.distances) < 0).all()
    # What is planned besides is small change: a poke more where one went deeper than usual.
    extra = [k for k, step in enumerate(planned) if step not in applied]
    gains = -np.diff(found.distances_mm)
    assert len(extra) <= 1 and all(gains[k] < 0.05 for k in extra)


@pytest.mark.full
def test_errors_of_the_mean_difference_are_those_known(shared_data):
    """The data's own README: leave-one-out f_D errors of 0.8-1.3 mm (flat), 1.3-3.1 (irregular)."""
    flat = cross_validate(load_pairs(shared_data / "mpm" / "pairs" / "flat_flour_robot"))
    rough = cross_validate(load_pairs(shared_data / "mpm" / "pairs" / "irregular_flour_robot"))
    assert 0.5 < np.mean([s.mean_mm for s in flat]) < 1.4
    assert 1.2 < np.mean([s.mean_mm for s in rough]) < 3.1


@pytest.mark.full
def test_real_sand_gets_a_plan_that_helps(shared_data):
    """A real sandbox before and after reshaping by hand, shrunk into the paper's box."""
    before, after = (
        np.load(shared_data / "real" / "sand" / f"{k}.npz", allow_pickle=False)["arr_0"]
        for k in (1, 2)
    )
    depths = [depth_of_relief(r, PAPER_BOX, scale=0.2e-3, middle=0.447) for r in (before, after)]
    found = plan_depth(*depths, **paper(positions="21x15"))
    assert found.actions[0] == "knock" and found.distances[-1] < 0.85 * found.distances[0]
    # Somebody dug to the right of the middle; the first knock falls there.
    dug = np.argwhere(depths[1] - depths[0] > 0.01)
    v, u = np.median(dug, axis=0)
    assert np.hypot(*(found.positions[0] - (u, v))) < 30


@pytest.mark.full
def test_raw_frames_of_other_cameras_are_planned_on(shared_data, tmp_path, capsys):
    """A Kinect's and a RealSense's raw frames, which looks at a bin at 34 degrees; once their
    camera is known."""
    folder = shared_data / "real"
    kinect = folder / "sand" / "kinect_v2_raw.npy"
    bin_ = folder / "realsense_sr300"
    intrinsics = np.loadtxt(bin_ / "camera-0.intrinsics.txt")
    camera = dict(
        width=640, height=480, fx=intrinsics[0, 0], fy=intrinsics[1, 1], u0=intrinsics[0, 2],
        v0=intrinsics[1, 2], z_min=0.2, z_max=1.5, depth_unit=1e-4,
    )  # fmt: skip
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera))
    frames = [str(bin_ / f"{name}-0.depth.png") for name in ("background", "input")]
    for arguments, words in [
        ([str(kinect), str(kinect)], "(424, 512)"),
        (frames, "(480, 640)"),
    ]:
        assert main(["plan", *arguments]) == 2
        out, err = capsys.readouterr()
        assert words in err and err.count("\n") == 1 and not out
    tried = ["--camera", str(path), "--positions", "5x5", "--max-steps", "1"]
    assert main(["plan", *frames, *tried, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    turn = np.array(found["camera"]["pose"])[:3, 2]
    assert np.degrees(np.arccos(turn[2])) == pytest.approx(34.1, abs=0.5)
    for step in found["steps"]:
        u, v = step["camera_position"]
        assert 0 <= u < 640 and 0 <= v < 480
