"""A bed that other cameras see from anywhere, as a bank's own camera or a map would see it."""

import json
from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest

from jshape import D435_BAZAR, PAPER_BOX, Camera, metric, plan_depth, sim
from jshape.cli.reachable import reachable
from jshape.data.view import View, cut_of, cut_out, image_of_depth, view_above, view_like
from jshape.errors import BadCamera, BadImage, MissingDepth
from jshape.height_map import ABOVE, as_frame
from jshape.io.banks import load_bank
from jshape.planning.maps import over_bed, over_beds
from jshape.reproject import between, reproject
from jshape.robot.rigid import pose_at
from tests.conftest import paper

OTHER = Camera(640, 480, 500.0, 505.0, 325.0, 238.0, 0.3, 1.0, bits=16)
PLACES = np.array([[91, 92], [239, 197], [387, 302]])
FLOOR = 0.45
"""Metres from the straight camera at the origin to the bed."""


@pytest.fixture(scope="module")
def bed():
    return sim.irregular_bed(jax.random.key(0), 0.008)


def pose(tilt_deg=0.0, away=FLOOR, at=FLOOR):
    """Of a camera whose axis meets that of the straight one at depth `at`, `away` metres off."""
    a, matrix = np.radians(tilt_deg), np.eye(4)
    matrix[:3, :3] = [[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]]
    matrix[:3, 3] = [0.0, 0.0, at] - away * matrix[:3, 2]
    return as_frame(matrix)


def taken_by(camera, depth, span=(0.3, 1.0)):
    """What a camera with a pose sees of what `PAPER_BOX` saw at the origin; 0: no reading."""
    return np.nan_to_num(np.asarray(reproject(depth, PAPER_BOX, camera, np.array(span, "f4"))))


def depths_of(molded):
    return [np.array(PAPER_BOX.depth(metric.unweigh(i, PAPER_BOX))) for i in molded[:2]]


@pytest.mark.parametrize("higher", [0.0, 0.05, -0.03])
def test_another_camera_sees_what_is_rendered_for_it(bed, higher):
    seen = sim.render(bed, OTHER, sim.Z_FLOOR + higher)
    target = replace(PAPER_BOX, pose=pose(away=FLOOR - higher))
    again = np.asarray(reproject(seen, OTHER, target, np.array([0.35, 0.5], "f4")))
    truth = np.asarray(sim.render(bed, PAPER_BOX))
    both = np.isfinite(again)
    assert both.mean() > 0.85  # from nearer, the other camera does not see the box's corners
    off = np.abs(again - truth)[both]
    assert np.percentile(off, 99.9) < 2e-4 and off.mean() < 1e-5


def test_a_camera_sees_itself(bed):
    seen = np.asarray(sim.render(bed, PAPER_BOX))
    again = np.asarray(reproject(seen, PAPER_BOX, PAPER_BOX, np.array([0.4, 0.5], "f4")))
    np.testing.assert_allclose(again, seen, atol=2e-6)


