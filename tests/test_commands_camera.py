"""`jshape record`, `setup` and `camera`, as people use them; and from a recording to a bank."""

import csv
import json
import signal
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera
from jshape.cli.main import main
from jshape.data.looks import together
from jshape.data.recording import simulate_recording
from jshape.data.simulate import DEPTH_UNIT
from jshape.data.view import look_of
from jshape.errors import BadCamera, BadFile
from jshape.io.at_once import open_at_once
from jshape.io.banks import load_bank
from jshape.io.cameras import described, write_camera
from jshape.io.recordings import open_recording, recording_writer
from jshape.robot.cameras.base import CameraLost
from jshape.robot.cameras.played import Played
from tests.seen_beds import above_simulated

SMALL = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, 0.42, 0.47)


def noisy(rng, count):
    return np.rint(4500 + rng.normal(0, 4.5, (count, *SMALL.shape))).astype(np.uint16)


@pytest.fixture
def folder(tmp_path, rng):
    with recording_writer(tmp_path / "source", SMALL, 1e-4) as add:
        for counts in noisy(rng, 6):
            add(counts)
    return tmp_path / "source"


@pytest.fixture
def watched(monkeypatch):
    """Puts frames of the test's own before `jshape record` and `jshape setup`."""

    def put(frames, **options):
        camera = Played("watched", SMALL, 1e-4, frames, **options)
        monkeypatch.setattr("jshape.cli.camera.looking", lambda *_: camera)
        return camera

    return put


def run(capsys, *words):
    code = main([str(w) for w in words])
    return code, *capsys.readouterr()


