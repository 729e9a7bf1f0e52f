"""Boxes found in pairs: against the simulator's true ones, the independent simulation, people."""

import csv
import json
import re

import cv2
import jax
import numpy as np
import pytest

from benchmarks.annotation import iou, overlaps, pairs_with_truth
from jshape import Camera, load_pairs, save_pairs
from jshape.cli.main import main
from jshape.data.annotate import find_effect, place_boxes
from jshape.data.pairs import Pairs
from jshape.data.recording import changed_box
from jshape.io.annotations import boxes_by_hand
from jshape.viz import sheets

UNIT = 1e-4
CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5, 0.4, 0.5)


def flat(rng, noise=0.15):
    return np.rint(4500 + 10 * noise * rng.standard_normal(CAMERA.shape)).astype(np.uint16)


def crater(counts, left, top, w, h, depth_mm=8.0):
    counts = counts.copy()
    counts[top : top + h, left : left + w] += np.uint16(10 * depth_mm)
    return counts


def make_pairs(rng, places, action="poke"):
    """Pairs with craters of (left, top, w, h), whose ROIs say nothing yet."""
    n = len(places)
    prior = np.stack([flat(rng) for _ in range(n)])
    after = np.stack([crater(flat(rng), *p) if p else flat(rng) for p in places])
    return Pairs(
        CAMERA, UNIT, prior, after, np.array([action] * n), np.array(["human"] * n),
        np.array(["sand"] * n), np.full((n, 2), 60, np.int32), np.full((n, 2), 100, np.int32),
        np.array([f"p{k}" for k in range(n)]),
    )  # fmt: skip


def test_a_box_is_exact_to_two_pixels(rng):
    for box in ((30, 40, 25, 18), (0, 0, 20, 20), (130, 95, 30, 25)):
        effect = find_effect(flat(rng), crater(flat(rng), *box), UNIT)
        assert np.abs(np.subtract(effect.box, box)).max() <= 2
        assert effect.peak_mm == pytest.approx(8, abs=1) and 0.02 < effect.noise_mm < 0.1
        assert effect.others == ()


def test_noise_alone_has_no_box(rng):
    for noise in (0.0, 0.1, 0.5, 1.0):
        effect = find_effect(flat(rng, noise), flat(rng, noise), UNIT)
        assert effect.box is None and not effect.mask.any() and effect.peak_mm == 0


def test_the_cameras_drift_is_no_effect(rng):
    after = crater(flat(rng), 30, 40, 25, 18) + np.uint16(30)
    effect = find_effect(flat(rng), after, UNIT)
    assert np.abs(np.subtract(effect.box, (30, 40, 25, 18))).max() <= 2


def test_missing_pixels_are_no_effect(rng):
    before, after = flat(rng), crater(flat(rng), 30, 40, 25, 18)
    before[rng.random(before.shape) < 0.1] = 0
    after[rng.random(after.shape) < 0.1] = 0
    after[90:, 100:] = 0
    effect = find_effect(before, after, UNIT)
    assert np.abs(np.subtract(effect.box, (30, 40, 25, 18))).max() <= 2
    assert np.isnan(effect.change_mm[95:, 110:]).all()
    assert find_effect(np.zeros_like(before), after, UNIT).box is None


def test_the_deepest_of_two_places_is_the_effect(rng):
    after = crater(crater(flat(rng), 20, 20, 20, 20), 100, 80, 30, 20, depth_mm=3.0)
    effect = find_effect(flat(rng), after, UNIT)
    assert np.abs(np.subtract(effect.box, (20, 20, 20, 20))).max() <= 2
    assert len(effect.others) == 1 and effect.second_mm == pytest.approx(3, abs=1)


def test_an_action_gets_the_mean_size_at_every_centre(rng):
    pairs = make_pairs(rng, [(20, 30, 20, 20), (60, 50, 30, 20), (120, 90, 25, 26)])
    effects = [find_effect(a, b, UNIT) for a, b in zip(pairs.prior, pairs.posterior, strict=True)]
    found, there = place_boxes(pairs, effects, np.zeros(3, bool))
    assert there.all() and (found.size == found.size[0]).all()
    np.testing.assert_allclose(found.size[0], (25, 22), atol=2.5)
    np.testing.assert_allclose(found.centre, [(30, 40), (75, 60), (132, 103)], atol=2)


