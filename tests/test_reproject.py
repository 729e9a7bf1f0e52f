"""What one camera would have seen of what another saw: equal to dense marching in float64."""

from contextlib import ExitStack
from dataclasses import replace

import jax
import numpy as np
import pytest

from jshape import sim
from jshape.camera import PAPER_BOX, Camera
from jshape.height_map import as_frame
from jshape.reproject import reproject
from tests.reference import reproject as twin

SOURCE = Camera(80, 60, 70.0, 70.0, 39.5, 29.5, 0.2, 2.0)
TARGETS = {
    "above": Camera(64, 48, 200.0, 200.0, 31.5, 23.5, 0.3, 0.6, orthographic=True),
    "pinhole": Camera(64, 48, 90.0, 90.0, 31.5, 23.5, 0.3, 0.6),
}
LENSES = {
    "none": None,
    "barrel": (-0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "rational": (0.3, -0.1, 1e-3, -5e-4, 0.02, 0.35, -0.05, 0.01),
}
SPAN = np.array([0.36, 0.5], np.float32)
SIZE = 1.0, 0.9
"""Of the beds, metres: no camera sees beyond them."""
NEAR = 1e-6
"""Metres by which both may differ: 0.1 um is usual, float32 holds 0.03 um at 0.45 m."""


def aimed(tilt, turn=0.0, distance=0.45):
    """The pose of a camera aimed at the middle of a level bed, tilted and then turned, degrees."""
    tilt, turn = np.radians(tilt), np.radians(turn)
    about_x, about_z, pose = np.eye(3), np.eye(3), np.eye(4)
    about_x[1:, 1:] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    about_z[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    pose[:3, :3] = about_z @ about_x
    pose[:3, 3] = (0.0, 0.0, sim.SURFACE) - distance * pose[:3, 2]
    return as_frame(pose)


def tilted(tilt, lens="none", turn=0.0):
    return replace(SOURCE, pose=aimed(tilt, turn), lens=LENSES[lens])


def bed(std=0.008):
    return sim.irregular_bed(jax.random.key(0), std, size=SIZE)


def both(depth, source, target, span=SPAN):
    """What the fast one and the twin see."""
    return np.asarray(reproject(depth, source, target, span)), twin.reproject(
        depth, source, target, span
    )


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("tilt", [0, 15, 30, 45])
def test_it_equals_dense_marching(tilt, lens, target):
    source = tilted(tilt, lens, turn=20.0)
    found, slow = both(np.asarray(sim.render(bed(), source)), source, TARGETS[target])
    assert np.array_equal(np.isfinite(found), np.isfinite(slow))
    assert np.isfinite(found).mean() > 0.98
    np.testing.assert_allclose(found, slow, atol=NEAR)


@pytest.mark.parametrize("tilt", [0, 30])
def test_a_rough_bed_seen_by_coarse_pixels_is_as_exact(tilt):
    """Slopes of 60 degrees, pixels of 6 mm: the nearest reading is then 5 mm off the surface."""
    source = tilted(tilt)
    found, slow = both(np.asarray(sim.render(bed(0.015), source)), source, TARGETS["above"])
    assert np.mean(np.isfinite(found) != np.isfinite(slow)) < 0.002
    seen = np.isfinite(found) & np.isfinite(slow)
    np.testing.assert_allclose(found[seen], slow[seen], atol=NEAR)


def test_a_target_with_a_lens_and_a_pose_of_its_own():
    source = tilted(30)
    target = replace(TARGETS["pinhole"], lens=LENSES["rational"], pose=aimed(20, 90))
    span = np.array([0.3, 0.6], np.float32)
    found, slow = both(np.asarray(sim.render(bed(), source)), source, target, span)
    assert np.mean(np.isfinite(found) != np.isfinite(slow)) < 0.002
    seen = np.isfinite(found) & np.isfinite(slow)
    assert seen.mean() > 0.9
    np.testing.assert_allclose(found[seen], slow[seen], atol=5e-6)


def walled(height=0.04):
    """A level bed with a wall across, 10 mm thick, and its heights over the level."""
    level = sim.flat_bed(size=SIZE)
    _, y = level.axes()
    rise = np.where(np.abs(np.asarray(y)) < 0.005, np.float32(height), np.float32(0.0))
    return sim.loose_bed(level.height + rise[:, None], level.cell)


def test_a_wall_hides_what_is_behind_it():
    """Nothing is invented there: neither the wall's side, stretched over it, nor the ground."""
    source = replace(tilted(45), width=160, height=120, fx=140.0, fy=140.0, u0=79.5, v0=59.5)
    target = TARGETS["above"]
    found, slow = both(np.asarray(sim.render(walled(), source)), source, target)
    truth = np.asarray(sim.render(walled(), target))
    assert np.mean(np.isfinite(found) != np.isfinite(slow)) < 0.01
    seen = np.isfinite(found)
    np.testing.assert_allclose(found[seen & np.isfinite(slow)], slow[seen & np.isfinite(slow)],
                               atol=1e-5)  # fmt: skip
    y = (np.arange(target.height) - 23.5) / 200.0
    # A ray over the crest, at 45 degrees, meets the ground 40 mm further, away from the camera.
    behind = (y < -0.009) & (y > -0.038) if aimed(45)[1][3] > 0 else (y > 0.009) & (y < 0.038)
    assert behind.sum() >= 5 and not seen[behind].any()
    assert seen[np.abs(y) > 0.06].all()
    # Off by more than 1 mm is only what lies within 3 mm of the edges: half a reading.
    wrong = seen & (np.abs(found - truth) > 1e-3)
    assert not wrong[np.abs(np.abs(y) - 0.005) > 0.003].any()


def test_what_was_not_read_is_not_seen():
    source = tilted(30)
    depth = np.array(sim.render(bed(), source))
    depth[20:34, 30:44] = np.nan
    found, slow = both(depth, source, TARGETS["above"])
    whole = reproject(np.asarray(sim.render(bed(), source)), source, TARGETS["above"], SPAN)
    assert np.isnan(slow).sum() > 150
    # At most where a step of the twin ends in the hole, just below the surface.
    assert (np.isfinite(found) & np.isnan(slow)).sum() <= 2
    # All around the hole is seen as if there were none.
    assert (np.isnan(found) & np.isfinite(slow)).sum() < 0.1 * np.isnan(slow).sum()
    seen = np.isfinite(found)
    np.testing.assert_allclose(found[seen], np.asarray(whole)[seen], atol=NEAR)


def test_a_window_of_the_target_sees_the_same():
    source, target = tilted(30, "barrel"), TARGETS["above"]
    depth = np.asarray(sim.render(bed(), source))
    whole = np.asarray(reproject(depth, source, target, SPAN))
    part = reproject(depth, source, target.crop(10, 5, 30, 20), SPAN)
    np.testing.assert_allclose(part, whole[5:25, 10:40], atol=1e-7)


def test_cameras_on_one_spot_see_the_same():
    depth = np.asarray(sim.render(bed(), SOURCE))
    same = reproject(depth, SOURCE, replace(SOURCE, pose=as_frame(np.eye(4))), SPAN)
    np.testing.assert_allclose(same, depth, atol=1e-6)


@pytest.mark.full
def test_strict_settings_change_nothing():
    source, target = tilted(30, "rational"), TARGETS["above"]
    depth = np.asarray(sim.render(bed(), source))
    expected = np.asarray(reproject(depth, source, target, SPAN))
    with ExitStack() as stack:
        stack.enter_context(jax.enable_x64(True))
        stack.enter_context(jax.numpy_dtype_promotion("strict"))
        stack.enter_context(jax.numpy_rank_promotion("raise"))
        rendered = np.asarray(sim.render(bed(), source))
        found = reproject(depth, source, target, SPAN)
    assert found.dtype == np.float32 and rendered.dtype == np.float32
    np.testing.assert_allclose(rendered, depth, atol=1e-5)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_only_sizes_are_compiled_for():
    def looked(tilt, focal, span):
        source = replace(tilted(tilt, "barrel"), fx=focal, fy=focal)
        depth = np.full(source.shape, 0.45, np.float32)
        return reproject(depth, source, TARGETS["above"], np.asarray(span, np.float32))

    looked(10, 70.0, (0.3, 0.6))
    before = reproject._cache_size()
    looked(20, 75.0, (0.35, 0.7))
    assert reproject._cache_size() == before


def test_what_lies_beyond_the_span_is_not_seen():
    """A chip before a far floor: only the chip is within the depths that there can be."""
    depth = np.full(PAPER_BOX.shape, 0.9, np.float32)
    depth[180:210, 220:260] = 0.45
    span = np.array([0.43, 0.47], np.float32)
    seen = np.isfinite(np.asarray(reproject(depth, PAPER_BOX, PAPER_BOX, span)))
    assert seen[185:205, 225:255].all() and seen.mean() < 0.01