def test_a_recording_is_copied_to_the_bit(folder, tmp_path, capsys):
    code, out, err = run(capsys, "record", folder, "--out", tmp_path / "rec")
    assert code == 0 and not err
    assert "source: 6 frames of 64x48 in" in out and "(the end of the recording)" in out
    assert "100.0% of the pixels have a reading" in out
    first, second = open_recording(folder), open_recording(tmp_path / "rec")
    assert (second.camera, second.depth_unit) == (SMALL, 1e-4)
    for a, b in zip(first.frames(), second.frames(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_largest_count_is_no_reading(tmp_path, watched, rng, capsys):
    frames = noisy(rng, 12)
    frames[:, :12, :] = 65535
    watched(iter(frames))
    code, out, _ = run(capsys, "setup", "watched", "--frames", 6)
    assert code == 1 and "BAD 75.0% of the bed's pixels have a reading" in out
    assert "pixels without depth in all frames: 4608 (of them 4,608 at 65535 (the largest" in out
    watched(iter(frames))
    code, out, _ = run(capsys, "record", "watched", "--out", tmp_path / "rec")
    assert "75.0% of the pixels have a reading (of them 9,216 at 65535 (the largest uint1" in out
    recording = open_recording(tmp_path / "rec")
    assert (recording.frame(0)[:12] == 0).all()
    kept = cv2.imread(str(recording.files[0]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, frames[0])  # to the bit


def test_a_wrong_unit_is_refused_with_the_one_that_fits(folder, tmp_path, capsys):
    fields = json.loads((folder / "camera.json").read_text())
    for unit, said in (
        (
            {"depth_unit": 1e-3},
            ("depth_unit 0.0001 instead of 0.001 would fit it", "; 0.0001 would fit"),
        ),
        ({}, ("depth_unit is missing: metres per count of the frames; 0.0001 would fit",)),
    ):
        text = json.dumps({k: v for k, v in fields.items() if k != "depth_unit"} | unit)
        (folder / "camera.json").write_text(text)
        segment = ["dataset", "segment", folder, tmp_path / "set", "--action", "poke",
                   "--agent", "human", "--material", "flour"]  # fmt: skip
        picture = folder / "frames" / "000000.png"
        for words in (
            ["record", folder, "--out", tmp_path / "rec"],
            ["setup", folder],
            ["setup", picture, "--camera-file", folder / "camera.json"],
            segment,
        ):
            code, _, err = run(capsys, *words)
            assert code == 2 and any(one in err for one in said) and err.count("\n") == 1
    assert not (tmp_path / "rec").exists() and not (tmp_path / "set").exists()


def test_frames_windows_and_json(folder, tmp_path, capsys):
    code, out, _ = run(capsys, "record", folder, "--out", tmp_path / "rec", "--frames", 2,
                       "--window", "10,20,30x25", "--depth-range", "0.3,1", "--json")  # fmt: skip
    found = json.loads(out)
    assert code == 0 and found["frames"] == 2 and found["stopped"] == "as many as asked"
    assert found["camera"] == "source" and found["valid_share"] == 1.0
    recording = open_recording(tmp_path / "rec")
    assert recording.camera.shape == (25, 30) and recording.camera.u0 == 21.0
    assert (recording.camera.z_min, recording.camera.z_max) == (0.3, 1.0)


def test_several_cameras_are_recorded_at_once(tmp_path, capsys):
    """Simulated ones, of one bed; a folder of each, whose frames match."""
    files = []
    for name, tilt in (("left", 30), ("right", -30)):
        files += ["--camera-file", tmp_path / f"{name}.json"]
        write_camera(files[-1], above_simulated(tilt), 1e-4)
    words = ("record", "sim", "sim", "--out", tmp_path / "rec", "--frames", 2)
    assert run(capsys, *words, *files)[0] == 0
    code, out, _ = run(capsys, *words, *files, "--overwrite", "--json")
    said = json.loads(out)
    assert code == 0 and [one["out"] for one in (said, *said["others"])] == [
        str(tmp_path / "rec" / name) for name in "12"
    ]
    parts = open_at_once(tmp_path / "rec")
    assert [(len(one), one.camera.pose) for one in parts] == [
        (2, above_simulated(tilt).pose) for tilt in (30, -30)
    ]
    looks = [look_of(1e-4 * np.float32(one.frame(0)), one.camera) for one in parts]
    one, both = (together(looks[:n])[0].mask.mean() for n in (1, 2))
    assert both >= one > 0.9
    code, _, err = run(capsys, *words, *files[:2], "--overwrite")
    assert code == 2 and "2 cameras and 1 camera files; give one --camera-file for each" in err
    words = (*words[:3], "--out", tmp_path / "none", "--frames", 2)
    for given, said in (
        ((), "has no pose; several cameras need one each"),
        (2 * files[:2], "camera 2 has the same pose as camera 1; each needs its own"),
    ):
        code, _, err = run(capsys, *words, *given)
        assert code == 2 and said in err and not (tmp_path / "none").exists()


def test_a_simulated_camera_is_recorded_for_a_time(tmp_path, capsys):
    code, out, _ = run(capsys, "record", "sim", "--out", tmp_path / "rec", "--seconds", "0.7s",
                       "--every", "0.2s", "--window", "0,0,64x48", "--json")  # fmt: skip
    assert code == 0 and 1 <= json.loads(out)["frames"] <= 5


def test_one_frame_of_a_picture_and_no_clock_for_recordings(folder, tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "a.png"), np.full(SMALL.shape, 4500, np.uint16))
    write_camera(tmp_path / "camera.json", SMALL, 1e-4)
    assert run(capsys, "record", tmp_path / "a.png", "--out", tmp_path / "one")[0] == 0
    assert len(open_recording(tmp_path / "one")) == 1
    code, out, _ = run(capsys, "record", tmp_path / "a.png", "--out", tmp_path / "20",
                       "--frames", 20)  # fmt: skip
    assert code == 0 and "20 frames" in out, "a picture that stays the same is not stuck"
    code, _, err = run(capsys, "record", folder, "--out", tmp_path / "x", "--seconds", "2s")
    assert code == 2 and "--seconds and --every are for live cameras" in err
    assert not (tmp_path / "x").exists()


def test_what_is_there_is_not_replaced_unless_asked(folder, tmp_path, capsys):
    assert run(capsys, "record", folder, "--out", tmp_path / "rec", "--frames", 1)[0] == 0
    code, _, err = run(capsys, "record", folder, "--out", tmp_path / "rec")
    assert code == 2 and "exists" in err
    assert run(capsys, "record", folder, "--out", tmp_path / "rec", "--overwrite")[0] == 0
    assert len(open_recording(tmp_path / "rec")) == 6


def failing(frames, problem):
    yield from frames
    raise problem


def test_ctrl_c_keeps_what_was_recorded(watched, tmp_path, capsys, rng):
    watched(failing(noisy(rng, 3), KeyboardInterrupt()), live=True)
    code, out, _ = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert code == 0 and "3 frames" in out and "(interrupted)" in out
    assert len(open_recording(tmp_path / "rec")) == 3
    watched(failing([], KeyboardInterrupt()), live=True)
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "none")
    assert code == 130 and "interrupted" in err and not (tmp_path / "none").exists()


def test_a_real_signal_keeps_what_was_recorded(watched, tmp_path, capsys, rng, request):
    # A background job is born deaf to Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))

    def frames():
        for k, counts in enumerate(noisy(rng, 9)):
            if k == 4:
                signal.raise_signal(signal.SIGINT)
            yield counts

    watched(frames(), live=True)
    assert run(capsys, "record", "it", "--out", tmp_path / "rec")[0] == 0
    assert len(open_recording(tmp_path / "rec")) == 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rec"], "nothing is left beside it"


@pytest.mark.parametrize("problem", [CameraLost("watched: is gone"), BadFile("bag: torn")])
def test_a_lost_camera_keeps_what_was_recorded(problem, watched, tmp_path, capsys, rng):
    watched(failing(noisy(rng, 2), problem))
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert code == 2 and f"{problem}; what came before, 2 frames, is kept in" in err
    assert err.count("\n") == 1 and len(open_recording(tmp_path / "rec")) == 2
    watched(failing([], problem))
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "none")
    assert code == 2 and str(problem) in err and not (tmp_path / "none").exists()


