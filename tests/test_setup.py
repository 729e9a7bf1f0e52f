"""`jshape setup`: beds whose tilt, noise and roughness are known, measured and judged."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jshape import D435_BAZAR, Camera
from jshape.cli.main import main
from jshape.data.set_up import measure, verdict
from jshape.errors import BadCamera, BadImage
from jshape.height_map import as_frame
from jshape.io.cameras import read_bed, read_camera, write_camera
from jshape.io.formats import read_array
from jshape.io.images import write_depth_png
from jshape.io.maps import read_map
from jshape.viz.maps import setup_figure
from jshape.viz.style import png
from tests.seen_beds import SMALL as WIDE
from tests.seen_beds import bed, seen_by, standing
from tests.test_cameras import CAMERAS, scene
from tests.test_looks import KINECT, SR300

SMALL = Camera(160, 120, 145.0, 140.0, 70.0, 66.0, 0.42, 0.47)
UNIT = 1e-4


def tilted(camera, tilt_u=0.0, tilt_v=0.0, distance=0.45):
    """Depth of a plane through (0, 0, distance), its normal turned, in plain trigonometry."""
    a, b = np.tan(np.radians([tilt_u, tilt_v]))
    x = (np.arange(camera.width) - camera.u0) / camera.fx
    y = ((np.arange(camera.height) - camera.v0) / camera.fy)[:, None]
    # z = distance + a X + b Y with X = x z, Y = y z.
    return distance / (1.0 - a * x - b * y)


def frames(rng, depth, count=8, noise=0.00045, holes=0.002, unit=UNIT):
    noisy = depth + rng.normal(0, noise, (count, *depth.shape))
    counts = np.rint(np.where(depth > 0, noisy, 0.0) / unit).astype(np.uint16)
    counts[rng.random(counts.shape) < holes] = 0
    return counts


def check(rng, depth, camera=SMALL, keep_range=True, **options):
    stack = frames(rng, depth, **options)
    return measure(stack, camera, options.get("unit", UNIT), keep_range=keep_range)


def bad(setup, **options):
    found = verdict(setup, **options)
    assert all("\n" not in sentence for _, sentence in found)
    return [sentence for good, sentence in found if not good]


def test_a_good_set_up_is_measured_and_called_good(rng):
    setup = check(rng, tilted(SMALL) + rng.normal(0, 0.0015, SMALL.shape), count=30)
    assert setup.frames == 30 and not setup.frozen
    assert setup.valid == pytest.approx(0.998, abs=0.001)
    assert setup.noise_mm == pytest.approx(0.45, rel=0.03)
    assert setup.expected_mm == pytest.approx(0.4455, rel=0.01)  # 2.2 mm per square metre
    assert setup.residual_mm == pytest.approx(1.5, rel=0.05)
    assert setup.tilt_deg < 0.1 and setup.distance == pytest.approx(0.45, abs=1e-4)
    assert setup.flat > 0.999 and setup.inside == 1.0 and setup.bed.mean() > 0.95
    assert bad(setup) == []
    assert verdict(setup)[-1][1] == "for height maps, pairs and banks of images"


@pytest.mark.parametrize(
    ("tilt", "side"), [((1.0, 0.0), ""), ((0.0, -3.0), "upper"), ((-10.0, 5.0), "left")]
)
def test_the_tilt_is_the_angle_against_the_image_plane(tilt, side, rng):
    setup = check(rng, tilted(SMALL, *tilt), keep_range=False)
    expected = np.degrees(np.arctan(np.hypot(*np.tan(np.radians(tilt)))))
    assert setup.tilt_deg == pytest.approx(expected, abs=0.03)
    assert setup.tilt_towards == pytest.approx(tilt, abs=0.04)
    assert setup.residual_mm < 0.3, "a tilted plane is a plane"
    said = " ".join(sentence for _, sentence in verdict(setup))
    assert (f": the {side} side is farther away" in said) == bool(side)
    assert ("not for pairs and banks of images: tilted by more than 2 degrees" in said) == bool(
        side
    )


@pytest.mark.full
def test_walls_and_a_table_are_none_of_the_bed(rng):
    depth = tilted(SMALL, 1.0, 0.5)
    depth[:, :40] = 0.60  # the table beside the box: a quarter of the view
    depth[:15, 40:] = 0.38
    setup = check(rng, depth)
    assert setup.tilt_deg == pytest.approx(np.hypot(1.0, 0.5), abs=0.05)
    assert setup.bed.mean() == pytest.approx(0.656, abs=0.02) and bad(setup) == []
    part = measure(frames(rng, tilted(SMALL)), SMALL, UNIT, window=(60, 40, 80, 60))
    assert part.look.camera == SMALL and part.bed.mean() == pytest.approx(0.25, abs=0.02)


@pytest.fixture(scope="module")
def good():
    return check(np.random.default_rng(1), tilted(SMALL))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"valid": 0.7}, "at least 90% are needed: look for glare, things too near, dark material"),
        ({"valid": 0.7, "missing_at": "left"}, "most are missing at the left side: shade it"),
        ({"noise_mm": 3.1, "expected_mm": 3.0}, "at most 3 mm: move it nearer"),
        ({"noise_mm": 1.2}, "turn the camera away from the window, give more even light or textu"),
        ({"flat": 0.3}, "is no level bed: level it, or cut it out with --window"),
        ({"residual_mm": 4.0}, "at most 3 mm: level it"),
        ({"tilt_deg": 50.0}, "at most 45: raise it by 5 degrees"),
        ({"inside": 0.5}, "at least 99%: move the camera, or state another --depth-range"),
        (
            {"bed": np.eye(160, dtype=bool)[:120]},
            "mm nearer it would fill the frame; move it there",
        ),
    ],
)
def test_each_thing_that_is_wrong_is_one_sentence(wrong, sentence, good):
    assert bad(good) == []
    (said,) = bad(good._replace(**wrong))
    assert sentence in said


@pytest.mark.full
def test_what_has_no_reading_is_counted_and_where(rng):
    flat, u = tilted(SMALL), np.arange(160)
    some = check(rng, np.where((rng.random(SMALL.shape) < 0.4) & (u > 80), 0.0, flat))
    assert some.valid == pytest.approx(0.8, abs=0.01) and some.missing_at == "right"
    blind = check(rng, np.where(u < 60, 0.0, flat))
    assert blind.valid == pytest.approx(0.624, abs=0.002) and blind.missing_at == "left"


def test_the_range_becomes_the_beds_unless_it_was_asked_for(rng, good):
    far = frames(rng, tilted(SMALL, distance=0.6), 3)
    assert measure(far, SMALL, UNIT, keep_range=True).inside == 0.0
    setup = measure(far, SMALL, UNIT)
    z_min, z_max = (float(z) for z in (setup.look.camera.z_min, setup.look.camera.z_max))
    assert (z_min, z_max) == pytest.approx((0.5, 0.66), abs=3e-3) and bad(setup) == []
    assert "not 0.45 m away" in verdict(setup)[-1][1]
    assert good.look.camera == SMALL


@pytest.mark.full
def test_how_much_nearer_is_said(rng):
    depth = np.full(WIDE.shape, 1.2)
    depth[40:80, 55:105] = 0.9  # a ninth of the view
    setup = check(rng, depth, replace(WIDE, z_max=2.0), noise=0.0018)
    assert setup.bed.mean() == pytest.approx(2000 / 19200, abs=0.01)
    said = [sentence for _, sentence in verdict(setup)]
    assert any(s.startswith(("550 mm nearer", "560 mm nearer")) for s in said)
    # It grows with the square of the distance.
    less = 10 * round(90 * (1 - (0.9 / setup.noise_mm) ** 0.5))
    assert f"noise above 0.9 mm ({less} mm nearer it is less)" in said[-1]


def test_a_frozen_stream_is_said_and_a_still_picture_is_not(rng):
    same = np.repeat(frames(rng, tilted(SMALL), 1), 5, 0)
    (frozen,) = bad(measure(same, SMALL, UNIT))
    assert frozen == "all frames are the same to the bit; the stream is frozen"
    assert bad(measure(same, SMALL, UNIT, still=True)) == []
    one = measure(same[:1], SMALL, UNIT)
    assert np.isnan(one.noise_mm) and not one.frozen and bad(one) == []


def test_a_camera_that_moves_is_refused(rng):
    first, last = frames(rng, tilted(SMALL)), frames(rng, tilted(SMALL, distance=0.454))
    with pytest.raises(BadImage, match="lies 4.0 mm elsewhere in the last frames than in the fir"):
        measure(np.concatenate([first, last]), SMALL, UNIT)
    turned = frames(rng, tilted(SMALL, 2.0))
    with pytest.raises(BadImage, match="the camera or the bed moved; let both rest"):
        measure(np.concatenate([first, turned]), SMALL, UNIT)


def test_frames_that_cannot_be_measured():
    with pytest.raises(BadImage, match="has 2x2 pixels; the camera makes 160x120"):
        measure(np.ones((3, 2, 2), np.uint16), SMALL, UNIT)
    with pytest.raises(BadImage, match="no pixel has a reading"):
        measure(np.zeros((3, *SMALL.shape), np.uint16), SMALL, UNIT)


@pytest.mark.full
def test_coarse_counts_and_the_papers_camera(rng):
    """A whole D435 frame in millimetres, as the device sends it by default."""
    setup = check(rng, tilted(D435_BAZAR, 1.0), D435_BAZAR, noise=0.0006, unit=1e-3)
    assert setup.tilt_deg == pytest.approx(1.0, abs=0.02)
    assert setup.noise_mm == pytest.approx(0.6, rel=0.15) and bad(setup) == []


@pytest.mark.full
def test_a_wrong_pose_is_said(rng):
    camera = standing(30)
    stack = frames(rng, seen_by(camera), 3)
    assert bad(measure(stack, camera, UNIT), in_base=True) == []
    (wrong,) = bad(measure(stack, replace(camera, pose=standing(10).pose), UNIT), in_base=True)
    assert wrong.startswith("by the camera's pose the bed is 20.") and "is the pose wrong" in wrong


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_is_set_up_by_the_command(name, tmp_path, rng, monkeypatch, capsys):
    make, unit = CAMERAS[name]
    opened = make(tmp_path, scene(rng, unit))
    monkeypatch.setattr("jshape.cli.setup.opened", lambda *_: opened)
    out = tmp_path / "found" / "camera.json"
    out.parent.mkdir()
    words = ["setup", "it", "--frames", "6", "--out", str(out)]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["frames"] == (1 if name == "picture" else 6) and said["good"]
    assert said["tilt_deg"] == pytest.approx(2.4, abs=0.3)  # 20 mm over 480
    assert read_camera(out) == (opened.camera, unit)
    np.testing.assert_allclose(np.array(read_bed(out))[2, 3], 0.45, atol=2e-3)
    assert cv2.imread(str(out.with_suffix(".setup.png"))).std() > 20
    assert main(words) == 2 and "exists" in capsys.readouterr().err


def test_maps_lie_over_the_bed_that_was_set_up(tmp_path, monkeypatch, capsys):
    """Whatever is molded in between; unless the camera moved."""
    monkeypatch.chdir(tmp_path)
    camera = standing(30)
    write_camera("mine.json", replace(camera, pose=None), UNIT)
    heap = bed(of=lambda x, y: 0.03 * np.exp(-(x**2 + y**2) / 0.005))
    nearer = standing(30, 0.43)
    for name, eye, of in (("level", camera, bed()), ("heap", camera, heap), ("low", nearer, heap)):
        write_depth_png(f"{name}.png", seen_by(eye, of), UNIT)
    assert main(["setup", "level.png", "--camera-file", "mine.json", "--out", "camera.json"]) == 0
    out = capsys.readouterr().out
    assert "tilted by 30.0 degrees" in out and out.endswith(
        "camera.json; picture: camera.setup.png\n"
    )
    assert main(["heightmap", "heap.png", "--out", "a.npz", "--camera-file", "camera.json"]) == 0
    assert np.array(read_map("a.npz").frame) == pytest.approx(np.array(read_bed("camera.json")))
    assert main(["heightmap", "low.png", "--out", "b.npz", "--camera-file", "camera.json"]) == 2
    err = capsys.readouterr().err
    assert "it lay in camera.json (bed), turned by 0.1 degrees: did the camera move?" in err
    assert err.count("\n") == 1
    write_camera("bad.json", camera, UNIT, as_frame(2 * np.eye(4)))
    with pytest.raises(BadCamera, match="bad.json: bed is .*; it must be the 4x4 matrix"):
        read_bed("bad.json")


REFUSED = {
    "no plane": ("the bed's plane is not found", "noise.png", "--camera-file", "c.json"),
    "another unit": ("0.0001 would fit: --depth-unit 0.0001", "now.png", "--camera-file",
                     "mm.json"),
    "no json": ("a camera's file ends in .json", "sim", "--out", "camera.txt"),
    "no pose": ("has 0 of T_base_camera", "now.png", "--camera-file", "c.json", "--base", "p.json"),
    "a window": ("leaves the 160x120 image", "now.png", "--camera-file", "c.json", "--window",
                 "0,0,999x9"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_one_line(case, tmp_path, monkeypatch, rng, capsys):
    monkeypatch.chdir(tmp_path)
    write_camera("c.json", WIDE, UNIT)
    write_camera("mm.json", WIDE, 1e-3)
    (tmp_path / "p.json").write_text('{"format": "jshape-pose", "version": 1}')
    write_depth_png("now.png", seen_by(standing(30)), UNIT)
    write_depth_png("noise.png", rng.uniform(0.3, 0.7, WIDE.shape), UNIT)
    match, *words = REFUSED[case]
    assert main(["setup", *words]) == 2
    out, err = capsys.readouterr()
    assert match in err and err.count("\n") == 1 and out == ""


@pytest.mark.full
@pytest.mark.parametrize(
    ("file", "camera", "unit", "tilt", "size", "share"),
    [
        ("realsense_sr300/background-0.depth.png", SR300, 1e-4, 34.2, (0.41, 0.6), 0.4),
        ("sand/kinect_v2_raw.npy", KINECT, 1e-3, 2.8, (1.17, 1.2), 0.61),
    ],
)
def test_real_frames(file, camera, unit, tilt, size, share, shared_data):
    """A bin from the side; a sandbox with a board at its rim."""
    setup = measure(read_array(shared_data / "real" / file)[None], camera, unit, still=True)
    assert setup.tilt_deg == pytest.approx(tilt, abs=0.5)
    assert [np.ptp(a) for a in (setup.map.x, setup.map.y)] == pytest.approx(size, abs=0.03)
    assert setup.bed.mean() == pytest.approx(share, abs=0.03) and setup.valid > 0.95
    assert len(bad(setup)) == 1  # the SR300's waves; the sand is not level
    assert png(setup_figure(setup.look.depth, setup.bed, setup.map, "real")).startswith(b"\x89PNG")