def test_two_poses_and_none_are_one_geometry():
    """Only how two cameras stand to each other matters; without a pose the own frame is common."""
    here = replace(OTHER, pose=pose(20.0, 0.5))
    there = replace(PAPER_BOX, pose=pose(-10.0, 0.4))
    np.testing.assert_allclose(between(here, there) @ between(there, here), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(between(OTHER, there), np.array(there.pose))
    np.testing.assert_allclose(between(there, OTHER), np.linalg.inv(there.pose))
    moved = np.array(pose(40.0, 0.7))
    both = [replace(c, pose=as_frame(moved @ np.array(c.pose))) for c in (here, there)]
    np.testing.assert_allclose(between(*both), between(here, there), atol=1e-12)


def test_a_mask_of_own_pixels_lies_on_the_surface(tmp_path):
    """A mask of all that is higher than 20 mm, drawn as a camera at 30 degrees sees a mound."""
    v, u = np.mgrid[: PAPER_BOX.height, : PAPER_BOX.width]
    mound = 0.04 * np.exp(-((u - 240) ** 2 + (v - 197) ** 2) / 5e3)
    aslant = replace(OTHER, pose=pose(30.0, 0.5))
    frame = taken_by(aslant, (FLOOR - mound).astype(np.float32))
    view = View(aslant, replace(PAPER_BOX, pose=pose()))
    x, y = aslant.rays(frame)
    height = (
        FLOOR - (np.stack([x, y, frame, np.ones_like(frame)], -1) @ np.array(aslant.pose).T)[..., 2]
    )
    cv2.imwrite(str(tmp_path / "mask.png"), 255 * ((height > 0.02) & (frame > 0)).astype(np.uint8))
    seen = view.depth(frame, "frame")
    free = reachable(tmp_path / "mask.png", view, lambda: seen, None)
    away = np.abs(mound - 0.02)
    assert (free == (mound > 0.02))[away > 2e-3].all()
    clear = np.isfinite(seen) & (away > 2e-3)
    flat = view.drawing(cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED)) > 0
    assert ((flat != (mound > 0.02)) & clear).sum() > 0.05 * free.sum()  # it lies 12 mm beside

    # The same in metres of an arm's base, which is turned and stands beside it.
    base = pose_at(np.array([0.5, -0.1, 0.4]), np.array([np.cos(0.3), np.sin(0.3), 0, 0]))
    area = {"frame": "base", "polygon_m": [[0.44, -0.15], [0.6, -0.1], [0.52, -0.1], [0.5, 0.05]]}
    (tmp_path / "area.json").write_text(json.dumps(area))
    free = reachable(tmp_path / "area.json", view, lambda: seen, base @ np.array(aslant.pose))
    x, y = PAPER_BOX.at(u, v, FLOOR - mound)
    points = np.stack([x, y, FLOOR - mound, np.ones_like(x)], -1)[::6, ::6].reshape(-1, 4) @ base.T
    outline = np.float32(area["polygon_m"])
    inside = np.array([cv2.pointPolygonTest(outline, point, True) for point in points[:, :2]])
    sure = np.abs(inside) > 2e-3
    assert (free[::6, ::6].ravel() == (inside > 0))[sure].all() and (inside > 2e-3).sum() > 100


def test_a_plan_from_a_larger_frame_is_the_same_plan(bank, molded):
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper())
    whole = [np.full(D435_BAZAR.shape, 0.9, np.float32) for _ in range(2)]  # a far floor around
    for frame, z in zip(whole, (z0, zstar), strict=True):
        frame[46 : 46 + 395, 181 : 181 + 480] = z
    cut = plan_depth(*whole, bank=bank, camera=D435_BAZAR, **paper())
    assert cut.actions == ours.actions
    np.testing.assert_array_equal(cut.images, ours.images)
    np.testing.assert_array_equal(cut.camera_positions, ours.positions + np.array([181, 46]))
    assert cut.view == View(D435_BAZAR, PAPER_BOX, (181, 46)) and not cut.view.above


@pytest.mark.full
@pytest.mark.parametrize(
    "other",
    [
        replace(OTHER, pose=pose(away=FLOOR + 0.1)),
        replace(D435_BAZAR, pose=pose(away=FLOOR + 0.1)),
        replace(OTHER, pose=pose(30.0, FLOOR + 0.1)),
    ],
    ids=["other camera", "same, but higher", "30 degrees"],
)
def test_a_plan_from_another_camera_or_place_finds_the_same_places(bank, molded, other):
    """Both beds as `other` sees them: the same actions, in its own pixels."""
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper(positions=PLACES))
    seen = [taken_by(other, z) for z in (z0, zstar)]
    other = replace(other, pose=None)  # nobody knows: it is found in the frame
    found = plan_depth(*seen, bank=bank, camera=other, **paper(positions=PLACES))
    assert sorted(found.actions) == sorted(ours.actions)
    np.testing.assert_allclose(found.distances_mm[-1], 0, atol=0.15)
    poke = found.camera_positions[found.actions.index("poke")]
    assert np.abs(poke - [float(other.u0) - 1, float(other.v0)]).max() <= 1