def test_a_stuck_camera_ends_the_recording(watched, tmp_path, capsys, rng):
    first, second = noisy(rng, 2)
    watched(iter([first, *[second] * 99]), live=True)
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert code == 2 and "15 frames are the same to the bit: it is stuck; what came before" in err
    assert len(open_recording(tmp_path / "rec")) == 15


def test_a_full_disk_keeps_what_was_recorded(watched, tmp_path, capsys, rng, monkeypatch):
    from jshape.io import recordings

    real, calls = recordings.write_counts_png, []

    def full(path, counts):
        calls.append(path)
        if len(calls) > 3:
            raise BadFile(f"{path}: cannot be written: No space left on device")
        return real(path, counts)

    monkeypatch.setattr(recordings, "write_counts_png", full)
    watched(iter(noisy(rng, 9)), live=True)
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert code == 2 and "No space left" in err and "3 frames, is kept" in err
    assert len(open_recording(tmp_path / "rec")) == 3


def test_what_a_killed_recording_left_is_said_before_the_next(folder, tmp_path, capsys):
    left = tmp_path / ".rec.0123456789ab.tmp"
    folder.rename(left)
    code, _, err = run(capsys, "record", left, "--out", tmp_path / "rec", "--frames", 1)
    assert code == 0 and err.count("\n") == 1
    assert f"left unfinished before: {left}, 7 whole files; to keep it: mv" in err
    left.rename(tmp_path / "rec-0123")
    assert len(open_recording(tmp_path / "rec-0123")) == 6
    assert not run(capsys, "record", tmp_path / "rec", "--out", tmp_path / "rec2")[2]


def test_a_recording_without_any_reading_is_kept_and_no_success(watched, tmp_path, capsys, rng):
    watched(iter(np.zeros_like(noisy(rng, 2))))
    code, _, err = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert code == 2 and "watched: no pixel has a reading in 2 frames, kept in" in err
    assert len(open_recording(tmp_path / "rec")) == 2