def test_a_roi_at_the_edge_is_shifted_inside(rng):
    pairs = make_pairs(rng, [(0, 0, 14, 14), (60, 50, 40, 40), (146, 106, 14, 14)])
    effects = [find_effect(a, b, UNIT) for a, b in zip(pairs.prior, pairs.posterior, strict=True)]
    found, _ = place_boxes(pairs, effects, np.zeros(3, bool))
    first = found.centre - found.size // 2
    assert (first >= 0).all() and (first + found.size <= (160, 120)).all()
    assert first[0].tolist() == [0, 0] and (first + found.size)[2].tolist() == [160, 120]


@pytest.mark.full
@pytest.mark.parametrize("bed, agent", [("flat", "robot"), ("irregular", "human")])
def test_overlap_with_the_simulators_true_boxes(bed, agent):
    """An honest lower bound: `python -m benchmarks.annotation` gives 0.88 on average."""
    own, written = [], []
    for action in ("grasp", "poke", "pinch"):
        pairs, boxes = pairs_with_truth(jax.random.key(3), action, agent, bed, "flour", 2, 8)
        each, mean, _ = overlaps(pairs, boxes)
        own += each
        written += mean
    assert min(own) > 0.5 and np.mean(own) > 0.75 and np.mean(written) > 0.7


@pytest.mark.full
@pytest.mark.parametrize("noise", ["pairs", "pairs_noisy"])
def test_boxes_in_the_independent_simulation(shared_data, noise):
    """Its frames hold only the surroundings of the action; its places are those of the tool."""
    pairs = load_pairs(shared_data / f"mpm/{noise}/flat_flour_human")
    every = np.arange(0, len(pairs), 8)
    pairs = pairs.select(every)
    effects = [find_effect(a, b, UNIT) for a, b in zip(pairs.prior, pairs.posterior, strict=True)]
    found, there = place_boxes(pairs, effects, np.zeros(len(pairs), bool))
    assert there.all()
    assert np.abs(found.centre - pairs.centre).max() < 30
    clean = load_pairs(shared_data / "mpm/pairs/flat_flour_human").select(every)
    # A single frame's noise hides rims of a millimetre, so what changed by 2 mm is the truth there.
    least = 0.5 if noise == "pairs" else 2.0
    boxes = [
        changed_box(a * np.float32(UNIT), b * np.float32(UNIT), least)
        for a, b in zip(clean.prior, clean.posterior, strict=True)
    ]
    assert np.mean([iou(e.box, b) for e, b in zip(effects, boxes, strict=True)]) > 0.7


@pytest.fixture
def folder(tmp_path, rng):
    pairs = make_pairs(rng, [(20, 30, 20, 20), (60, 50, 30, 20), (100, 80, 25, 26)])
    return save_pairs(pairs, tmp_path / "pairs")


def refused(capsys, match, *arguments):
    assert main([str(a) for a in arguments]) == 2
    done = capsys.readouterr()
    assert match in done.err and done.err.count("\n") == 1 and done.out == ""


def run(*arguments):
    assert main(["dataset", "annotate", *[str(a) for a in arguments]]) == 0


def edit(folder, row, **values):
    path = folder / "pairs.csv"
    header, *rows = csv.reader(path.read_text().splitlines())
    for name, value in values.items():
        rows[row][header.index(name)] = str(value)
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def test_a_hand_written_table_is_honoured(folder, tmp_path, capsys):
    refused(capsys, "all 3 boxes were given by hand", "dataset", "annotate", folder, tmp_path / "x")
    assert not (tmp_path / "x").exists()


@pytest.mark.full
def test_annotate_then_mend_a_box_then_annotate_again(folder, tmp_path, capsys):
    out = tmp_path / "out"
    run(folder, out, "--all")
    assert re.search("poke +3 +0 +2[5-7]x2[2-4]", capsys.readouterr().out)
    first = load_pairs(out)
    assert not boxes_by_hand(out).any()
    sheet = cv2.imread(str(out / "contact_sheet.png"))
    assert sheet.shape[0] > 150 and sheet.std() > 10

    edit(out, 1, u=80, v=62, width=40, height=30)
    assert boxes_by_hand(out).tolist() == [False, True, False]
    refused(capsys, "exists", "dataset", "annotate", out, out)
    run(out, out, "--overwrite", "--json")
    result = json.loads(capsys.readouterr().out)
    assert (result["pairs"], result["by_hand"]) == (3, 1)
    second = load_pairs(out)
    assert second.centre[1].tolist() == [80, 62] and second.size[1].tolist() == [40, 30]
    # It counts in the mean size, and the others keep their places.
    np.testing.assert_allclose(
        second.roi_size("poke"), ((20 + 40 + 25) / 3, (20 + 30 + 26) / 3), atol=2
    )
    np.testing.assert_allclose(second.centre[0], first.centre[0], atol=3)
    np.testing.assert_array_equal(second.prior, first.prior)
    run(out, tmp_path / "again")
    assert boxes_by_hand(tmp_path / "again").tolist() == [False, True, False]
    run(out, tmp_path / "anew", "--all")
    np.testing.assert_array_equal(load_pairs(tmp_path / "anew").size, first.size)


