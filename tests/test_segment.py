"""Cutting recordings: against the simulator's truth, and on arrays made for one property each."""

import json

import cv2
import jax
import numpy as np
import pytest

from jshape import PAPER_BOX
from jshape.cli.main import main
from jshape.data.changes import (
    MOST_FRAMES,
    Averaged,
    average,
    average_segment,
    averaged_frames,
    compare,
)
from jshape.data.recording import simulate_recording
from jshape.data.segment import Segment, cut, thumbnail
from jshape.io.datasets import load_pairs
from jshape.io.recordings import recording_writer

UNIT = 1e-4


@pytest.fixture(scope="module")
def recorded():
    """A recording with an idle visit, two actions and a levelling between them, as arrays."""
    truth, frames = simulate_recording(
        jax.random.key(9), ["poke", "knock"], idle=1, level_every=1, still=8
    )
    return truth, np.stack(list(frames))


@pytest.fixture(scope="module")
def on_disk(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "rec"
    with recording_writer(folder, PAPER_BOX, UNIT) as add:
        for frame in recorded[1]:
            add(frame)
        add.labels = ["poke", "knock"]
    return folder


@pytest.mark.full
def test_every_still_segment_is_found_and_no_hand_is_in_it(recorded):
    truth, frames = recorded
    found = cut(np.stack([thumbnail(f) for f in frames]), UNIT)
    assert len(found.open) == len(truth.still)
    for part, (start, stop) in zip(found.open, truth.still, strict=True):
        assert abs(part.start - start) <= 3 and abs(part.stop - stop) <= 3
        near = (frames[part.start : part.stop] > 0) & (frames[part.start : part.stop] < 4200)
        assert near.mean() < 1e-4
    hidden = [s for s in found.segments if s.state == "occluded"]
    assert len(hidden) >= 3, "the hand rests motionless above the bed, and is not averaged"
    for change in truth.changes:
        if change["frame"] is not None:
            assert not any(s.start <= change["frame"] < s.stop for s in found.open)
            assert found.occluded[change["frame"]] > 0.02


@pytest.mark.full
def test_changes_are_told_apart(recorded):
    truth, frames = recorded
    found = cut(np.stack([thumbnail(f) for f in frames]), UNIT)
    parts = [average_segment(s, frames[s.start : s.stop], UNIT) for s in found.open]
    assert all(0.02 < part.noise_mm < 0.25 for part in parts)
    changes = [compare(a, b, UNIT, 0.15) for a, b in zip(parts, parts[1:], strict=False)]
    kinds = {"idle": "none", "action": "action", "level": "reset"}
    assert [c.kind for c in changes] == [kinds[c["kind"]] for c in truth.changes]
    assert all(bool(c.why) == (c.kind != "action") for c in changes)


def scene(rng, count=30, shape=(80, 96), noise=0.3):
    """Noisy frames of a level bed at 450 mm, in counts."""
    return np.rint(4500 + 10 * noise * rng.standard_normal((count, *shape))).astype(np.uint16)


def states(frames, **settings):
    found = cut(np.stack([thumbnail(f) for f in frames]), UNIT, **settings)
    return [(s.start, s.stop, s.state) for s in found.segments]


def test_a_recording_of_nothing_is_one_segment(rng):
    assert states(scene(rng)) == [(0, 30, "open")]


def test_an_arm_that_rests_motionless_from_the_first_frame_is_not_the_bed(rng):
    frames = scene(rng)
    frames[:12, :40, 30:60] -= 800
    assert states(frames) == [(0, 12, "occluded"), (13, 30, "open")]


def test_a_heap_in_the_middle_is_material_and_a_near_thing_is_not(rng):
    frames = scene(rng, 50)
    frames[20:, 24:56, 24:56] -= 350  # 35 mm high, away from the edge
    assert [s[2] for s in states(frames)] == ["open", "open"]
    frames[30:40, 24:56, 24:56] -= 600
    assert [s[2] for s in states(frames)] == ["open", "open", "occluded", "open"]


def test_a_hand_too_near_for_the_camera_has_no_depth(rng):
    frames = scene(rng)
    frames[10:20, 20:, 30:70] = 0
    assert states(frames) == [(0, 9, "open"), (10, 20, "occluded"), (21, 30, "open")]


def test_fingers_that_lie_flat_at_the_edge_are_no_material(rng):
    frames = scene(rng)
    frames[10:20, 40:, 30:60] -= 150  # 15 mm: below NEAR_MM
    assert [s[2] for s in states(frames)] == ["open", "occluded", "open"]
    frames[20:, 40:, 30:60] -= 150  # it stays: so it is material
    assert [s[2] for s in states(frames)] == ["open", "open"]


def test_flicker_and_missing_pixels_are_no_motion(rng):
    frames = scene(rng)
    for frame in frames:
        frame[rng.random(frame.shape) < 0.05] = 0
        frame[rng.random(frame.shape) < 0.02] = 2000
    assert states(frames) == [(0, 30, "open")]
    frames[::2, :8, :8] = 4000  # a blinking corner
    assert states(frames) == [(0, 30, "open")]


def test_a_segment_must_last(rng):
    frames = scene(rng, 20)
    frames[8:11, :, 30:60] -= 800
    assert [s[2] for s in states(frames)] == ["open", "open"]
    assert [s[2] for s in states(frames, min_frames=8)] == ["short", "open"]


def test_the_mean_is_over_readings_only(rng):
    stack = scene(rng, 12, (20, 30))
    clean = stack.astype(float).mean(0)
    np.testing.assert_allclose(average(stack, UNIT), clean, atol=0.5)
    gaps = stack.copy()
    gaps[rng.random(gaps.shape) < 0.3] = 0
    found = average(gaps, UNIT)
    seen = (gaps > 0).sum(0) >= 3
    assert seen.mean() > 0.9
    expected = gaps.astype(float).sum(0) / np.maximum((gaps > 0).sum(0), 1)
    np.testing.assert_allclose(found[seen], expected[seen], atol=0.51)
    assert not found[~seen].any()
    gaps[:, 0, 0] = 0
    gaps[:2, 0, 1], gaps[2:, 0, 1] = 4500, 0
    assert average(gaps, UNIT)[0, :2].tolist() == [0, 0]


def test_flying_pixels_do_not_enter_the_mean(rng):
    stack = scene(rng, 12, (20, 30), noise=0.1)
    stack[:2, 5, 5] = 3000
    assert abs(int(average(stack, UNIT)[5, 5]) - 4500) <= 2


def test_a_frame_alone_is_its_own_mean(rng):
    stack = scene(rng, 1)
    np.testing.assert_array_equal(average(stack, UNIT), stack[0])


def whole(counts):
    return Averaged(Segment(0, 9, "open"), counts, 0.05)


def test_two_places_far_apart_are_no_action(rng):
    before, after = (average(scene(rng, 10, (200, 240)), UNIT) for _ in range(2))
    after[20:50, 20:50] += 80
    assert compare(whole(before), whole(after), UNIT, 0.05).kind == "action"
    after[150:180, 190:220] += 60
    change = compare(whole(before), whole(after), UNIT, 0.05)
    assert change.kind == "reset" and "2 places far apart" in change.why


def test_at_most_sixty_frames_are_averaged():
    frames = averaged_frames(Segment(100, 4000, "open"))
    assert len(frames) == MOST_FRAMES and (frames[0], frames[-1]) == (100, 3999)
    assert averaged_frames(Segment(3, 6, "open")) == [3, 4, 5]


SAID = ["--agent", "human", "--material", "flour"]


@pytest.mark.full
def test_segment_writes_pairs_and_a_picture(recorded, on_disk, tmp_path, capsys):
    out = tmp_path / "pairs"
    labels = ["--labels", str(on_disk / "labels.csv")]
    assert main(["dataset", "segment", str(on_disk), str(out), *labels, *SAID]) == 0
    text = capsys.readouterr().out
    assert "none   nothing changed beyond the noise" in text and "levelled" in text
    pairs = load_pairs(out)
    assert pairs.action.tolist() == ["poke", "knock"] and set(pairs.agent) == {"human"}
    for k, change in enumerate(c for c in recorded[0].changes if c["kind"] == "action"):
        left, top, w, h = change["box"]
        first = pairs.centre[k] - pairs.size[k] // 2
        assert (np.abs(pairs.centre[k] - (left + w / 2, top + h / 2)) < 25).all()
        assert (first <= np.array([left, top]) + 8).all()
    picture = cv2.imread(str(out / "segments.png"))
    assert picture.shape[0] > 300 and picture.std() > 10
    assert main(["dataset", "segment", str(on_disk), str(out), *labels, *SAID, "--overwrite",
                 "--json"]) == 0  # fmt: skip
    result = json.loads(capsys.readouterr().out)
    assert [c["what"] for c in result["changes"]] == ["none", "poke", "reset", "knock"]


def refused(capsys, match, *arguments):
    assert main([str(a) for a in arguments]) == 2
    done = capsys.readouterr()
    assert match in done.err and done.err.count("\n") == 1 and done.out == ""


@pytest.mark.full
def test_labels_that_do_not_fit_are_refused_with_what_was_found(on_disk, tmp_path, capsys):
    start = ["dataset", "segment", on_disk, tmp_path / "out"]
    labels = tmp_path / "labels.csv"
    labels.write_text("action\npoke\nknock\ngrasp\n")
    refused(capsys, "has 3 rows; ", *start, *SAID, "--labels", labels)
    refused(capsys, "what was done? give --action, or --labels", *start, *SAID)
    refused(capsys, "give --agent", *start, "--action", "poke")
    refused(capsys, "give one of them", *start, *SAID, "--action", "poke", "--labels", labels)
    labels.write_text("action\n-\n-\n")
    refused(capsys, "no pair is left", *start, *SAID, "--labels", labels)
    assert not (tmp_path / "out").exists()
    labels.write_text("action\n-\nknock\n")
    assert main([str(a) for a in (*start, *SAID, "--labels", labels)]) == 0
    assert load_pairs(tmp_path / "out").action.tolist() == ["knock"]


@pytest.mark.full
def test_recordings_without_two_looks_at_the_bed(recorded, tmp_path, capsys):
    _, frames = recorded
    for name, part, match in (
        ("one", frames[:20], "at rest once only (frames 0-"),
        ("none", np.concatenate([frames[:3], frames[15:18]]), "nowhere at rest for 5 frames"),
    ):
        with recording_writer(tmp_path / name, PAPER_BOX, UNIT) as add:
            for frame in part:
                add(frame)
        refused(capsys, match, "dataset", "segment", tmp_path / name, tmp_path / "out",
                "--action", "poke", *SAID)  # fmt: skip
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_a_recording_of_idle_visits_has_no_pairs(recorded, tmp_path, capsys):
    truth, frames = recorded
    with recording_writer(tmp_path / "idle", PAPER_BOX, UNIT) as add:
        for frame in frames[: truth.still[1][1]]:
            add(frame)
    refused(capsys, "no pair is left of 1 changes: none at", "dataset", "segment",
            tmp_path / "idle", tmp_path / "out", "--action", "poke", *SAID)  # fmt: skip


def test_simulate_recording_at_the_command_line(tmp_path, capsys):
    out = tmp_path / "rec"
    start = ["dataset", "simulate-recording", str(out), "--count", "1", "--still-frames", "5"]
    assert main([*start, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == len(list((out / "frames").iterdir())) and result["frames"] > 20
    assert (out / "labels.csv").read_text() == "action\npoke\n"
    assert json.loads((out / "truth.json").read_text())["changes"][0]["kind"] == "action"
    refused(capsys, "exists", *start)
    refused(capsys, "'tap'; allowed: grasp", *start[:2], tmp_path / "x", "--actions", "tap")
