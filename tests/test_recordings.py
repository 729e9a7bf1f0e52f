"""Recordings: simulated with a hand in the way, written, read again, and every damage named."""

import json
from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera
from jshape.data.recording import changed_box, simulate_recording
from jshape.errors import BadCamera, BadDataset, BadFile, UnknownName
from jshape.height_map import as_frame
from jshape.io.at_once import open_at_once
from jshape.io.cameras import write_camera
from jshape.io.images import write_counts_png
from jshape.io.recordings import (
    Label,
    by_number,
    in_order,
    open_recording,
    read_labels,
    recording_writer,
)
from jshape.sim import SURFACE

SMALL = Camera(40, 30, 50.0, 50.0, 19.5, 14.5, 0.4, 0.5)


@pytest.fixture(scope="module")
def poked():
    """A recording of one idle visit and one poke: its truth and all its frames."""
    truth, frames = simulate_recording(jax.random.key(4), ["poke"], idle=1, still=5, rest=3)
    return truth, np.stack(list(frames))


@pytest.mark.full
def test_the_truth_tells_of_every_frame(poked):
    truth, frames = poked
    assert len(frames) == truth.frames and frames.dtype == np.uint16
    assert frames.shape[1:] == PAPER_BOX.shape
    assert [c["kind"] for c in truth.changes] == ["idle", "action"]
    assert len(truth.still) == 3 and truth.still[-1][1] == len(frames)
    assert truth.still[1][1] < truth.changes[1]["frame"] < truth.still[2][0]


