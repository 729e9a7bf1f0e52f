"""Frames of another camera, seen as the bank's camera would see them."""

import jax
import numpy as np
import pytest

from jshape import D435_BAZAR, PAPER_BOX, Camera, metric, plan_depth, sim
from jshape.camera import reproject
from jshape.data.view import image_of_depth, view_of
from jshape.errors import BadCamera, BadImage, MissingDepth
from tests.conftest import paper

OTHER = Camera(640, 480, 500.0, 505.0, 325.0, 238.0, 0.3, 1.0, bits=16)


@pytest.fixture(scope="module")
def bed():
    return sim.irregular_bed(jax.random.key(0), 0.008)


@pytest.mark.parametrize("rise", [0.0, -0.05, 0.03])
def test_reprojection_equals_rendering_with_the_other_camera(bed, rise):
    seen = sim.render(bed, OTHER, sim.Z_FLOOR - rise)
    again, pixel = (np.asarray(x) for x in reproject(seen, OTHER, PAPER_BOX, rise))
    truth = np.asarray(sim.render(bed, PAPER_BOX))
    both = np.isfinite(again)
    assert both.mean() > 0.85  # from nearer, the other camera does not see the box's corners
    assert np.abs(again - truth)[both].max() < 2e-4 and np.abs(again - truth)[both].mean() < 1e-5
    # The pixel says where each was looked up: by the pinhole model of both cameras.
    v, u = 100, 60
    x, y = (u - 240) / 433 * again[v, u], (v - 197) / 433 * again[v, u]
    far = again[v, u] - rise
    np.testing.assert_allclose(
        pixel[:, v, u], [500 * x / far + 325, 505 * y / far + 238], atol=0.01
    )


def test_a_camera_reprojects_onto_itself(bed):
    seen = sim.render(bed, PAPER_BOX)
    again, pixel = reproject(seen, PAPER_BOX, PAPER_BOX)
    np.testing.assert_allclose(again, seen, atol=1e-6)
    np.testing.assert_allclose(pixel, np.indices(PAPER_BOX.shape)[::-1], atol=1e-3)


def depths_of(molded):
    return [np.array(PAPER_BOX.depth(metric.unweigh(i, PAPER_BOX))) for i in molded[:2]]


def test_a_plan_from_a_larger_frame_is_the_same_plan(bank, molded):
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper())
    whole = [np.full(D435_BAZAR.shape, 0.9, np.float32) for _ in range(2)]  # a far floor around
    for frame, z in zip(whole, (z0, zstar), strict=True):
        frame[46 : 46 + 395, 181 : 181 + 480] = z
    for reproject_too in (False, True):
        cut = plan_depth(*whole, bank=bank, camera=D435_BAZAR, **paper(reproject=reproject_too))
        assert cut.actions == ours.actions
        np.testing.assert_array_equal(cut.images, ours.images)
        np.testing.assert_array_equal(cut.camera_positions, ours.positions + np.array([181, 46]))


@pytest.mark.full
@pytest.mark.parametrize("other", [OTHER, D435_BAZAR], ids=["other camera", "same, but higher"])
def test_a_plan_from_another_camera_or_height_finds_the_same_places(bank, molded, other):
    """Both beds as `other` sees them from 0.1 m higher: the same actions, in its own pixels."""
    places = np.array([[91, 92], [239, 197], [387, 302]])
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper(positions=places))
    seen = []
    for z in (z0, zstar):
        frame, _ = reproject(z, PAPER_BOX, other, 0.1)
        seen.append(np.where(np.isfinite(frame), frame, 0.56))  # beyond the box: a table
    found = plan_depth(*seen, bank=bank, camera=other, **paper(reproject=True, positions=places))
    assert sorted(found.actions) == sorted(ours.actions)
    np.testing.assert_allclose(found.distances_mm[-1], 0, atol=0.1)
    poke = found.camera_positions[found.actions.index("poke")]
    assert np.abs(poke - [float(other.u0) - 1, float(other.v0)]).max() <= 1
    with pytest.raises((BadCamera, BadImage), match="--reproject"):
        plan_depth(*seen, bank=bank, camera=other, **paper(positions=places))