def test_gaps_stay_gaps_when_looked_at_again(bed):
    seen = np.array(sim.render(bed, OTHER, sim.Z_FLOOR + 0.05))
    seen[200:260, 300:340] = 0
    view = view_above(OTHER, seen, PAPER_BOX)
    again = view.depth(seen, "frame")
    gone = np.isnan(again)
    inner = np.s_[100:295, 120:360]
    # 40 x 60 pixels of 0.5 m / 500 px are 0.4 / 433 m each to the bank's camera.
    assert abs(gone[inner].sum() / (40 * 60 * (0.5 * 433 / 0.445 / 500) ** 2) - 1) < 0.1
    image = image_of_depth(seen, PAPER_BOX, view=view, where="frame")
    np.testing.assert_array_equal(image.known, ~gone)  # which is what does not count
    seen[60:, :] = 0
    with pytest.raises(MissingDepth, match=r"frame: \d+\.\d% of the bed is seen; at least 20%"):
        image_of_depth(seen, PAPER_BOX, view=view, where="frame")


@pytest.mark.parametrize("target", [PAPER_BOX, None], ids=["pinhole", "from above"])
@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
def test_pixels_lead_back_to_the_own_camera(bed, target, tilt_deg):
    """A place and the surface's depth there are a pixel of the frame; and the way back."""
    straight = np.asarray(sim.render(bed, PAPER_BOX))
    camera = replace(OTHER, pose=pose(tilt_deg, 0.5))
    seen, source = taken_by(camera, straight), replace(OTHER, pose=None)
    view = view_above(source, seen, target)
    depth = view.depth(seen, "frame")
    h, w = depth.shape
    places = np.array([[w // 2, h // 2], [w // 3, h // 2], [w // 2, 2 * h // 3]])
    z = depth[places[:, 1], places[:, 0]]
    assert np.isfinite(z).all()
    own = view.pixels(places, z)
    back = view.positions(own, seen[own[:, 1], own[:, 0]])
    # A pixel of the frame is rounded: half of one, and what a slope makes of it.
    assert np.abs(back - places).max() < 1.5
    # On the straight axis lies the same point for both: the middle of the frame.
    middle = view.positions(np.array([[325, 238]]), seen[238, 325])
    (u, v), *_ = at = np.rint(middle).astype(int)
    assert np.abs(view.pixels(at, depth[v : v + 1, u]) - [325, 238]).max() <= 1


@pytest.mark.parametrize("target", [PAPER_BOX, None], ids=["pinhole", "from above"])
def test_a_tilted_bed_is_level_from_above(bed, target):
    straight = np.asarray(sim.render(sim.flat_bed(), PAPER_BOX))
    seen = taken_by(replace(OTHER, pose=pose(30.0, 0.5)), straight)
    view = view_above(OTHER, seen, target)
    depth = view.depth(seen, "frame")
    known = depth[np.isfinite(depth)]
    assert known.size > 0.6 * depth.size
    expected = ABOVE if target is None else 0.445  # the middle of its range
    assert np.abs(known - expected).max() < 5e-4


def test_what_makes_no_view_is_refused_in_a_line(bed):
    seen = np.asarray(sim.render(bed, OTHER))
    with pytest.raises(BadCamera, match=r"fx 500 \(bank: 433\)"):
        cut_of(OTHER, PAPER_BOX)
    assert cut_out(OTHER, PAPER_BOX, seen) is None
    with pytest.raises(BadImage, match="frame: no pixel has a reading"):
        view_above(OTHER, np.full(OTHER.shape, np.nan))
    with pytest.raises(BadImage, match=r"480x395 pixels; the camera makes 640x480"):
        view_above(OTHER, np.full(PAPER_BOX.shape, 0.45))
    wild = 0.5 + 0.1 * np.random.default_rng(0).standard_normal(OTHER.shape)
    with pytest.raises(
        BadImage, match="the largest surface without a step holds 0% of the readings"
    ):
        view_above(OTHER, wild.astype(np.float32))
    small = np.full(OTHER.shape, np.nan, np.float32)
    small[200:260, 300:360] = 0.5
    with pytest.raises(BadCamera, match=r"5\d x 5\d mm of bed are seen; \w+ changes"):
        over_bed(load_bank("pressed-flour-robot"), OTHER, small)


def test_a_bed_out_of_the_banks_range_is_looked_at_from_above(bank, molded):
    """Some readings beyond it are counted; if they are many, the bed is at another height."""
    z0, zstar = depths_of(molded)
    z0[:20] = 0.6
    assert plan_depth(z0, zstar, bank=bank, **paper()).clamped == (20 * 480, 0)
    z0[:60] = 0.6
    with pytest.raises(BadImage, match=r"z0: depths are .* 84.8% of the readings are in it"):
        plan_depth(z0, zstar, bank=bank, **paper())
    lower = [z + np.float32(0.08) for z in depths_of(molded)]
    found = plan_depth(
        *lower, bank=bank, camera=replace(PAPER_BOX, z_max=0.7), **paper(max_steps=1)
    )
    assert found.view.above and found.clamped == (0, 0)


def test_two_frames_of_two_cameras(bank, molded):
    """Each is seen with its own; what both hold is cut out of both."""
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper(max_steps=2))
    whole = np.full(D435_BAZAR.shape, 0.9, np.float32)
    whole[46 : 46 + 395, 181 : 181 + 480] = zstar
    both = plan_depth(z0, whole, bank=bank, camera=(PAPER_BOX, D435_BAZAR), **paper(max_steps=2))
    np.testing.assert_array_equal(both.images, ours.images)
    np.testing.assert_array_equal(both.camera_positions, ours.positions)
    with pytest.raises(BadImage, match=r"zstar.*480x395 pixels; the camera makes 640x480"):
        plan_depth(z0, zstar, bank=bank, camera=(PAPER_BOX, OTHER), **paper(max_steps=2))


@pytest.mark.parametrize("known", [True, False], ids=["poses", "no poses"])
def test_a_goal_of_another_camera_lies_where_it_is_in_the_bed(bank, molded, known):
    """With poses wherever they stand; without, both beds' planes are taken for the same one."""
    z0, zstar = depths_of(molded)
    one = replace(OTHER, pose=pose(away=0.5))
    two = replace(Camera(640, 480, 550.0, 550.0, 320.0, 240.0, 0.3, 1.0), pose=pose(20.0, 0.55))
    frames = taken_by(one, z0), taken_by(two, zstar)
    if not known:
        one, two = replace(one, pose=None), replace(two, pose=None)
    view, beside, seen_by = over_beds(bank, (one, two), frames, ("now", "goal"))
    assert view.target.shape == beside.target.shape == seen_by.camera.shape
    now, goal = (v.depth(f, "it") for v, f in zip((view, beside), frames, strict=True))
    with np.errstate(invalid="ignore"):
        dug = np.argwhere(goal - now > 2e-3)[:, ::-1]
    # Three craters around `PLACES`, and nothing else is deeper.
    away = np.linalg.norm(dug[:, None] - PLACES[None], axis=-1)
    assert (away.min(1) < 50).mean() > 0.99 and set(away.argmin(1)) == {0, 1, 2}
    for k, place in enumerate(PLACES):  # craters' walls that one of the two does not see: 4 mm
        assert np.abs(dug[away.argmin(1) == k].mean(0) - place).max() < 4


def test_a_second_frame_of_the_same_camera_is_not_levelled_anew(bed):
    """Its plane may have changed: what was moved is not taken for a camera that moved."""
    straight = np.asarray(sim.render(bed, PAPER_BOX))
    seen = taken_by(replace(OTHER, pose=pose(30.0, 0.5)), straight)
    view = view_above(OTHER, seen)
    assert view_like(view, OTHER, seen + np.float32(0.004)).target == view.target
    ranged = replace(OTHER, z_max=2.0)
    assert view_like(view, ranged, seen + np.float32(0.004)).target == view.target
