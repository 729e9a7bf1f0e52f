"""The camera model: Eq. depth, pinhole, PtoI."""

import copy
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import D435_BAZAR, D435_NOMINAL, PAPER_BOX, Camera
from jshape.camera import check_camera, window_of
from jshape.errors import BadCamera

SMALL = Camera(12, 9, 20.0, 22.0, 5.5, 4.0, 0.40, 0.50)


def points_by_hand(camera, luminance):
    """Eq. depth and pinhole, pixel by pixel, float64."""
    cloud = np.zeros((*luminance.shape, 3))
    for v in range(luminance.shape[0]):
        for u in range(luminance.shape[1]):
            z = (camera.z_min - camera.z_max) / (2**camera.bits - 1) * luminance[v, u]
            z += camera.z_max
            cloud[v, u] = (u - camera.u0) / camera.fx * z, (v - camera.v0) / camera.fy * z, z
    return cloud


def test_presets_have_the_papers_numbers():
    assert (D435_NOMINAL.width, D435_NOMINAL.height) == (848, 480)
    assert (D435_BAZAR.fx, D435_BAZAR.u0, D435_BAZAR.v0) == (433.0, 421.0, 243.0)
    assert (PAPER_BOX.shape, PAPER_BOX.u0, PAPER_BOX.v0) == ((395, 480), 240.0, 197.0)


@pytest.mark.parametrize("bits", [8, 16])
def test_luminance_round_trip_is_exact(bits, rng):
    camera = replace(SMALL, bits=bits)
    luminance = rng.integers(0, 2**bits, camera.shape)
    back = camera.luminance(camera.depth(luminance))
    np.testing.assert_array_equal(back, luminance)


@pytest.mark.parametrize("bits", [1, 8, 12, 16])
def test_luminance_clips_at_both_ends_for_any_depth_of_bits(bits):
    camera = replace(SMALL, bits=bits)
    level = camera.luminance(np.array([0.01, 0.40, 0.50, 9.0]))
    np.testing.assert_array_equal(level, [2**bits - 1] * 2 + [0] * 2)


def test_no_reading_is_never_a_luminance():
    level = np.asarray(SMALL.luminance(np.array([0.0, np.nan, np.inf, -0.1, 0.45])))
    assert np.isnan(level[:4]).all() and np.isfinite(level[4])


def test_luminance_keeps_fractions_when_asked():
    z = 0.4503
    exact = 255 * (0.50 - z) / 0.10
    np.testing.assert_allclose(SMALL.luminance(z, quantize=False), exact, atol=1e-3)
    assert float(SMALL.luminance(z)) == round(exact)


def test_points_equal_a_pixel_by_pixel_transcription(rng):
    luminance = rng.integers(0, 256, SMALL.shape)
    np.testing.assert_allclose(SMALL.points(luminance), points_by_hand(SMALL, luminance), atol=1e-6)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**31), bits=st.sampled_from([8, 16]))
def test_project_inverts_points(seed, bits):
    camera = replace(SMALL, bits=bits)
    luminance = np.random.default_rng(seed).integers(0, 2**bits, camera.shape)
    cloud = np.asarray(camera.points(luminance)).reshape(-1, 3)
    np.testing.assert_array_equal(camera.project(cloud), luminance)


def test_project_lets_the_nearest_point_win_and_drops_the_unseen():
    centre = [[(5 - 5.5) / 20 * z, 0.0, z] for z in (0.45, 0.42, 0.48)]
    unseen = [[9.0, 0, 0.45], [-9.0, 0, 0.45], [0, -9.0, 0.45], [0, 0, -0.45], [np.nan, 0, 0.45]]
    image = np.asarray(SMALL.project(np.array(centre + unseen)))
    assert image[4, 5] == np.asarray(SMALL.luminance(0.42))
    assert np.count_nonzero(image) == 1


def test_crop_sees_the_same_points(rng):
    luminance = rng.integers(0, 256, SMALL.shape)
    window = SMALL.crop(3, 2, 6, 5)
    np.testing.assert_allclose(
        window.points(luminance[2:7, 3:9]), SMALL.points(luminance)[2:7, 3:9], atol=1e-6
    )
    assert window_of(window, SMALL) == (3, 2)
    assert window_of(SMALL, window) is None
    assert window_of(replace(window, fx=21.0), SMALL) is None


@pytest.mark.parametrize("window", [(-1, 0, 5, 5), (0, 0, 13, 5), (0, 5, 5, 5), (0, 0, 0, 5)])
def test_crop_outside_is_refused(window):
    with pytest.raises(BadCamera, match="leaves the 12x9 image"):
        SMALL.crop(*window)


@pytest.mark.parametrize(
    ("field", "value"),
    [("fx", -1.0), ("fy", 0.0), ("u0", np.nan), ("z_min", 0.6), ("width", 0), ("bits", 40)]
    + [("fx", "433"), ("v0", None), ("height", 9.5), ("fx", True)],
)
def test_check_camera_names_the_bad_field(field, value):
    bad = copy.copy(SMALL)
    object.__setattr__(bad, field, value)  # as a user's script could; the tests check types
    with pytest.raises(BadCamera, match=field):
        check_camera(bad)
    assert check_camera(SMALL) is SMALL


def test_numbers_do_not_recompile_but_sizes_do():
    seen = []

    @jax.jit
    def trace(camera):
        seen.append(camera)
        return camera.points(np.zeros(camera.shape, np.float32)).sum()

    trace(SMALL)
    trace(replace(SMALL, fx=400.0, z_max=0.7))
    assert len(seen) == 1
    trace(replace(SMALL, width=13))
    assert len(seen) == 2
