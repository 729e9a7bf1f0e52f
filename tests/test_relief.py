"""Height maps laid under a camera."""

import numpy as np
import pytest

from jshape import PAPER_BOX
from jshape.data.relief import depth_of_relief
from jshape.errors import BadImage


def test_a_relief_fills_the_view_at_its_scale(rng):
    slope = np.linspace(-10, 10, 50)[None, :] * np.ones((40, 1))
    depth = depth_of_relief(slope, PAPER_BOX, scale=1e-3)
    assert depth.shape == PAPER_BOX.shape
    np.testing.assert_allclose(depth.mean(), 0.445, atol=1e-5)
    np.testing.assert_allclose(depth[:, [0, -1]], [[0.435, 0.455]] * 395, atol=1e-4)
    assert np.diff(depth[100]).min() >= 0
    slope[3, 4] = np.nan
    assert 0 < np.isnan(depth_of_relief(slope, PAPER_BOX)).mean() < 0.01


@pytest.mark.parametrize("relief", [np.zeros(5), np.zeros((1, 9)), np.zeros((4, 4), complex)])
def test_other_arrays_are_refused(relief):
    with pytest.raises(BadImage, match="relief"):
        depth_of_relief(relief, PAPER_BOX)
