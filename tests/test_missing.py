"""Filling pixels without a reading: the readings stay, the fill is near, too much is refused."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from jshape.data.missing import fill_missing, missing
from jshape.errors import BadImage, MissingDepth


def bed(rng, shape=(480, 848)):
    """A smooth bed 0.45 m away with bumps of a centimetre."""
    noise = [ndimage.gaussian_filter(rng.standard_normal(shape), s) * 2 * s for s in (25, 6)]
    return (0.45 + 0.01 * noise[0] + 0.002 * noise[1]).astype(np.float32)


def holes(rng, kind, shape=(480, 848), share=0.05):
    if kind == "pixels":
        return rng.random(shape) < share
    field = ndimage.gaussian_filter(rng.standard_normal(shape), 6)
    return field > np.quantile(field, 1 - share)


def nearest(depth, mask):
    index = ndimage.distance_transform_edt(mask, return_distances=False, return_indices=True)
    return depth[tuple(index)]


@pytest.mark.parametrize("noise_mm", [0.0, 0.45])
@pytest.mark.parametrize("kind, mean_mm", [("pixels", 0.02), ("blobs", 0.5)])
def test_the_fill_is_near_and_beats_the_nearest_reading(rng, kind, mean_mm, noise_mm):
    truth = bed(rng)
    seen = truth + (noise_mm * 1e-3 * rng.standard_normal(truth.shape)).astype(np.float32)
    mask = holes(rng, kind)
    started = time.perf_counter()
    filled, count = fill_missing(np.where(mask, np.nan, seen))
    assert time.perf_counter() - started < 2  # it takes 0.04 s
    error = 1e3 * np.abs(filled - truth)[mask].mean()
    assert error < mean_mm + 0.5 * noise_mm
    assert error < 0.8 * 1e3 * np.abs(nearest(seen, mask) - truth)[mask].mean()
    assert count == mask.sum()
    np.testing.assert_array_equal(filled[~mask], seen[~mask])


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf, -np.inf, -1.0])
def test_every_sign_of_no_reading_is_filled(nothing):
    depth = np.full((6, 7), 0.5, np.float32)
    depth[2, 3] = depth[0, 0] = depth[5, 6] = nothing
    assert missing(depth).sum() == 3
    filled, count = fill_missing(depth)
    assert count == 3 and filled.dtype == np.float32
    np.testing.assert_allclose(filled, 0.5, rtol=1e-6)


@settings(deadline=None, max_examples=50)
@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, max_side=9),
        elements=st.just(0.0) | st.floats(np.float32(0.1), 2, width=32),
    )
)
def test_the_readings_stay_and_the_fill_is_between_them(depth):
    mask = depth == 0
    if mask.all():
        with pytest.raises(MissingDepth):
            fill_missing(depth, limit=1.0)
        return
    before = depth.copy()
    filled, count = fill_missing(depth, limit=1.0)
    np.testing.assert_array_equal(depth, before)
    np.testing.assert_array_equal(filled[~mask], depth[~mask])
    assert count == mask.sum()
    low, high = depth[~mask].min(), depth[~mask].max()
    assert (filled >= low * (1 - 1e-5)).all() and (filled <= high * (1 + 1e-5)).all()


def test_a_plane_is_filled_exactly(rng):
    v, u = np.mgrid[:40, :50]
    plane = (0.4 + 0.001 * u + 0.002 * v).astype(np.float32)
    holed = plane.copy()
    holed[10:20, 12:25] = 0
    np.testing.assert_allclose(fill_missing(holed)[0], plane, rtol=1e-6)


def test_nothing_missing_is_a_copy():
    depth = np.full((4, 5), 0.4)
    filled, count = fill_missing(depth)
    assert count == 0 and filled.dtype == np.float32
    filled[:] = 1
    assert depth[0, 0] == 0.4


def test_too_much_missing_is_refused_with_figures():
    depth = np.full((395, 480), 0.45, np.float32)
    depth.ravel()[:67_000] = 0
    with pytest.raises(MissingDepth) as info:
        fill_missing(depth, where="goal.png")
    assert str(info.value) == (
        "goal.png: 35.3 % of the pixels (67,000 of 189,600) have no depth reading; "
        "at most 10 % can be filled"
    )
    assert fill_missing(depth, limit=0.5)[1] == 67_000


def test_the_limit_itself_is_allowed():
    depth = np.full((10, 10), 0.45)
    depth[0] = 0
    assert fill_missing(depth, limit=0.1)[1] == 10
    with pytest.raises(MissingDepth):
        fill_missing(depth, limit=0.09)
    with pytest.raises(MissingDepth):
        fill_missing(depth, limit=0.0)


@pytest.mark.parametrize(
    "depth",
    [np.zeros((0, 4)), np.ones(5), np.ones((2, 3, 4)), np.ones((2, 2), complex),
     np.full((2, 2), None), np.array([["a"]])],
    ids=lambda d: f"{d.dtype}{d.shape}",
)  # fmt: skip
def test_what_is_no_image_is_refused(depth):
    with pytest.raises(BadImage) as info:
        fill_missing(depth, where="here")
    assert str(info.value).startswith("here: ") and "\n" not in str(info.value)