def test_a_file_with_the_name_of_a_preset_is_a_question(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert described("paper_box")[0] == PAPER_BOX
    write_camera(tmp_path / "paper_box", SMALL, 1e-4)
    with pytest.raises(BadCamera, match="is a preset and a file here; write ./paper_box for"):
        described("paper_box")
    assert described("./paper_box")[:2] == (SMALL, 1e-4)


def test_a_bag_in_millimetres_needs_its_unit_said(tmp_path, capsys, rng):
    pytest.importorskip("rosbags")
    from tests.written_bags import depth_bag

    frames = (noisy(rng, 3) / 10).astype(np.float32)
    path = depth_bag(tmp_path / "bag", "ros2", SMALL, frames)
    for words in (["record", path, "--out", tmp_path / "rec"], ["setup", path]):
        code, _, err = run(capsys, *words)
        assert code == 2 and "values around 450 are not metres" in err
        assert "0.001 would fit: --depth-unit 0.001" in err
        assert words[0] == "setup" or not (tmp_path / "rec").exists()
        code, out, _ = run(capsys, *words, "--depth-unit", "0.001")
        assert code == 0 and "pixels have a reading" in out
    recording = open_recording(tmp_path / "rec")
    np.testing.assert_allclose(next(recording.frames()) * 1e-4, frames[0] * 1e-3, atol=6e-5)


def test_too_many_missing_readings_are_said(watched, tmp_path, capsys, rng):
    frames = noisy(rng, 5)
    frames[:, :, :38] = 0
    watched(iter(frames))
    code, out, _ = run(capsys, "record", "it", "--out", tmp_path / "rec")
    assert (
        code == 0 and "40.6% of the pixels have a reading; jshape setup says how many of the" in out
    )
    watched(iter(frames))
    code, out, _ = run(capsys, "setup", "it")
    assert code == 1 and "BAD 40.6% of the bed's pixels have a reading" in out


def test_setup_of_what_is_not_there(capsys):
    for words, match in (
        (("setup", "nowhere"), "nowhere: is not a camera"),
        (("setup",), "which camera? name one"),
        (("setup", "sim", "--window", "1,2,3"), "is not LEFT,TOP,WIDTHxHEIGHT"),
        (("setup", "sim", "--depth-range", "1"), "is not two depths in metres"),
    ):
        try:
            code = main(list(words))
        except SystemExit as stopped:
            code = stopped.code
        err = capsys.readouterr().err
        assert code == 2 and match in err and err.count("\n") == 1
    assert main(["camera"]) == 2


def test_list(capsys, monkeypatch):
    pytest.importorskip("pyrealsense2")
    from jshape.robot.cameras import realsense

    monkeypatch.setattr(realsense, "devices", list)
    code, out, _ = run(capsys, "camera", "list")
    assert code == 0 and "no RealSense camera is connected" in out and "realsense[:SERIAL" in out
    found = [realsense.Device("Intel RealSense D435", "42")]
    monkeypatch.setattr(realsense, "devices", lambda: found)
    assert "realsense:42" in run(capsys, "camera", "list")[1]
    code, out, _ = run(capsys, "camera", "list", "--json")
    assert json.loads(out) == {"devices": [{"name": "Intel RealSense D435", "serial": "42"}]}


@pytest.mark.full
def test_from_a_recording_of_the_sdk_to_a_bank(tmp_path, capsys):
    """What the SDK's recorder wrote of a (virtual) D435, all the way by the command line."""
    pytest.importorskip("pyrealsense2")
    from tests.virtual_realsense import record

    truth, frames = simulate_recording(
        jax.random.key(9), ["poke"] * 4, idle=1, still=8, move=3, rest=3
    )
    record(tmp_path / "session.db3", PAPER_BOX, DEPTH_UNIT, frames)
    rec, cut, pairs, bank = (tmp_path / n for n in ("rec", "cut", "pairs", "bank"))
    for words in (
        ("record", f"realsense:{tmp_path}/session.db3", "--out", rec),
        ("dataset", "segment", rec, cut, "--action", "poke", "--agent", "human",
         "--material", "flour"),
        ("dataset", "annotate", cut, pairs),
        ("train", pairs, "--kind", "D", "--out", bank),
    ):  # fmt: skip
        code, out, err = run(capsys, *words)
        assert code == 0, err
    assert len(open_recording(rec)) == truth.frames
    with open(pairs / "pairs.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    actions = [c for c in truth.changes if c["kind"] == "action"]
    for row, change in zip(rows, actions, strict=True):
        u, v = change["position"]
        assert abs(int(row["u"]) - u) < 12 and abs(int(row["v"]) - v) < 12
    loaded = load_bank(bank)
    assert loaded.actions == ("poke",) and loaded.camera == PAPER_BOX
    assert Path(pairs / "contact_sheet.png").exists()
