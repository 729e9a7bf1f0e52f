"""The check of a set-up: measured on beds whose tilt, noise and roughness are known."""

from dataclasses import replace

import numpy as np
import pytest

from jshape import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.camera_check import measure, verdict
from jshape.errors import BadImage
from jshape.io.images import read_counts

SMALL = Camera(160, 120, 145.0, 140.0, 70.0, 66.0, 0.42, 0.47)
UNIT = 1e-4


def tilted(camera, tilt_u=0.0, tilt_v=0.0, distance=0.45):
    """Depth of a plane through (0, 0, distance), its normal turned, in plain trigonometry."""
    a, b = np.tan(np.radians([tilt_u, tilt_v]))
    x = (np.arange(camera.width) - camera.u0) / camera.fx
    y = ((np.arange(camera.height) - camera.v0) / camera.fy)[:, None]
    # z = distance + a X + b Y with X = x z, Y = y z.
    return distance / (1.0 - a * x - b * y)


def frames(rng, depth, count=40, noise=0.00045, holes=0.002, unit=UNIT):
    noisy = depth + rng.normal(0, noise, (count, *depth.shape))
    counts = np.rint(np.where(depth > 0, noisy, 0.0) / unit).astype(np.uint16)
    counts[rng.random(counts.shape) < holes] = 0
    return counts


def check(rng, depth, camera=SMALL, **options):
    unit = options.get("unit", UNIT)
    return measure(frames(rng, depth, **options), camera, unit).setup


def says(setup, camera=SMALL):
    found = verdict(setup, camera)
    assert all("\n" not in sentence for _, sentence in found)
    return [sentence for good, sentence in found if not good]


def test_a_good_set_up_is_measured_and_called_good(rng):
    setup = check(rng, tilted(SMALL) + rng.normal(0, 0.0015, SMALL.shape))
    assert setup.frames == 40 and not setup.frozen
    assert setup.valid == pytest.approx(0.998, abs=0.001)
    assert setup.noise_mm == pytest.approx(0.45, rel=0.03)
    assert setup.residual_mm == pytest.approx(1.5, rel=0.05)
    assert setup.tilt_deg < 0.1 and setup.distance == pytest.approx(0.45, abs=1e-4)
    assert setup.flat > 0.999 and setup.inside == 1.0
    assert says(setup) == []


@pytest.mark.parametrize("tilt", [(1.0, 0.0), (0.0, -3.0), (4.0, 2.0), (-10.0, 5.0)])
def test_the_tilt_is_the_angle_against_the_image_plane(tilt, rng):
    setup = check(rng, tilted(SMALL, *tilt), count=10)
    a, b = np.tan(np.radians(tilt))
    expected = np.degrees(np.arctan(np.hypot(a, b)))
    assert setup.tilt_deg == pytest.approx(expected, abs=0.02)
    assert setup.tilt_towards == pytest.approx(tilt, abs=0.03)
    assert setup.residual_mm < 0.3, "a tilted plane is a plane"


@pytest.mark.parametrize(
    "tilt, side", [((3, 0), "right"), ((-3, 0), "left"), ((0, 3), "lower"), ((1, -3), "upper")]
)
def test_the_side_to_mend_is_named(tilt, side, rng):
    setup = check(rng, tilted(SMALL, *tilt), count=4)
    (tilted_, *_) = says(setup)
    assert f"the {side} side is farther away" in tilted_


def test_walls_and_a_table_do_not_pull_the_plane(rng):
    depth = tilted(SMALL, 1.0, 0.5)
    depth[:, :40] = 0.60  # the table beside the box: a quarter of the view
    depth[:15, 40:] = 0.38
    setup = check(rng, depth, count=10)
    assert setup.tilt_deg == pytest.approx(np.hypot(1.0, 0.5), abs=0.05)
    assert setup.flat == pytest.approx(0.656, abs=0.01) and says(setup) == []


