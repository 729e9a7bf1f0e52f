"""Frames of a camera that stands anywhere as pairs, seen from above; straight ones untouched."""

import json
import re
import shutil
from dataclasses import replace

import jax
import numpy as np
import pytest

from benchmarks.tilted import posed
from jshape import PAPER_BOX, load_pairs, sim
from jshape.cli.main import main
from jshape.data.annotate import find_effect, place_boxes
from jshape.data.changes import average
from jshape.data.intrinsics import counts_of
from jshape.data.pair_view import not_from_above, pair_view
from jshape.data.pairs import Examples, Pairs
from jshape.data.simulate import BEDS, random_bed
from jshape.io.cameras import write_camera
from jshape.io.images import read_counts
from jshape.io.recordings import recording_writer
from tests.seen_beds import SMALL, bed, heights, hollow, seen_by, standing

UNIT = 1e-4
SAID = ("--action", "poke", "--agent", "human", "--material", "sand")


def counts(depth, unit=UNIT):
    return counts_of(np.asarray(depth), unit)


@pytest.mark.full
@pytest.mark.parametrize("kind", BEDS)
def test_what_a_straight_camera_sees_stays_as_it_is(kind):
    frame = counts(sim.render(random_bed(jax.random.key(3), kind), PAPER_BOX))
    seen = pair_view([(PAPER_BOX, UNIT)], [frame], "frame")
    assert seen.view is None and seen.camera is PAPER_BOX and seen.depth_unit == UNIT
    assert seen.counts([frame], "frame") is frame and not seen.said


def test_a_tilted_camera_sees_the_bed_from_above():
    camera, unit = standing(30, 0.6), 1e-3
    seen = pair_view([(camera, unit)], [counts(seen_by(camera), unit)], "frame")
    assert "(the bed is seen at 30 degrees)" in seen.said and seen.camera.orthographic
    assert seen.depth_unit == 1e-4
    shown = seen.counts([counts(seen_by(camera), unit)], "frame") * seen.depth_unit
    known = shown > 0
    assert known.mean() > 0.95
    # The pose is in the bed's frame: so are the places of the pixels.
    v, u = np.nonzero(known)
    at = np.stack([*seen.camera.at(u, v, shown[known]), shown[known], np.ones(u.shape)])
    x, y, z, _ = np.array(seen.camera.pose) @ at
    inside = (np.abs(x) < 0.15) & (np.abs(y) < 0.11)
    off = np.abs(z - heights(x, y))[inside]
    assert np.median(off) < 5e-4 and np.percentile(off, 99) < 2e-3


