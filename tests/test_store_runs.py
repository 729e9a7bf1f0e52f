"""Runs on disk: append only, and no complete step is lost in a crash."""

import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape.errors import BadCamera, BadFile, BadImage
from jshape.io import runs
from jshape.io.runs import Run


@pytest.fixture
def depth(rng):
    depth = rng.uniform(0.4, 0.5, (9, 12)).astype(np.float32)
    depth[0, 0] = np.nan
    return depth


@pytest.fixture
def run(tmp_path, depth):
    run = Run.create(tmp_path / "run", {"goal": "letter", "seed": 3})
    run.append({"action": "poke", "position": (240, 197)}, depth)
    run.append({"action": "knock", "distance_mm": np.float32(1.5)})
    return run


def one_line(info):
    assert "\n" not in str(info.value)
    return str(info.value)


def test_round_trip(run, depth):
    for found in (run, Run.open(run.folder)):
        assert found.meta == {"goal": "letter", "seed": 3} and len(found) == 2
        assert found.steps == (
            {"index": 0, "action": "poke", "position": [240, 197], "frame": "frames/000.png"},
            {"index": 1, "action": "knock", "distance_mm": 1.5},
        )
        np.testing.assert_allclose(found.depth(0), depth, atol=0.51e-4)
        for index in (1, 2, -1):
            with pytest.raises(BadFile):
                found.depth(index)
    assert sorted(os.listdir(run.folder)) == ["frames", "run.json", "steps.jsonl"]


def test_a_run_goes_on_after_it_was_opened(run, depth):
    again = Run.open(run.folder)
    assert again.append({"action": "press"}, depth) == 2
    assert [s["index"] for s in Run.open(run.folder).steps] == [0, 1, 2]
    assert (run.folder / "frames" / "002.png").is_file()