def test_each_thing_that_is_wrong_is_said(rng):
    flat = tilted(SMALL)
    some = rng.random(SMALL.shape) < 0.6
    (missing,) = says(check(rng, np.where(some, 0.0, flat), count=6, noise=0.0004))
    assert missing.startswith("40.6% of the pixels") and "at least 90% are needed" in missing
    (noise,) = says(check(rng, flat, noise=0.002))
    assert "varies by 1.98" in noise and "at most 0.9 mm" in noise
    (rough,) = says(check(rng, flat + rng.normal(0, 0.004, SMALL.shape), count=6))
    assert "deviates from that plane by" in rough and "level the bed" in rough
    far = says(check(rng, tilted(SMALL, distance=0.6), count=6))
    assert len(far) == 1 and "0.600 m on average" in far[0] and "--depth-range" in far[0]
    hills = 0.45 + 0.05 * rng.standard_normal(SMALL.shape)
    wild = check(rng, hills, count=6)
    assert any("no bed that fills the view" in sentence for sentence in says(wild))
    assert not any("tilted" in sentence for _, sentence in verdict(wild, SMALL)), "of what?"


def test_another_depth_range_is_taken_at_its_word(rng):
    higher = replace(SMALL, z_min=0.5, z_max=0.7)
    setup = check(rng, tilted(SMALL, distance=0.6), higher, count=6)
    assert setup.inside == 1.0 and says(setup, higher) == []
    assert "(not 0.45: plans look from there)" in verdict(setup, higher)[-1][1]


def test_a_frozen_stream_is_said_and_a_still_picture_is_not(rng):
    same = np.repeat(frames(rng, tilted(SMALL), 1), 5, 0)
    (frozen,) = says(measure(same, SMALL, UNIT).setup)
    assert frozen == "all frames are the same to the bit; the stream is frozen"
    assert says(measure(same, SMALL, UNIT, still=True).setup) == []
    one = measure(same[:1], SMALL, UNIT).setup
    assert np.isnan(one.noise_mm) and not one.frozen and says(one) == []


def test_the_images_are_those_of_the_numbers(rng):
    depth = tilted(SMALL)
    stack = frames(rng, depth, 20, holes=0.0)
    stack[:, 3, 4] = 0
    stack[1:, 5, 6] = 0
    stack[:, 50:60, 50:60] -= 50  # 5 mm towards the camera
    found = measure(stack, SMALL, UNIT)
    assert np.isnan(found.depth[3, 4]) and np.isnan(found.noise[[3, 5], [4, 6]]).all()
    assert np.isfinite(found.depth[5, 6])
    np.testing.assert_allclose(found.off[50:60, 50:60].mean(), 5.0, atol=0.15)
    plain = stack[:, 100:110].astype(float)
    np.testing.assert_allclose(found.depth[100:110], plain.mean(0) * UNIT, rtol=1e-6)
    np.testing.assert_allclose(found.noise[100:110], plain.std(0, ddof=1) * 0.1, rtol=1e-4)


def test_coarse_counts_and_the_papers_camera(rng):
    """A whole D435 frame in millimetres, as the device sends it by default."""
    setup = check(rng, tilted(D435_BAZAR, 1.0), D435_BAZAR, count=8, noise=0.001, unit=1e-3)
    assert setup.tilt_deg == pytest.approx(1.0, abs=0.02)
    assert setup.noise_mm == pytest.approx(1.0, rel=0.1)  # and 0.29 of rounding


def test_frames_that_cannot_be_measured():
    with pytest.raises(BadImage, match=r"frames have \(2, 2\) .*expected \(395, 480\)"):
        measure(np.ones((3, 2, 2), np.uint16), PAPER_BOX, UNIT)
    with pytest.raises(BadImage, match="0 pixels have a reading; a plane needs 100"):
        measure(np.zeros((3, *SMALL.shape), np.uint16), SMALL, UNIT)


def test_a_real_camera_at_a_slant(shared_data):
    """One real frame of an SR300 that looks at a bin from the side, a third of it missing."""
    folder = shared_data / "real" / "realsense_sr300"
    k = np.loadtxt(folder / "camera-0.intrinsics.txt")
    camera = Camera(640, 480, k[0, 0], k[1, 1], k[0, 2], k[1, 2], 0.5, 1.0)
    setup = measure(read_counts(folder / "background-0.depth.png")[None], camera, 1e-4).setup
    assert 0.6 < setup.valid < 0.7 and 30 < setup.tilt_deg < 40 and setup.tilt_towards[1] < -30
    bad = says(setup, camera)
    assert len(bad) == 3 and "the upper side is farther away" in bad[-1]
