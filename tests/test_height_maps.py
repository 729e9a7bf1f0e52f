"""Height maps of rendered beds: as the bed is, in the promised frame; or one clear line."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.views import aimed, off, truth_of
from jshape import Camera, HeightMap, heightmap, load_bank, metric, options, plan, sim
from jshape.camera import check_camera
from jshape.errors import BadCamera, BadImage
from jshape.height_map import map_of
from jshape.reproject import reproject

D435 = Camera(424, 240, 216.5, 216.5, 211.5, 119.5, 0.1, 2.0, bits=16)
"""Half of its resolution."""
SMALL = Camera(60, 49, 54.0, 54.0, 29.5, 24.0, 0.42, 0.47)
QUICK = options(
    stride=6, strengths=(0.5, 1.0), yaws=1, max_steps=2, min_gain_mm=0.0, error_margin=0.0
)


@pytest.fixture(scope="module")
def hills():
    return sim.irregular_bed(jax.random.key(0), 0.006)


@pytest.fixture(scope="module")
def mound():
    flat = sim.flat_bed()
    x, y = flat.axes()
    r2 = x[None, :] ** 2 + y[:, None] ** 2
    return sim.loose_bed(flat.height + 0.04 * np.exp(-r2 / 0.05**2).astype("f4"))


def at(tilt, distance=0.45):
    return replace(D435, pose=aimed(tilt, distance))


def seen(bed, camera, noise=None):
    depth = sim.render(bed, camera)
    return np.asarray(depth if noise is None else sim.sensor(jax.random.key(noise), depth))


# --- One camera ---------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [0, 15, 30, 45])
def test_the_plane_is_found_and_the_frame_is_as_promised(tilt):
    camera = at(tilt)
    found = heightmap(seen(sim.flat_bed(), camera, noise=1), replace(camera, pose=None))
    frame = np.array(found.frame)
    x, y, z, origin = frame[:3].T
    angle = np.degrees(np.arccos(-z[2]))
    assert abs(angle - tilt) < 0.1
    np.testing.assert_allclose(np.cross(x, y), z, atol=1e-6)  # right-handed
    assert x[0] > 0.99 and abs(x[1]) < 0.01  # along u
    assert y[1] < -0.7  # against v
    assert z[2] < -0.7  # towards the camera
    np.testing.assert_allclose(origin, (0, 0, 0.45), atol=1e-3)  # on the optical axis
    assert np.abs(np.median(np.asarray(found.heights)[found.mask])) < 2e-4


def test_rows_run_along_y_and_columns_along_x():
    """A heap at the upper right of the image lies where x and y are positive."""
    flat = sim.flat_bed()
    x, y = flat.axes()
    r2 = (x[None, :] - 0.08) ** 2 + (y[:, None] + 0.05) ** 2
    heap = sim.loose_bed(flat.height + 0.02 * np.exp(-r2 / 0.02**2).astype("f4"))
    found = heightmap(seen(heap, at(20)), replace(at(20), pose=None))
    row, column = np.unravel_index(np.nanargmax(found.heights), np.shape(found.heights))
    np.testing.assert_allclose((found.x[column], found.y[row]), (0.08, 0.05), atol=3e-3)
    assert 0.0185 < np.nanmax(found.heights) < 0.0205


@pytest.mark.parametrize("tilt", [0, 30])
def test_heights_are_those_of_the_bed(tilt, hills):
    truth, camera = truth_of(hills), at(tilt, 0.5)
    median, most, share = off(heightmap(seen(hills, camera), camera, like=truth), truth)
    assert median <= 0.15 and most <= 0.5 and share > 0.95
    median, most, share = off(heightmap(seen(hills, camera, noise=1), camera, like=truth), truth)
    assert median <= 0.5 and share > 0.95


def test_the_mean_of_frames_has_less_noise(hills):
    truth, camera = truth_of(hills), at(30, 0.5)
    frames = np.stack([seen(hills, camera, noise) for noise in range(9)])
    one, nine = (off(heightmap(f, camera, like=truth), truth) for f in (frames[0], frames))
    assert nine[0] < 0.45 * one[0]  # a third, and what is off without noise
    counts = np.asarray(sim.to_uint16(frames))
    again = off(heightmap(counts, camera, depth_unit=1e-4, like=truth), truth)
    np.testing.assert_allclose(again, nine, atol=0.02)


def test_a_window_leaves_the_surroundings_out(hills):
    camera = replace(at(20), pose=None)
    depth = seen(hills, at(20))
    whole = heightmap(depth, camera)
    part = heightmap(depth, camera, window=(140, 80, 140, 80))
    sides = [np.array(np.shape(m.heights)) * m.pitch for m in (whole, part)]
    assert (sides[1] < 0.6 * sides[0]).all()  # the whole is the box: 0.45 by 0.56 m
    np.testing.assert_allclose(sides[1], (0.18, 0.29), rtol=0.15)  # of 80 by 140 pixels


def test_a_later_look_has_the_grid_of_the_first(hills):
    camera = replace(at(30), pose=None)
    first = heightmap(seen(sim.flat_bed(), at(30)), camera)
    later = heightmap(seen(hills, at(30), noise=1), camera, like=first)  # molded all over
    assert np.shape(later.heights) == np.shape(first.heights)
    assert later.frame == first.frame and later.pitch == pytest.approx(first.pitch)
    np.testing.assert_allclose(later.origin, first.origin, atol=1e-6)
    assert np.nanstd(later.heights) > 0.004


def test_a_bed_of_about_the_same_size_compiles_nothing(hills):
    """Up to the next multiple of 32 nodes, and it is seen the same."""
    camera, depth, whole = at(30), seen(hills, at(30)), truth_of(hills)
    part = HeightMap(np.asarray(whole.heights)[:-5, :-20], whole.pitch, whole.origin,
                     None, whole.frame)  # fmt: skip
    one, before = heightmap(depth, camera, like=whole), reproject._cache_size()
    other = heightmap(depth, camera, like=part)
    assert reproject._cache_size() == before
    both = one.mask[:-5, :-20] & other.mask
    gap = (np.asarray(one.heights)[:-5, :-20] - np.asarray(other.heights))[both]
    assert both.mean() > 0.95 and np.abs(gap).max() < 1e-6


# --- Two cameras --------------------------------------------------------------------------------


def test_two_cameras_see_behind_a_mound_and_with_less_noise(mound):
    truth, cameras = truth_of(mound), [at(30, 0.6), at(-30, 0.6)]
    depths = [seen(mound, camera, noise) for noise, camera in enumerate(cameras)]
    one = heightmap(depths[0], cameras[0], like=truth)
    two = heightmap(depths, cameras, like=truth)
    assert two.mask.mean() >= 0.99
    assert off(two, truth)[0] < 0.8 * off(one, truth)[0]  # sqrt(1/2), and what is not noise


# --- One clear line each ------------------------------------------------------------------------


def test_a_camera_that_moved_is_told(hills):
    camera = replace(at(30), pose=None)
    first = heightmap(seen(hills, at(30)), camera)
    # 12 mm back along its axis are 10.4 mm of height, at 30 degrees.
    with pytest.raises(BadCamera, match=r"lies 10\.\d mm from where it .*the look before"):
        heightmap(seen(hills, at(30, 0.462)), camera, like=first)
    with pytest.raises(BadCamera, match="did the camera move"):
        heightmap(seen(hills, at(35)), camera, like=first)


def test_a_wrong_pose_is_told(hills):
    cameras = [at(30), at(-30)]
    depths = [seen(hills, camera) for camera in cameras]
    wrong = np.array(cameras[1].pose)
    wrong[2, 3] += 0.02
    wrong = replace(cameras[1], pose=tuple(map(tuple, wrong.tolist())))
    with pytest.raises(BadCamera, match="cameras 1 and 2 differ by .* mm .*is the pose of one wro"):
        heightmap(depths, [cameras[0], wrong])
    with pytest.raises(BadCamera, match="of camera 2: has no pose; several cameras need one each"):
        heightmap(depths, [cameras[0], D435])
    with pytest.raises(BadCamera, match="2 looks of 1 cameras"):
        heightmap(depths, [cameras[0]])


def test_a_wrong_unit_is_told(hills):
    counts = np.asarray(sim.to_uint16(seen(hills, at(30))))
    with pytest.raises(BadImage, match="the camera sees 0.1 to 2 m.*depth_unit"):
        heightmap(counts, at(30), depth_unit=0.01)


def test_no_plane_is_told(rng):
    depth = rng.uniform(0.2, 1.8, D435.shape).astype(np.float32)
    with pytest.raises(BadImage, match="the bed's plane is not found: .*levelled bed first"):
        heightmap(depth, D435)
    with pytest.raises(BadImage, match="no pixel has a reading"):
        heightmap(np.zeros(D435.shape, np.float32), D435)


# --- Properties ---------------------------------------------------------------------------------


@settings(max_examples=25)
@given(
    size=st.tuples(st.integers(2, 9), st.integers(2, 9)),
    pitch=st.floats(1e-4, 1e-2),
    origin=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    seed=st.integers(0, 99),
)
def test_a_map_and_what_its_camera_sees_are_one(size, pitch, origin, seed):
    heights = np.random.default_rng(seed).uniform(-0.1, 0.1, size).astype(np.float32)
    heights[0, 0] = np.nan
    one = HeightMap(heights, pitch, origin, None, aimed(25, 0.7))
    camera = check_camera(one.camera())
    again = map_of(one.depth(camera), camera, one.frame)
    np.testing.assert_allclose(again.heights, heights, atol=1e-6)
    np.testing.assert_allclose(again.pitch, pitch, rtol=1e-6)
    np.testing.assert_allclose(again.origin, origin, atol=1e-6)
    np.testing.assert_array_equal(again.mask, one.mask)
    # The pixel of a node shows the node.
    u, v = camera.pixel(one.x[None, :], -one.y[:, None], 0.0)
    np.testing.assert_allclose(u[0], np.arange(size[1]), atol=1e-2)
    np.testing.assert_allclose(v[::-1, 0], np.arange(size[0]), atol=1e-2)


@settings(max_examples=25)
@given(
    k1=st.floats(-0.15, 0.3),
    k2=st.floats(-0.1, 0.1),
    p=st.tuples(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)),
    k4=st.floats(-0.1, 0.3),
    z=st.floats(0.2, 3.0),
)
def test_a_pixel_shows_the_point_that_it_looks_at(k1, k2, p, k4, z):
    camera = replace(D435, lens=(k1, k2, *p, 0.0, k4, 0.0, 0.0))
    try:
        check_camera(camera)
    except BadCamera:  # no lens bends so
        return
    u, v = (a.astype(np.float32) for a in np.meshgrid(np.arange(0, 424, 9), np.arange(0, 240, 9)))
    back = camera.pixel(*camera.at(u, v, np.float32(z)), np.float32(z))
    np.testing.assert_allclose(back, (u, v), atol=0.06)  # `check_camera` allows 0.05


# --- Plans --------------------------------------------------------------------------------------


def bed_map(bed, pitch=0.45 / 54, unseen=None):
    """The bed as seen from straight above, on the grid of the small camera's pixels."""
    straight = Camera(60, 49, 1 / pitch, 1 / pitch, 29.5, 24.0, 0.1, 2.0, orthographic=True)
    depth = np.array(sim.render(bed, straight))
    if unseen is not None:
        depth[unseen] = np.nan
    heights = sim.SURFACE - depth[::-1]
    return HeightMap(heights, pitch, (-29.5 * pitch, -24.0 * pitch))