@pytest.mark.full
def test_a_lens_and_a_relief_beyond_the_range_are_reasons_too():
    straight = standing(0, camera=replace(SMALL, z_min=0.42, z_max=0.47))
    bent = replace(straight, lens=(0.1, -0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert not_from_above(straight, seen_by(straight)) == ""
    assert not_from_above(bent, seen_by(bent)) == "the lens distorts"
    heap = bed(of=lambda x, y: 0.09 * np.exp(-(x**2 + y**2) / (2 * 0.045**2)))
    said = not_from_above(straight, seen_by(straight, heap))
    assert said.endswith("% of the bed lie beyond 0.42 to 0.47 m")
    frame = counts(seen_by(straight, heap))
    seen = pair_view([(straight, UNIT)], [frame], "frame")
    top = 0.45 - UNIT * seen.counts([frame], "frame").astype(float)
    assert abs(top[top < 0.2].max() - 0.09) < 2e-3
    # A frame of which none is in the range is of the floor around: as it was.
    far = replace(straight, z_min=0.8, z_max=0.9)
    assert not_from_above(far, seen_by(straight)) == ""


def frames_of(camera, depths, rng, still=8, hand=5):
    """A recording: the bed at rest in each of its states, and a hand before it in between."""
    for k, depth in enumerate(depths):
        for n in range(still + hand * (k + 1 < len(depths))):
            z = np.where(depth > 0, depth + 2e-4 * rng.standard_normal(depth.shape), 0)
            if n >= still:
                z[:70, 50 + n : 90 + n] -= 0.09
            yield counts(z)


def record(folder, camera, depths, rng):
    with recording_writer(folder, camera, UNIT) as add:
        for frame in frames_of(camera, depths, rng):
            add(frame)
    return folder


def run(*words):
    return main([str(word) for word in words])


PLACES = (-0.05, 0.0), (0.03, 0.04)


def states(camera):
    """A bed, and the same after one hollow and after two."""
    return [
        seen_by(camera, bed(of=of))
        for of in (
            heights,
            hollow(0.012, *PLACES[0]),
            lambda x, y: hollow(0.012, *PLACES[0])(x, y) + hollow(0.012, *PLACES[1])(x, y)
            - heights(x, y),
        )
    ]  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("tilts", [(30,), (30, -30)], ids=["one", "two"])
def test_a_recording_at_an_angle_becomes_pairs(tilts, tmp_path, rng, capsys):
    """By one camera, or by two at once, of which the second sees only a part of the bed."""
    for tilt in tilts:
        camera = standing(tilt, 0.5)
        depths = states(camera)
        for depth in depths if tilt < 0 else ():
            depth[:, :40] = 0
        record(tmp_path / "rec" / (str(tilt) if tilts[1:] else ""), camera, depths, rng)
    assert run("dataset", "segment", tmp_path / "rec", tmp_path / "cut", *SAID) == 0
    why = "by 2 cameras" if tilts[1:] else "the bed is seen at 30 degrees"
    assert f"looked at from above ({why})" in capsys.readouterr().out
    assert run("dataset", "annotate", tmp_path / "cut", tmp_path / "pairs") == 0
    pairs = load_pairs(tmp_path / "pairs")
    assert len(pairs) == 2 and pairs.camera.orthographic
    x, y = pairs.camera.at(*pairs.centre.T.astype(float), 0.0)
    at = np.array(pairs.camera.pose) @ np.stack([x, y, np.zeros(2), np.ones(2)])
    np.testing.assert_allclose(at[:2].T, PLACES, atol=4e-3)  # 1.2 pixels
    # The middle of each hollow.
    u, v = pairs.centre.T
    deeper = [UNIT * (int(pairs.posterior[k][v[k], u[k]]) - int(pairs.prior[k][v[k], u[k]]))
              for k in range(2)]  # fmt: skip
    np.testing.assert_allclose(deeper, 0.012, atol=1e-3)
    capsys.readouterr()
    assert run("dataset", "info", tmp_path / "pairs", "--json") == 0
    assert json.loads(capsys.readouterr().out)["camera"]["orthographic"]


def test_cameras_that_do_not_record_one_bed_at_once_are_refused(tmp_path, rng, capsys):
    """Of which one began a moment later, has no pose, or a wrong one."""
    cameras = [standing(tilt, 0.5) for tilt in (30, -30)]
    rec, words = tmp_path / "rec", ("dataset", "segment", tmp_path / "rec", tmp_path / "cut")
    for name, camera in zip("ab", cameras, strict=True):
        record(rec / name, camera, states(camera)[:2], rng)
    frames = [read_counts(path) for path in sorted((rec / "b/frames").iterdir())]
    shutil.rmtree(rec / "b")
    with recording_writer(rec / "b", cameras[1], UNIT) as add:
        for counts in frames[7:] + frames[:7]:
            add(counts)
    assert run(*words, *SAID) == 2
    said = capsys.readouterr().err
    assert f"{rec}/b: shows the open bed at other moments than {rec}/a (correlation -0." in said
    for pose, said in (
        (None, "rec/b/camera.json: has no pose; several cameras need one each"),
        (standing(-30, 0.51).pose, "rec: frames 0-6: cameras 1 and 2 differ by "),
    ):
        shutil.rmtree(rec / "b")
        record(rec / "b", replace(cameras[1], pose=pose), states(cameras[1])[:2], rng)
        assert run(*words, *SAID) == 2
        text = capsys.readouterr().err
        assert said in text and text.count("\n") == 1


def test_a_straight_recording_is_cut_as_ever(tmp_path, rng):
    """The means of its frames as they came, and its own camera."""
    camera = replace(SMALL, z_min=0.42, z_max=0.47)
    rec = record(tmp_path / "rec", camera, states(standing(0))[:2], rng)
    assert run("dataset", "segment", rec, tmp_path / "cut", *SAID) == 0
    assert (tmp_path / "cut/camera.json").read_text() == (rec / "camera.json").read_text()
    frames = np.stack([read_counts(path) for path in sorted((rec / "frames").iterdir())])
    pairs = load_pairs(tmp_path / "cut")
    np.testing.assert_array_equal(pairs.prior[0], average(frames[:7], UNIT))
    np.testing.assert_array_equal(pairs.posterior[0], average(frames[14:], UNIT))


def test_a_camera_that_turns_in_the_middle_ends_the_recording(tmp_path, rng, capsys):
    for tilt, code in ((30, 2), (0, 0)):
        views = [standing(t, 0.5) for t in (tilt, tilt, tilt + 4)]
        depths = [states(camera)[min(k, 1)] for k, camera in enumerate(views)]
        rec = record(tmp_path / f"rec{tilt}", views[0], depths, rng)
        assert run("dataset", "segment", rec, tmp_path / f"cut{tilt}", *SAID) == code
        text = "".join(capsys.readouterr())
        assert f"{rec}: frames 27-33: the bed lies " in text
        assert re.search(r"it lay in frames 0-6, turned by [34]\.\d degrees", text)
        assert ("the camera moved; what comes from there on is another recording" in text) == (
            tilt == 30
        )
        assert text.count("the bed lies") == 1


@pytest.mark.full
def test_data_sets_of_tilted_cameras_are_merged(tmp_path, capsys):
    """Frames before and after, of two sessions in which the camera stood elsewhere."""
    for tilt in (25, 35):
        camera = standing(tilt, 0.5)
        source, own = tmp_path / f"source{tilt}", replace(camera, pose=None)
        for state, depth in zip(("before", "after"), states(camera), strict=False):
            (source / state).mkdir(parents=True)
            np.save(source / state / f"at{tilt}.npy", counts(depth))
        write_camera(source / "camera.json", own, UNIT)
    assert run("dataset", "import", tmp_path / "source25", tmp_path / "25", *SAID) == 0
    said = (tmp_path / "source35", tmp_path / "35", *SAID)
    assert run("dataset", "import", *said, "--like", tmp_path / "25") == 0
    assert run("dataset", "merge", tmp_path / "all", tmp_path / "25", tmp_path / "35") == 0
    assert run("dataset", "annotate", tmp_path / "all", tmp_path / "pairs") == 0
    pairs = load_pairs(tmp_path / "pairs")
    assert len(pairs) == 2
    # Each plane is found anew; their origins lie where the axes meet the bed.
    assert np.abs(pairs.centre[0] - pairs.centre[1]).max() <= 3
    capsys.readouterr()
    assert run("dataset", "import", *said, "--overwrite", "--like", tmp_path / "none") == 2
    assert "none: no such folder" in capsys.readouterr().err


def test_frames_of_a_camera_that_turned_are_no_pairs(tmp_path, capsys):
    source, camera = tmp_path / "source", standing(30, 0.5)
    for state, one in (("before", camera), ("after", standing(34, 0.5))):
        (source / state).mkdir(parents=True)
        np.save(source / state / "a.npy", counts(states(one)[0]))
    write_camera(source / "camera.json", camera, UNIT)
    assert run("dataset", "import", source, tmp_path / "out", *SAID) == 2
    text = capsys.readouterr().err
    assert "after/a.npy: the bed lies " in text and text.count("\n") == 1
    assert re.search(r"in the first frame, turned by [34]\.\d degrees: the camera moved$", text)


def test_what_a_hole_hides_is_part_of_its_box(rng):
    """Of a hole only the far wall is seen; beyond that side the box would end too early."""
    prior = np.rint(4500 + rng.standard_normal((120, 160))).astype(np.uint16)
    posterior = prior.copy()
    posterior[40:60, 50:80] += 150
    posterior[60:80, 50:80] = 0
    posterior[::30, ::30] = 0  # a pixel here and there is none
    assert find_effect(prior, posterior, UNIT).box[3] < 25
    whole = find_effect(prior, posterior, UNIT, hidden=True)
    np.testing.assert_allclose(whole.box, (50, 40, 30, 40), atol=3)
    posterior[40:60, 50:80] = 0
    unseen = find_effect(prior, posterior, UNIT, hidden=True)
    np.testing.assert_allclose(unseen.box, (50, 40, 30, 40), atol=3)
    pairs = Pairs(replace(SMALL, orthographic=True), UNIT, prior[None], posterior[None],
                  *(np.array([name]) for name in ("poke", "human", "sand")), np.array([[9, 9]]),
                  np.array([[8, 8]]), np.array(["a"]))  # fmt: skip
    found, _ = place_boxes(pairs, [unseen], np.zeros(1, bool))
    np.testing.assert_allclose(found.centre[0], (65, 60), atol=2)


def test_a_few_pixels_that_no_pair_has_seen_are_filled_for_a_fit(rng):
    rois = rng.random((2, 3, 20, 20)).astype(np.float32)
    rois[1, :, 5:9, 5:10] = np.nan  # 5 %
    rois[1, 0, :2] = np.nan  # seen by the others
    examples = Examples(*rois, np.zeros((3, 2), np.int32))
    filled = examples.without_blind()
    assert filled.seen[1:].all() and not filled.seen[0, :2].any() and filled.seen[0, 2:].all()
    np.testing.assert_array_equal(filled.prior, rois[0])
    around = rois[1, :, 4:10, 4:11]
    inside = filled.posterior[:, 5:9, 5:10]
    assert (inside <= np.nanmax(around, (1, 2))[:, None, None]).all()
    rois[1, :, 5:15, 5:10] = np.nan
    assert not Examples(*rois, examples.corner).without_blind().seen[:, 5:15, 5:10].any()


@pytest.mark.full
def test_from_a_recording_at_an_angle_to_a_plan_on_its_frames(tmp_path, capsys):
    """Two knocks, by a camera with a quarter of a D435's pixels; the first one is planned."""
    rec, cut, pairs, bank = (tmp_path / name for name in ("rec", "cut", "pairs", "bank"))
    file, whole = tmp_path / "camera.json", posed(30, 0.6)
    half = {name: getattr(whole, name) / 2 for name in ("fx", "fy", "u0", "v0")}
    write_camera(file, replace(whole, width=424, height=240, **half), UNIT)
    how = ("--actions", "knock", "--count", 2, "--agent", "robot", "--seed", 1)
    assert run("dataset", "simulate-recording", rec, *how, "--camera-file", file) == 0
    assert run("dataset", "segment", rec, cut, *SAID, "--action", "knock") == 0
    assert run("dataset", "annotate", cut, pairs) == 0
    assert run("train", pairs, "--out", bank) == 0
    truth = json.loads((rec / "truth.json").read_text())
    now, wanted = (rec / f"frames/{first:06d}.png" for first, _ in truth["still"][:2])
    capsys.readouterr()
    words = ("--camera-file", file, "--bank", bank, "--stride", 12, "--yaws", 1, "--json")
    assert run("plan", now, wanted, *words) == 0
    plan = json.loads(capsys.readouterr().out)
    # 1 pixel of 2.8 mm off.  Of 1.11 mm between the two frames 0.81 stay: their noise.
    (knock,) = plan["steps"]
    off = np.subtract(knock["camera_position"], truth["changes"][0]["position"])
    assert np.hypot(*off) < 4
    assert plan["distances_mm"][1] < 0.85 * plan["distances_mm"][0]