def test_the_bed_lies_open_in_still_frames_and_a_hand_hides_it_between(poked):
    truth, frames = poked
    for start, stop in truth.still:
        seen = frames[start:stop][frames[start:stop] > 0]
        assert seen.min() * 1e-4 > SURFACE - 0.02 and (frames[start:stop] > 0).mean() > 0.99
    for (_, stop), (start, _) in zip(truth.still, truth.still[1:], strict=False):
        middle = frames[(stop + start) // 2]
        hand = (middle > 0) & (middle * 1e-4 < SURFACE - 0.05)
        assert hand.mean() > 0.01 and hand.any(1).sum() > 40
        edges = np.concatenate([hand[0], hand[-1], hand[:, 0], hand[:, -1]])
        assert edges.sum() > 20, "the forearm comes from the image's edge"
        assert SURFACE - 0.26 < middle[hand].min() * 1e-4 < SURFACE - 0.10
        assert (middle == 0).mean() > 0.003, "a strip beside the hand has no depth"


def test_the_true_box_is_where_the_frames_differ(poked):
    truth, frames = poked
    mean = [frames[a:b].astype(float).mean(0, where=frames[a:b] > 0) for a, b in truth.still]
    left, top, w, h = truth.changes[1]["box"]
    u, v = truth.changes[1]["position"]
    assert left < u < left + w and top < v < top + h and 25 < w < 60 and 25 < h < 60
    change = np.abs(np.nan_to_num(mean[2] - mean[1])) * 0.1
    inside = np.zeros(change.shape, bool)
    inside[top : top + h, left : left + w] = True
    assert change[inside].max() > 5 and np.percentile(change[~inside], 99.9) < 1.5
    assert np.percentile(np.abs(np.nan_to_num(mean[1] - mean[0])) * 0.1, 99.9) < 1.5  # idle


def test_a_box_of_no_change_is_none():
    flat = np.full((9, 9), 0.45, np.float32)
    assert changed_box(flat, flat) is None
    bumped = flat.copy()
    bumped[2:4, 3:8] += 0.001
    bumped[8, 8] = np.nan
    assert changed_box(flat, bumped) == (3, 2, 5, 2)


@pytest.mark.parametrize("change", [{"actions": ["tap"]}, {"agent": "dog"}, {"material": "air"},
                                    {"bed": "wavy"}])  # fmt: skip
def test_unknown_names(change):
    with pytest.raises(UnknownName, match="allowed"):
        settings = {"actions": ["poke"]} | change
        simulate_recording(jax.random.key(0), settings.pop("actions"), **settings)


@pytest.fixture
def folder(tmp_path, rng):
    with recording_writer(tmp_path / "rec", SMALL, 1e-4) as add:
        for _ in range(4):
            add(rng.integers(4000, 5000, SMALL.shape).astype(np.uint16))
        add.labels = ["poke", "knock"]
        add.truth = {"still": [(0, 4)]}
    return tmp_path / "rec"


def test_there_and_back(folder, rng):
    recording = open_recording(folder)
    assert (recording.camera, recording.depth_unit, len(recording)) == (SMALL, 1e-4, 4)
    frames = list(recording.frames())
    assert len(frames) == 4 and frames[2].dtype == np.uint16
    np.testing.assert_array_equal(next(recording.frames([2])), frames[2])
    assert json.loads((folder / "truth.json").read_text()) == {"still": [[0, 4]]}
    found = read_labels(folder / "labels.csv", "human", "flour")
    assert list(found.values()) == [Label(a, "human", "flour") for a in ("poke", "knock")]
    with pytest.raises(BadFile, match="exists"):
        with recording_writer(folder, SMALL, 1e-4):
            pass


def test_frames_may_lie_beside_the_camera_with_names_of_their_own(folder):
    for k, path in enumerate(sorted((folder / "frames").iterdir())):
        path.rename(folder / f"depth_{k + 7}.png")
    (folder / "frames").rmdir()
    (folder / "notes.txt").write_text("mine")
    recording = open_recording(folder)
    assert [p.name for p in recording.files] == [f"depth_{k}.png" for k in range(7, 11)]


def refused(folder, match, read=False):
    with pytest.raises(BadDataset) as info:
        recording = open_recording(folder)
        if read:
            list(recording.frames())
    message = str(info.value)
    assert match in message and "\n" not in message
    return message


def test_what_is_no_recording_is_said(folder, tmp_path):
    refused(tmp_path / "none", "no such folder")
    refused(folder / "camera.json", "is a file")
    for path in (folder / "frames").iterdir():
        path.unlink()
    refused(folder, "holds no frames; expected")
    (folder / "frames" / "frame_10_depth.png").write_text("")
    refused(folder, "holds no frames (frame_10_depth.png does not end in a number); expected")
    (folder / "camera.json").unlink()
    refused(folder, "has no camera.json")


def test_missing_frames_are_named_and_may_be_allowed(folder):
    (folder / "frames" / "000001.png").unlink()
    assert "--allow-gaps" in refused(folder, "missing frames: 1;")
    assert len(open_recording(folder, allow_gaps=True)) == 3


@pytest.mark.parametrize(
    "names",
    [
        "9 10 100",
        "100.0 100.033333 100.066667 100.1 100.133333 100.166667 100.2",
        "99.966667 100.0 100.033333",
        "depth_0.05 depth_0.1 depth_0.45",
        "1700000000033333000 1700000000066667000 1700000000100000000",
        "cam1_000008 cam1_000009 cam1_000010",
        "1.01 1.02 1.10",
        "1 2.5 10",
    ],
)
def test_frames_come_in_the_order_of_their_numbers(names, folder):
    names = [f"{name}.png" for name in names.split()]
    found = in_order(folder / name for name in [*sorted(names), "picture.png"])
    assert [path.name for path in found.values()] == names
    assert sorted(names, key=by_number) == names


@pytest.mark.parametrize(
    "names, match",
    [
        ("1.png 01.png", "01.png and 1.png have the same number"),
        ("100.1.png 100.10.png", "100.1.png and 100.10.png have the same number"),
        ("1.9.png 1.10.png", "which comes first, 1.9.png and 1.10.png"),
        ("1.9.png 1.11.png 2.8.png 2.9.png 1.10.png", "which comes first, 1.9.png and 1.11.png"),
        ("7.0.png 7.33333333.png 7.66666666.png 7.100000000.png 7.133333333.png", "comes first"),
        ("1_5.png 2_4.png", "two kinds, 1_5.png and 2_4.png; only the number at the end may"),
        ("2024-05-01_1.png 2024-05-02_1.png", "rename all in the order of time, as 000000.png"),
        ("20240501_115959_9.png 20240501_120000_9.png 20240501_120000_10.png", "comes first"),
        ("0001.png 0002.npy", "two kinds, 0001.png and 0002.npy"),
        ("a1.png b2.png", "two kinds"),
    ],
)
def test_frames_of_which_order_is_open_are_refused(names, match, tmp_path):
    with pytest.raises(BadDataset, match=match):
        in_order(tmp_path / name for name in names.split())


@pytest.mark.parametrize(
    "names",
    [
        "2024-04-30_23-59-58 2024-05-01_00-00-00 2024-05-01_12-00-07",
        "bed_2024-05-01T12:00:00 bed_2024-05-01T12:00:20 bed_2024-05-01T12:01:00",
        "20240501_115959_750 20240501_120000_000 20240501_120000_250",
        "20240430-235959 20240501-000000",
        "2024.05.01.12.00.00 2024.05.01.12.00.10",
        "2024-05-01_12-00-00 2024-05-01_12-00-00.500000 2024-05-01_12-00-01",
    ],
)
def test_frames_named_by_date_and_time_come_in_its_order(names, folder):
    names = names.split()
    for path, name in zip(
        sorted((folder / "frames").iterdir()), [*names, None, None], strict=False
    ):
        path.rename(path.with_name(f"{name}.png")) if name else path.unlink()
    assert [path.stem for path in open_recording(folder).files] == names


def test_a_date_before_a_number_leaves_it_a_number(folder):
    for path in (folder / "frames").iterdir():
        path.rename(path.with_name(f"20240501_{path.name}"))
    assert len(open_recording(folder)) == 4
    (folder / "frames" / "20240501_000001.png").unlink()
    refused(folder, "missing frames: 1;")


def test_frames_named_by_time_have_no_gaps(folder):
    for k, path in enumerate(sorted((folder / "frames").iterdir())):
        path.rename(folder / "frames" / f"{100 + round(k / 7, 6)}.png")
    recording = open_recording(folder)
    assert [p.stem for p in recording.files] == ["100.0", "100.142857", "100.285714", "100.428571"]
    assert len(list(recording.frames())) == 4


def test_two_kinds_of_frames_are_not_mixed(folder):
    cv2.imwrite(str(folder / "frames" / "colour_000000.png"), np.zeros((30, 40, 3), np.uint8))
    refused(folder, "two kinds, 000000.png and colour_000000.png")
    (folder / "frames" / "colour_000000.png").rename(folder / "frames" / "00.png")
    refused(folder, "the same number")


@pytest.mark.parametrize(
    "content, match",
    [
        (b"", "empty"),
        (b"x", "not an image"),
        (np.ones((30, 40), np.uint8), "uint8; a frame is 16-bit"),
        (np.ones((40, 30), np.uint16), "has 30x40 pixels; the camera makes 40x30"),
        (np.ones((30, 40, 3), np.uint16), "colour"),
    ],
    ids=["empty", "text", "8-bit", "size", "colour"],
)
def test_a_damaged_frame_is_named(folder, content, match):
    data = content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes()
    (folder / "frames" / "000002.png").write_bytes(data)
    refused(folder, match, read=True)
    assert "000002.png" in refused(folder, match, read=True)


def test_a_covered_lens_is_no_damage(folder):
    black = cv2.imencode(".png", np.zeros(SMALL.shape, np.uint16))[1].tobytes()
    (folder / "frames" / "000002.png").write_bytes(black)
    assert not open_recording(folder).frame(2).any()


@pytest.mark.parametrize(
    "text, match",
    [
        ("", "empty"),
        ("poke\nknock\n", "header is 'poke'; expected action"),
        ("action\n", "no rows"),
        ("action,agent\npoke\n", "line 2: has 1 columns; the header has 2"),
        ("action,speed\npoke,1\n", "header is 'action,speed'"),
        ("action,agent\npoke,\n", "line 2: has no agent; give a column or --agent"),
        ("action,action\npoke,poke\n", "header"),
        ("action\npoke\n\nknock\n", "line 3 is empty, but rows follow it"),
        ("action;agent\npoke,robot\n", "has 1 columns; the header has 2, separated by ';'"),
        ("action,agent\n\u2013,robot\n", "action is '\u2013'; a name has a letter or a digit"),
        ("action,agent\n--,robot\n", "line 2 ('-' leaves it out): action is '--'"),
        ("action,agent\n\u200b,robot\n", "a name has a letter or a digit"),
    ],
)
def test_bad_labels(tmp_path, text, match):
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(BadDataset) as info:
        read_labels(tmp_path / "labels.csv", None, "flour")
    assert match in str(info.value) and "labels.csv" in str(info.value)


def test_labels_with_columns_and_names(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("agent,action\nrobot,poke\n\nhuman,-\n")
    assert list(read_labels(path, None, "sand").values()) == [
        Label("poke", "robot", "sand"), Label("-", "human", "sand")
    ]  # fmt: skip
    for text in (
        '\ufeff"agent";"action"\r\nrobot;poke;\r\nhuman;-\r\n;;\r\n',
        "agent\taction\nrobot\tpoke\nhuman\t-",
    ):
        path.write_text(text)
        assert [x[:2] for x in read_labels(path, None, "sand").values()] == [
            ("poke", "robot"), ("-", "human")
        ]  # fmt: skip
        path.write_text(text.lstrip("\ufeff"), encoding="utf-16")  # a spreadsheet's "Unicode text"
        assert [x.action for x in read_labels(path, None, "sand").values()] == ["poke", "-"]
    path.write_text("action,agent\nknöck,human\n", encoding="latin-1")
    with pytest.raises(BadDataset, match="is not UTF-8 text; save it as CSV UTF-8"):
        read_labels(path, None, "sand")
    path.write_text("action,agent,material\nknock,,\n-,,\npoke,robot,clay\n")
    assert list(read_labels(path, "human", "sand").values()) == [
        Label("knock", "human", "sand"), Label("-", "human", "sand"), Label("poke", "robot", "clay")
    ]  # fmt: skip
    path.write_text("action,agent\npoke,robot\n-,\n")  # what makes no pair needs no agent
    assert [x.action for x in read_labels(path, None, "sand").values()] == ["poke", "-"]
    path.write_text("action\npoke\n-\n\n\n")
    assert [x.action for x in read_labels(path, "robot", "sand").values()] == ["poke", "-"]
    path.write_text("name,action\nb,poke\na,knock\n")
    assert read_labels(path, "human", "sand", named=True)["a"].action == "knock"
    path.write_text("name,action\nb,poke\nb,knock\n")
    with pytest.raises(BadDataset, match="'b' is there twice"):
        read_labels(path, "human", "sand", named=True)


def at_once(tmp_path, *names, pose=True):
    """What several cameras recorded, whose frames have these names."""
    for number, each in enumerate(names):
        own = tmp_path / "rec" / str(number)
        stands = np.eye(4) + 0.1 * number * np.eye(4, k=3)  # beside each other
        camera = replace(SMALL, pose=as_frame(stands) if pose else None)
        write_camera(own / "camera.json", camera, 1e-4)
        for name in each:
            write_counts_png(own / f"{name}.png", np.full(SMALL.shape, 4500, np.uint16))
    return tmp_path / "rec"


def test_frames_of_several_cameras_match_by_number(tmp_path):
    rec = at_once(tmp_path, ("07", "08", "09"), ("07", "08", "09"), ("08", "09", "10"))
    with pytest.raises(BadDataset) as info:
        open_at_once(rec)
    assert str(info.value).startswith(
        f"{rec}/2 has 3 frames (8 to 10) and {rec}/0 has 3 frames (7 to 9): frames of several "
    )
    parts = open_at_once(rec, allow_gaps=True)
    assert [[int(n) for n in one.numbers] for one in parts] == [[8, 9]] * 3
    assert [path.name for path in parts[2].files] == ["08.png", "09.png"]


def test_frames_of_several_cameras_match_by_time(tmp_path):
    first = [f"{100 + k / 30:.6f}" for k in range(8)]
    # It starts two frames later, lacks one, and is up to 6 ms late.
    second = [f"{100 + k / 30 + 0.002 * (k % 4):.6f}" for k in (2, 3, 4, 6, 7, 8)]
    parts = open_at_once(at_once(tmp_path, first, second))
    assert [path.stem for path in parts[0].files] == [first[k] for k in (2, 3, 4, 6, 7)]
    assert [path.stem for path in parts[1].files] == second[:5]


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ([f"{100 + k / 15:.6f}" for k in range(4)], "a frame every 0.066667, in {}/0 every 0.033"),
        ([f"{900 + k / 30:.6f}" for k in range(8)], "within 0.0166665 of each other (by their"),
        ([f"{k}" for k in range(8)], "named by number in {0}/1 and by time in {0}/0; one of the"),
    ],
    ids=["rate", "clock", "names"],
)
def test_recordings_that_do_not_match_are_refused(second, said, tmp_path):
    rec = at_once(tmp_path, [f"{100 + k / 30:.6f}" for k in range(8)], second)
    with pytest.raises(BadDataset) as info:
        open_at_once(rec)
    assert said.format(rec) in str(info.value) and "\n" not in str(info.value)


def test_one_of_several_cameras_without_a_pose_is_refused(tmp_path):
    rec = at_once(tmp_path, ("1", "2"), ("1", "2"), pose=False)
    with pytest.raises(BadCamera, match="0/camera.json: has no pose; several cameras need one"):
        open_at_once(rec)