def bed_image(bed):
    luminance = SMALL.luminance(sim.render(bed, SMALL), quantize=False)
    return np.asarray(metric.weigh(luminance, SMALL))


@pytest.fixture(scope="module")
def small_bank():
    return load_bank("pressed-flour-robot").seen_by(SMALL, 0.45)


@pytest.mark.full
def test_maps_plan_as_the_images_from_above_do(small_bank):
    """Rays fan out 27 degrees to a pixel at the edge, so nodes and pixels are other places there:
    distances differ by a few percent, and places by less than the stride."""
    now = sim.flat_bed()
    goal = now
    for k, place in enumerate([(-0.08, 0.03), (0.09, -0.04)]):
        goal = sim.apply_action(jax.random.key(k), goal, sim.FLOUR, "knock", place, spread=0.0)
    images = plan(bed_image(now), bed_image(goal), bank=small_bank, **QUICK)
    maps = plan(bed_map(now), bed_map(goal), bank=small_bank, **QUICK)
    assert maps.actions == images.actions and len(maps) == 2
    assert np.abs(maps.positions - images.positions).max() < 6
    np.testing.assert_allclose(maps.distances_mm, images.distances_mm, rtol=0.1, atol=0.05)


@pytest.mark.full
def test_what_is_not_seen_is_left_out(small_bank):
    now, unseen = sim.flat_bed(), np.s_[:, 40:]
    x, _ = now.axes()
    step = np.where(np.asarray(x) > 0.12, np.float32(-0.02), np.float32(0.0))
    goal = sim.loose_bed(now.height + step[None])
    found = plan(bed_map(now, unseen=unseen), bed_map(goal), bank=small_bank, **QUICK)
    assert len(found) == 0 and found.distances[0] < 1e-6
    assert plan(bed_map(now), bed_map(goal), bank=small_bank, **QUICK).distances[0] > 1e-3


def test_maps_that_are_no_pair_are_refused(small_bank):
    one = bed_map(sim.flat_bed())
    with pytest.raises(BadImage, match="Istar is no HeightMap, and the other one is"):
        plan(one, bed_image(sim.flat_bed()), bank=small_bank)
    here, there = (replace(one, frame=aimed(tilt, 0.5)) for tilt in (0, 30))
    with pytest.raises(BadImage, match="the maps lie in different frames.*like=first"):
        plan(here, there, bank=small_bank)
    apart = replace(one, origin=(0.3, 0.3))
    with pytest.raises(BadImage, match="known in both; at least 20% is needed"):
        plan(one, apart, bank=small_bank)
    with pytest.raises(BadImage, match="they are in metres, at most 2"):
        plan(replace(one, heights=np.where(one.x > 0, 30.0, 0.0) + 0 * one.heights), one,
             bank=small_bank)  # fmt: skip
