"""The public plan: contract, checks, missing depth, JSON."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

import jshape
from jshape import PAPER_BOX, JShapeError, Plan, Status, distance, metric, plan, plan_depth, to_mm
from jshape.errors import BadFile, BadImage, BadPosition, MissingDepth, UnknownName
from tests.conftest import mm, paper

PLACES = np.array([[91, 92], [239, 92], [387, 92], [91, 302], [239, 197], [387, 302]])


def depth_of(image):
    return np.asarray(PAPER_BOX.depth(metric.unweigh(image, PAPER_BOX)))


@pytest.mark.full
def test_a_plan_retrieves_what_was_applied(bank, molded):
    now, goal, applied = molded
    found = plan(now, goal, bank=bank, **paper(positions=PLACES))
    steps = zip(found.actions, found.positions.tolist(), strict=True)
    assert sorted((name, *place) for name, place in steps) == sorted(applied)
    assert found.status is Status.CONVERGED or found.distances[-1] < 1e-6
    assert len(found) == len(found.actions) == 3 and found.positions.shape == (3, 2)
    assert (np.diff(found.distances) < 0).all()
    assert found.images.shape == (4, *PAPER_BOX.shape)
    np.testing.assert_array_equal(found.images[0], now)
    again = [distance(image, goal) for image in found.images]
    np.testing.assert_allclose(found.distances, again, rtol=1e-5)
    np.testing.assert_allclose(found.distances_mm, to_mm(found.distances, PAPER_BOX))
    np.testing.assert_allclose(found.clipped, 0)


def test_each_image_changes_only_in_the_roi_of_its_action(bank, molded):
    now, goal, _ = molded
    found = plan(now, goal, bank=bank, **paper(positions=PLACES))
    for k, name in enumerate(found.actions):
        (u, v), (w, h) = found.positions[k], bank.roi(name)
        changed = found.images[k + 1] != found.images[k]
        rows, columns = np.nonzero(changed)
        assert rows.min() >= v - h // 2 and rows.max() < v - h // 2 + h
        assert columns.min() >= u - w // 2 and columns.max() < u - w // 2 + w


def test_equal_images_need_no_plan(bank):
    image = np.full(PAPER_BOX.shape, 0.3, np.float32)
    found = plan(image, image, bank=bank, **paper())
    assert found.actions == () and found.positions.shape == (0, 2)
    assert found.status is Status.CONVERGED and found.images.shape == (1, *PAPER_BOX.shape)


def test_limits_and_positions_per_action(bank, molded):
    now, goal, _ = molded
    assert (
        plan(now, goal, bank=bank, **paper(positions=PLACES, max_steps=1)).status
        is Status.MAX_STEPS
    )
    only = plan(now, goal, bank=bank, **paper(positions={"poke": PLACES}))
    assert set(only.actions) == {"poke"}
    first_gain = -np.diff(plan(now, goal, bank=bank, **paper(positions=PLACES)).distances)[0]
    assert not plan(
        now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(float(first_gain) * 1.01))
    )
    near = plan(now, goal, bank=bank, **paper(positions=PLACES, tolerance_mm=mm(1.0)))
    assert near.status is Status.CONVERGED and len(near) == 0


def test_a_grid_by_name_spans_the_image_for_each_action(bank, molded):
    from jshape.planning.candidates import placed_positions

    placed = placed_positions(bank, "21x15")
    for name, (w, h) in bank.rois.items():
        assert len(placed[name]) == 21 * 15
        assert placed[name].min(0).tolist() == [w // 2, h // 2]
        assert placed[name].max(0).tolist() == [480 - (w - w // 2), 395 - (h - h // 2)]
    with pytest.raises(BadPosition, match="'many': a grid is written COLUMNSxROWS"):
        plan(*molded[:2], bank=bank, **paper(positions="many"))


def test_plan_depth_equals_plan_for_metres_and_counts(bank, molded):
    now, goal, _ = molded
    z0, zstar = depth_of(now), depth_of(goal)
    by_image = plan(now, goal, bank=bank, **paper(positions=PLACES))
    metres = plan_depth(z0, zstar, bank=bank, **paper(positions=PLACES))
    assert metres.actions == by_image.actions
    np.testing.assert_allclose(metres.distances, by_image.distances, atol=1e-6)
    unit = 0.00001
    counts = [np.rint(z / unit).astype(np.uint16) for z in (z0, zstar)]
    counted = plan_depth(*counts, bank=bank, depth_unit=unit, **paper(positions=PLACES))
    assert counted.actions == metres.actions


def test_masks_codes_and_ragged_rows(bank, molded):
    now, goal, _ = molded
    z0, zstar = depth_of(now), depth_of(goal)
    hole = np.zeros(z0.shape, bool)
    hole[280:310, 60:100] = True
    truth = plan_depth(np.where(hole, np.nan, z0), zstar, bank=bank, **paper(max_steps=1))
    near = np.where(hole, np.float32(0.3), z0)
    for marked in (np.ma.array(near, mask=hole), np.where(hole, np.float32(6.5535), z0)):
        found = plan_depth(marked, zstar, bank=bank, **paper(max_steps=1))
        np.testing.assert_array_equal(found.distances, truth.distances)
        assert found.filled == (hole.sum(), 0)
    with pytest.raises(BadImage, match="I0 has 1200 pixels that are NaN"):
        plan(np.ma.array(now, mask=hole), goal, bank=bank, **paper())
    with pytest.raises(BadImage, match="z0: is no array of numbers"):
        plan_depth([[1, 2], [3]], zstar, bank=bank, **paper())


def test_other_forms_of_a_depth_image(bank, molded):
    """Other byte orders and widths hold the same numbers; a wrong unit of counts is named."""
    z0, zstar = (depth_of(image) for image in molded[:2])
    truth = plan_depth(z0, zstar, bank=bank, **paper(max_steps=1))
    for kind in (">f4", ">f8", np.longdouble):
        found = plan_depth(z0.astype(kind), zstar, bank=bank, **paper(max_steps=1))
        np.testing.assert_array_equal(found.distances, truth.distances)
    counts = np.rint(z0 * 1e4).astype(np.uint16)
    same = plan_depth(counts, zstar, bank=bank, depth_unit=1e-4, **paper(max_steps=1))
    swapped = plan_depth(
        counts.astype(">u2"), zstar, bank=bank, depth_unit=1e-4, **paper(max_steps=1)
    )
    np.testing.assert_array_equal(swapped.images[0], same.images[0])
    np.testing.assert_allclose(swapped.distances, same.distances, rtol=1e-6)
    with pytest.raises(BadImage, match="depth_unit 0.0001 instead of 0.001 would fit"):
        plan_depth(counts, zstar, bank=bank, **paper())
    with pytest.raises(BadImage, match=r"holds int64; .*\.astype\(np.uint16\)"):
        plan_depth(counts.astype(np.int64), zstar, bank=bank, **paper())


def test_missing_depth_is_filled_and_reported_or_refused(bank, molded, rng):
    now, goal, _ = molded
    z0, zstar = depth_of(now).copy(), depth_of(goal)
    holes = rng.random(z0.shape) < 0.03
    z0[holes] = np.where(rng.random(holes.sum()) < 0.5, 0, np.nan)
    whole = plan_depth(depth_of(now), zstar, bank=bank, **paper(positions=PLACES))
    found = plan_depth(z0, zstar, bank=bank, **paper(positions=PLACES))
    assert found.filled == (holes.sum(), 0)
    assert found.actions == whole.actions
    np.testing.assert_allclose(found.distances, whole.distances, atol=1e-5)
    with pytest.raises(MissingDepth, match=r"z0: 2\.9 % of the pixels"):
        plan_depth(z0, zstar, bank=bank, **paper(max_missing=0.01))


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda i: i[:-1], BadImage, r"\(394, 480\); the bank's camera makes \(395, 480\)"),
        (lambda i: np.stack([i] * 3, -1), BadImage, r"\(395, 480, 3\)"),
        (lambda i: (i * 255).astype(np.uint8), BadImage, "uint8.*jshape.weigh"),
        (lambda i: np.zeros((*i.shape, 3), np.uint8), BadImage, r"\(395, 480, 3\)"),
        (lambda i: i.astype(complex), BadImage, "complex128"),
        (lambda i: np.where(i > 0, np.nan, i), BadImage, "NaN"),
        (lambda i: i * 300, BadImage, "150"),
        (lambda i: i - 1, BadImage, "-0.5"),
        (lambda i: i[0], BadImage, r"\(480,\)"),
        (lambda i: "image.png", BadImage, "type"),
    ],
)
def test_bad_images_are_refused_in_one_line(bank, spoil, error, words):
    image = np.full(PAPER_BOX.shape, 0.5, np.float32)
    with pytest.raises(error, match=words) as caught:
        plan(spoil(image), image, bank=bank, **paper())
    assert str(caught.value).startswith("I0") and "\n" not in str(caught.value)
    with pytest.raises(error, match=words):
        plan(image, spoil(image), bank=bank, **paper())


@pytest.mark.parametrize(
    ("depth", "words"),
    [
        (np.full((395, 480), 450, np.int64), "int64"),
        (np.full((395, 480), 450.0), r"450 to 450 m.*0\.001 times"),
        (np.zeros((395, 480)), "no pixel has a reading"),
        (np.full((480, 848), 0.45), "848x480"),
        (np.full((395, 480), 0.9), "0.42 to 0.47"),
    ],
)
def test_bad_depth_is_refused_in_one_line(bank, depth, words):
    with pytest.raises(BadImage, match=words) as caught:
        plan_depth(depth, depth, bank=bank, **paper())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"positions": [[5, 5]]}, BadPosition, r"2 ROI\(s\) leave.*knock at \(5, 5\)"),
        ({"positions": [[100.5, 100]]}, BadPosition, "whole pixels"),
        ({"positions": [1, 2, 3]}, BadPosition, r"\(3,\)"),
        ({"positions": {"tap": [[100, 100]]}}, UnknownName, "'tap'; allowed: knock, poke"),
        ({"planner": "refine2"}, UnknownName, "planner 'refine2'; allowed: greedy"),
        ({"bank": "no-such-bank"}, UnknownName, "no-such-bank"),
        ({"max_steps": -1}, JShapeError, "max_steps is -1"),
        ({"max_steps": 10**6}, JShapeError, "max_steps is 1000000.*to 1000"),
        ({"positions": [[2**32 + 239, 197]]}, BadPosition, "whole pixels"),
        ({"positions": [[1, 2], [3]]}, BadPosition, "different length"),
        ({"min_gain_mm": -0.1}, JShapeError, "min_gain_mm is -0.1"),
        ({"tolerance_mm": float("nan")}, JShapeError, "tolerance_mm is nan"),
    ],
)
def test_bad_options_are_refused(bank, options, error, words):
    image = np.full(PAPER_BOX.shape, 0.5, np.float32)
    with pytest.raises(error, match=words):
        plan(image, image, **{"bank": bank} | jshape.options(**options))


def test_json_round_trip_is_lossless(bank, molded, tmp_path):
    now, goal, _ = molded
    found = plan(now, goal, bank=bank, **paper(positions=PLACES))
    found.to_json(tmp_path / "plan.json")
    back = Plan.from_json(tmp_path / "plan.json")
    assert back.actions == found.actions and back.status is found.status
    for name in ("positions", "rois", "distances", "distances_mm", "images", "clipped"):
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))
    assert replace(back.camera, bits=8) == replace(found.camera, bits=8)
    found.to_json(tmp_path / "light.json", images=False)
    assert (tmp_path / "light.json").stat().st_size < 5000
    with pytest.raises(JShapeError, match="without its images"):
        _ = Plan.from_json(tmp_path / "light.json").images


@pytest.mark.parametrize(
    "spoil",
    [
        lambda f: f | {"format": "other"},
        lambda f: f | {"version": 99},
        lambda f: {k: v for k, v in f.items() if k != "steps"},
        lambda f: f | {"distances": [0.5]},
        lambda f: f | {"steps": [{**f["steps"][0], "position": [0, 0]}, *f["steps"][1:]]},
        lambda f: f | {"status": "HAPPY"},
        lambda f: f | {"images": "AAAA"},
        lambda f: f | {"images": f["images"][:500]},
    ],
)
def test_a_spoiled_plan_file_is_refused(bank, molded, tmp_path, spoil):
    now, goal, _ = molded
    path = tmp_path / "plan.json"
    plan(now, goal, bank=bank, **paper(positions=PLACES)).to_json(path)
    path.write_text(json.dumps(spoil(json.loads(path.read_text()))))
    with pytest.raises(BadFile, match="plan.json"):
        Plan.from_json(path)


def test_the_contract_is_exported():
    names = """Camera D435_NOMINAL D435_BAZAR PAPER_BOX ray_lengths r_matrix weigh distance to_mm
    plan plan_depth load_bank save_bank list_banks load_pairs fit JShapeError Status Plan""".split()
    assert set(names) <= set(jshape.__all__) and all(hasattr(jshape, name) for name in names)


def test_a_second_plan_is_not_compiled_again(bank, molded):
    """Compiling takes seconds; a plan of known shapes milliseconds.  100 times is no noise."""
    now, goal, _ = molded
    plan(now, goal, bank=bank, **paper(positions=PLACES))
    start = time.perf_counter()
    plan(goal, now, bank=bank, **paper(positions=PLACES[::-1], min_gain_mm=mm(1e-5)))
    assert time.perf_counter() - start < 0.5