def test_every_step_is_synced_before_append_returns(run, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(runs.os, "fsync", lambda handle: synced.append(handle) or real(handle))
    run.append({"action": "poke"})
    assert len(synced) == 1


@settings(max_examples=30)
@given(st.data())
def test_wherever_the_file_is_cut_the_complete_steps_are_there(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("run")
    run = Run.create(folder / "run")
    texts = data.draw(st.lists(st.text(max_size=5), min_size=1, max_size=4))
    for text in texts:
        run.append({"note": text})
    path = run.folder / "steps.jsonl"
    content = path.read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    torn = data.draw(st.sampled_from([b"", b"\0\0\0", b"\0\0\n", b'{"index', b"\xff"]))
    path.write_bytes(content[:cut] + torn if content[:cut].endswith(b"\n") else content[:cut])
    complete = content[:cut].count(b"\n")
    found = Run.open(run.folder)
    assert [s["note"] for s in found.steps] == texts[:complete]
    found.append({"note": "after the crash"})
    final = Run.open(run.folder)
    assert [s["note"] for s in final.steps] == [*texts[:complete], "after the crash"]
    assert path.read_bytes().count(b"\n") == complete + 1


def test_opening_alone_changes_nothing(run):
    path = run.folder / "steps.jsonl"
    path.write_bytes(path.read_bytes() + b'{"index": 2, "act')
    before = path.read_bytes()
    assert len(Run.open(run.folder)) == 2
    assert path.read_bytes() == before


def test_the_frame_of_a_step_that_was_not_written_is_written_anew(run, depth):
    (run.folder / "frames" / "002.png").write_bytes(b"half")
    again = Run.open(run.folder)
    again.append({"action": "poke"}, depth)
    np.testing.assert_allclose(Run.open(run.folder).depth(2), depth, atol=0.51e-4)


def test_damage_before_the_last_line_is_not_passed_over(run):
    path = run.folder / "steps.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    for content in ([b"{\n", lines[1]], [lines[1], lines[0]], [lines[0], lines[0], lines[1]]):
        path.write_bytes(b"".join(content))
        with pytest.raises(BadFile, match="steps.jsonl: line") as info:
            Run.open(run.folder)
        one_line(info)


def test_two_writers_do_not_mix(run):
    other = Run.open(run.folder)
    other.append({"action": "poke"})
    with pytest.raises(BadFile, match="another program"):
        run.append({"action": "press"})
    (run.folder / "steps.jsonl").write_bytes(b"")
    with pytest.raises(BadFile, match="another program"):
        run.append({"action": "press"})


def test_a_failed_append_leaves_the_run_as_it_was(run, monkeypatch, depth):
    before = (run.folder / "steps.jsonl").read_bytes()

    def fail(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(runs.os, "fsync", fail)
    for step, image in (({"a": 1}, None), ({"a": 1}, depth)):
        with pytest.raises(BadFile, match="No space left") as info:
            run.append(step, image)
        one_line(info)
    monkeypatch.undo()
    assert (run.folder / "steps.jsonl").read_bytes() == before
    assert len(run) == len(Run.open(run.folder)) == 2
    assert sorted(os.listdir(run.folder / "frames")) == ["000.png"]
    assert run.append({"a": 1}) == 2


@pytest.mark.parametrize(
    "step", [{"index": 3}, {"frame": "x"}, {"a": float("nan")}, {"a": object()}, {"a": {1}}]
)
def test_a_step_that_json_cannot_hold_is_refused(run, step):
    with pytest.raises(BadFile) as info:
        run.append(step)
    assert "steps.jsonl" in one_line(info) and len(Run.open(run.folder)) == 2


def test_a_depth_that_16_bits_cannot_hold_is_refused(run):
    with pytest.raises(BadImage, match="16 bits"):
        run.append({}, np.full((3, 4), 9.0))
    assert len(Run.open(run.folder)) == 2


def test_an_existing_run_is_replaced_only_on_demand(run, tmp_path):
    with pytest.raises(BadFile, match="exists"):
        Run.create(run.folder)
    assert len(Run.open(run.folder)) == 2
    assert len(Run.create(run.folder, overwrite=True)) == 0
    with pytest.raises(BadFile, match="not replaced"):
        Run.create(tmp_path, overwrite=True)
    (run.folder / "report.md").write_text("by the demo")
    with pytest.raises(BadFile, match="also holds report.md"):
        Run.create(run.folder, overwrite=True)
    Run.create(run.folder, overwrite=True, contents=("plan.json", "report.md"))
    assert sorted(os.listdir(run.folder)) == ["run.json", "steps.jsonl"]
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile):
        Run.create(tmp_path / "file" / "below")
    for unit in (0.0, -1.0, float("nan")):
        with pytest.raises(BadCamera):
            Run.create(tmp_path / "new", depth_unit=unit)
    with pytest.raises(BadFile, match="JSON"):
        Run.create(tmp_path / "new", {"a": object()})
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "change, match",
    [
        ({"format": "x"}, "expected 'jshape-run'"),
        ({"version": 2}, "newer than this program reads .1."),
        ({"version": "1"}, "version is '1'"),
        ({"meta": []}, "meta is "),
    ],
)
def test_a_bad_description_is_refused(run, change, match):
    path = run.folder / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(BadFile, match=match) as info:
        Run.open(run.folder)
    assert "run.json" in one_line(info)


def test_what_is_no_run(tmp_path, run):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(BadFile, match="no such file"):
            Run.open(folder)
    (run.folder / "steps.jsonl").unlink()
    with pytest.raises(BadFile, match="steps.jsonl: no such file"):
        Run.open(run.folder)


def test_a_frame_does_not_lead_out_of_the_run(run):
    path = run.folder / "steps.jsonl"
    path.write_text('{"index": 0, "frame": "../../secret.png"}\n{"index": 1, "frame": 3}\n')
    found = Run.open(run.folder)
    for index in (0, 1):
        with pytest.raises(BadFile, match="not"):
            found.depth(index)
