"""Filling pixels without a reading: the readings stay, the fill is near, too much is refused."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from jshape.data.missing import fill_missing, missing, readings, said
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


BED = np.linspace(4000, 5000, 10_000).reshape(100, 100)


def marked(kind, values):
    """A bed (100, 100) of counts, 100 pixels of it without a reading in the given way."""
    bed = BED.astype(kind) if np.dtype(kind).kind == "u" else (BED * 1e-4).astype(kind)
    part = bed[10:20, 10:20].reshape(-1)
    part[:] = np.resize(np.array(values, float).astype(kind), 100)
    bed[10:20, 10:20] = part.reshape(10, 10)
    return bed


@pytest.mark.parametrize(
    "kind, values, reasons",
    [
        ("u2", [0], {"0": 100}),
        ("u2", [65535], {"at 65535 (the largest uint16)": 100}),
        ("u4", [2**32 - 1], {"at 4294967295 (the largest uint32)": 100}),
        ("u2", [10_000], {"at 10000 (far beyond all others)": 100}),
        (
            "u2",
            [32001, 32002],
            {"at 32001 (far beyond all others)": 50, "at 32002 (far beyond all others)": 50},
        ),
        ("u2", [1], {"at 1 (far beyond all others)": 100}),
        ("f4", [np.nan, np.inf, -np.inf, -0.5], {"negative": 50, "not finite": 50}),
        ("f4", [3.4028235e38], {"not finite": 100}),
        ("f8", [1e300, 65.535], {"not finite": 50, "at 65.535 (far beyond all others)": 50}),
        ("f4", [0.0, -9999.0], {"0": 50, "negative": 50}),
    ],
)
@pytest.mark.filterwarnings("error")
def test_each_way_to_say_no_reading_is_left_out_and_said(kind, values, reasons):
    found = readings(marked(kind, values))
    expected = np.ones((100, 100), bool)
    expected[10:20, 10:20] = False
    np.testing.assert_array_equal(found.there, expected)
    assert found.left_out == reasons


def test_a_mask_says_no_reading():
    mask = np.zeros(BED.shape, bool)
    mask[10:20, 10:20] = True
    for bed in (BED.astype(np.uint16), BED.astype(np.float32) * 1e-4):
        found = readings(np.ma.array(bed, mask=mask))
        np.testing.assert_array_equal(found.there, ~mask)
        assert found.left_out == {"masked or NODATA": 100}
        assert said(found.left_out) == " (of them 100 masked or NODATA)"


@pytest.mark.parametrize(
    "change",
    [
        lambda bed: np.where(BED < 4010, 7900, bed),  # a table far below
        lambda bed: np.where(np.arange(10_000).reshape(100, 100) < 15, 60_000, bed),  # flying
        lambda bed: np.where(BED < 4600, 10_000, bed),  # most of the view is the floor
        lambda bed: np.where(BED < 4010, np.arange(12_000, 22_000).reshape(100, 100), bed),
    ],
)
def test_surroundings_and_flying_pixels_are_readings(change):
    assert readings(change(BED).astype(np.uint16)).left_out == {}


def test_only_what_is_odd_is_said():
    assert said({"0": 5, "not finite": 7}) == ""
    assert said({"0": 5, "at 65535 (the largest uint16)": 2262}) == (
        " (of them 2,262 at 65535 (the largest uint16))"
    )