def test_a_pair_without_effect_is_refused_or_left_out(rng, tmp_path, capsys):
    save_pairs(make_pairs(rng, [(20, 30, 20, 20), None]), tmp_path / "pairs")
    start = ["dataset", "annotate", tmp_path / "pairs", tmp_path / "out", "--all"]
    refused(capsys, "nothing changed beyond the noise of 0.", *start)
    refused(capsys, "in p1; --skip leaves such pairs out", *start)
    assert not (tmp_path / "out").exists()
    run(*start[2:], "--skip")
    assert "left out, nothing changed: p1" in capsys.readouterr().out
    assert load_pairs(tmp_path / "out").id.tolist() == ["p0"]
    save_pairs(make_pairs(rng, [None]), tmp_path / "none")
    refused(capsys, "no pair shows a change", "dataset", "annotate", tmp_path / "none",
            tmp_path / "x", "--all", "--skip")  # fmt: skip


@pytest.mark.full
def test_doubtful_boxes_are_named(rng, tmp_path, capsys):
    places = [(20, 30, 20, 20), (60, 50, 21, 20), (90, 30, 20, 20), (60, 50, 50, 40)]
    save_pairs(make_pairs(rng, places), tmp_path / "pairs")
    run(tmp_path / "pairs", tmp_path / "out", "--all", "--json")
    doubts = json.loads(capsys.readouterr().out)["look_at"]
    assert "the mean 3" in doubts["p3"] and "its own box is 5" in doubts["p3"]


@pytest.mark.full
def test_many_pairs_take_several_sheets(rng, tmp_path, capsys, monkeypatch):
    save_pairs(make_pairs(rng, [(20 + k, 30, 20, 20) for k in range(3)]), tmp_path / "pairs")
    monkeypatch.setattr(sheets, "PER_PAGE", 2)
    run(tmp_path / "pairs", tmp_path / "out", "--all", "--json")
    assert json.loads(capsys.readouterr().out)["sheets"] == 2
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"contact_sheet.png", "contact_sheet_002.png"} <= names
    run(tmp_path / "out", tmp_path / "out", "--overwrite")


@pytest.mark.full
def test_from_a_recording_to_a_plan(tmp_path, capsys, monkeypatch):
    """The whole way of a user: record, segment, annotate, train, evaluate, plan."""
    monkeypatch.chdir(tmp_path)

    def command(line):
        assert main(line.split()) == 0, capsys.readouterr().err

    command("dataset simulate-recording rec --actions poke --count 4 --still-frames 6 --seed 2")
    command("dataset segment rec cut --action poke --agent human --material flour")
    command("dataset annotate cut pairs")
    command("evaluate pairs --json")
    command("train pairs --out bank")
    pairs = load_pairs("pairs")
    truth = json.loads((tmp_path / "rec" / "truth.json").read_text())["changes"]
    for k, change in enumerate(truth):
        first = pairs.centre[k] - pairs.size[k] // 2
        assert iou((*first, *pairs.size[k]), change["box"]) > 0.5
    (tmp_path / "places.json").write_text(json.dumps({"positions": pairs.centre.tolist()}))
    capsys.readouterr()
    command("plan pairs/frames/00002_prior.png pairs/frames/00002_posterior.png --bank bank "
            "--camera pairs/camera.json --positions places.json --out-of-bounds shift "
            "--min-gain-mm 0.005 --json")  # fmt: skip
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert [s["action"] for s in steps] == ["poke"]
    assert np.abs(np.subtract(steps[0]["position"], pairs.centre[2])).max() <= 2
