"""Frames of another camera, seen as the bank's camera would see them."""

import jax
import numpy as np
import pytest

from jshape import D435_BAZAR, PAPER_BOX, Camera, plan_depth, sim
from jshape.camera import reproject
from jshape.data.view import view_of
from jshape.errors import BadCamera, BadImage

OTHER = Camera(640, 480, 500.0, 505.0, 325.0, 238.0, 0.3, 1.0, bits=16)


@pytest.fixture(scope="module")
def bed():
    return sim.irregular_bed(jax.random.key(0), 0.008)


@pytest.mark.parametrize("rise", [0.0, -0.05, 0.03])
def test_reprojection_equals_rendering_with_the_other_camera(bed, rise):
    seen = sim.render(bed, OTHER, sim.Z_FLOOR - rise)
    again = np.asarray(reproject(seen, OTHER, PAPER_BOX, rise))
    truth = np.asarray(sim.render(bed, PAPER_BOX))
    both = np.isfinite(again)
    assert both.mean() > 0.85  # from nearer, the other camera does not see the box's corners
    assert np.abs(again - truth)[both].max() < 2e-4 and np.abs(again - truth)[both].mean() < 1e-5


def test_a_camera_reprojects_onto_itself(bed):
    seen = sim.render(bed, PAPER_BOX)
    np.testing.assert_allclose(reproject(seen, PAPER_BOX, PAPER_BOX), seen, atol=1e-6)


def test_a_plan_from_another_camera_is_the_same_plan(bank, molded):
    """The same two beds seen by the bank's camera, by a larger frame, and by another camera."""
    from jshape import metric

    now, goal, _ = molded
    z0, zstar = (np.asarray(PAPER_BOX.depth(metric.unweigh(i, PAPER_BOX))) for i in (now, goal))
    ours = plan_depth(z0, zstar, bank=bank)
    whole = [np.full(D435_BAZAR.shape, 0.46, np.float32) for _ in range(2)]
    for frame, z in zip(whole, (z0, zstar), strict=True):
        frame[46 : 46 + 395, 181 : 181 + 480] = z
    cut = plan_depth(*whole, bank=bank, camera=D435_BAZAR)
    assert cut.actions == ours.actions
    np.testing.assert_array_equal(cut.images, ours.images)
    np.testing.assert_array_equal(
        cut.view.pixels(cut.positions, 0.445), ours.positions + np.array([181, 46])
    )


def test_pixels_lead_back_to_the_own_camera(bed):
    seen = np.asarray(sim.render(bed, OTHER, sim.Z_FLOOR + 0.05))
    view = view_of(OTHER, PAPER_BOX, seen, reproject=True)
    np.testing.assert_allclose(view.rise, 0.445 - np.median(seen[120:360, 160:480]), atol=1e-5)
    z = 0.445
    own = view.pixels(np.array([[240, 197], [100, 300]]), z)
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