def test_gaps_stay_gaps_when_looked_at_again(bed):
    seen = np.array(sim.render(bed, OTHER, sim.Z_FLOOR + 0.05))
    seen[200:260, 300:340] = 0
    view = view_of(OTHER, PAPER_BOX, seen, reproject=True)
    again = view.depth(seen, "frame")
    truth = np.asarray(sim.render(bed, PAPER_BOX, sim.Z_FLOOR + 0.05 + view.rise))
    gone = np.isnan(again)
    # 40 x 60 pixels of 0.5 m / 500 px are 0.4 / 433 m each to the bank's camera.
    assert abs(gone.sum() / (40 * 60 * (0.5 * 433 / 0.445 / 500) ** 2) - 1) < 0.1
    assert np.abs(again - truth)[~gone].max() < 5e-4
    with pytest.raises(MissingDepth, match=r"frame, seen by the bank's camera from 0.0\d\d m"):
        image_of_depth(seen, PAPER_BOX, view=view, max_missing=0.001, where="frame")


def test_pixels_lead_back_to_the_own_camera(bed):
    seen = np.asarray(sim.render(bed, OTHER, sim.Z_FLOOR + 0.05))
    view = view_of(OTHER, PAPER_BOX, seen, reproject=True)
    np.testing.assert_allclose(view.rise, 0.445 - np.median(seen[120:360, 160:480]), atol=1e-5)
    z = 0.445
    own = view.pixels(np.array([[240, 197], [100, 300]]))
    x, y = (100 - 240) / 433 * z, (300 - 197) / 433 * z
    expected = [500 * x / (z - view.rise) + 325, 505 * y / (z - view.rise) + 238]
    np.testing.assert_array_equal(own[0], [325, 238])
    np.testing.assert_allclose(own[1], expected, atol=0.51)


def test_another_camera_is_refused_unless_asked_for(bed):
    seen = np.asarray(sim.render(bed, OTHER))
    with pytest.raises(BadCamera, match=r"fx 500 \(bank: 433\).*--reproject"):
        view_of(OTHER, PAPER_BOX, seen)
    with pytest.raises(BadImage, match="middle of the frame"):
        view_of(OTHER, PAPER_BOX, np.full(OTHER.shape, np.nan), reproject=True)
    with pytest.raises(BadImage, match=r"\(395, 480\); the camera makes \(480, 640\)"):
        view_of(OTHER, PAPER_BOX, np.full(PAPER_BOX.shape, 0.45), reproject=True)


def test_depths_beyond_the_range_are_counted_or_refused(bank, molded):
    z0, zstar = depths_of(molded)
    z0[:20] = 0.6
    assert plan_depth(z0, zstar, bank=bank, **paper()).clamped == (20 * 480, 0)
    z0[:60] = 0.6
    with pytest.raises(BadImage, match=r"z0: depths are .* 84.8% of the readings are in it"):
        plan_depth(z0, zstar, bank=bank, **paper())


def test_two_frames_of_two_cameras(bank, molded):
    """Each is seen with its own; frames of one camera are moved by one distance, however deep."""
    z0, zstar = depths_of(molded)
    ours = plan_depth(z0, zstar, bank=bank, **paper(max_steps=2))
    whole = np.full(D435_BAZAR.shape, 0.9, np.float32)
    whole[46 : 46 + 395, 181 : 181 + 480] = zstar
    both = plan_depth(z0, whole, bank=bank, camera=(PAPER_BOX, D435_BAZAR), **paper(max_steps=2))
    np.testing.assert_array_equal(both.images, ours.images)
    np.testing.assert_array_equal(both.camera_positions, ours.positions)
    with pytest.raises(BadCamera, match=r"zstar: .* fx 500 \(bank: 433\)"):
        plan_depth(z0, zstar, bank=bank, camera=(PAPER_BOX, OTHER), **paper())
