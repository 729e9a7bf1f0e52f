"""A camera that moved is told from noise and from molding, in maps as in recordings."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jshape import sim
from jshape.cli.dataset_recording import _check_still
from jshape.data.moved import averaged, moved
from jshape.data.pair_view import PairView
from jshape.data.segment import Cut, Segment
from jshape.data.simulate import look
from jshape.height_map import camera_above
from jshape.io.recordings import Recording
from jshape.robot.simulated import bed_of
from tests.seen_beds import bed, hollow, seen_by, standing

ABOVE = camera_above(np.eye(4), (100, 80), 0.005, (0.0, 0.0))


def test_a_camera_that_moves_is_told_from_a_bed_that_changes():
    camera = standing(30, 0.6)
    first = seen_by(camera)

    def how(later):
        return moved(*(np.where(z > 0, z, np.nan) for z in (first, later)), camera)

    molded = seen_by(camera, bed(of=hollow(0.02)))
    assert how(molded) is None and how(first + 0.004) is None
    turned = seen_by(standing(33, 0.6))
    assert how(turned).turned_deg == pytest.approx(3.0, abs=0.3)
    hand = turned.copy()
    hand[:60, 40:80] -= 0.1
    assert how(hand).turned_deg == pytest.approx(3.0, abs=0.3)
    nearer = how(seen_by(standing(30, 0.58)))
    assert nearer.turned_deg < 0.5 and 15 < nearer.off_mm < 25
    assert how(np.where(np.arange(160) < 150, np.nan, first)) is None  # too little in common
    level = bed(of=lambda x, y: 0.03 * np.sin(40 * x) * np.cos(40 * y))
    assert how(seen_by(camera, level)) is None


def test_what_is_smaller_than_the_grain_says_nothing():
    image = averaged(np.full((3, 40), 0.4), 5)
    assert image.shape == (0, 8) and moved(image, image, ABOVE, 5) is None


@pytest.fixture
def wide(rng):
    """Depths of a bed of hills, 3 mm, that reaches beyond `ABOVE`'s view by 20 pixels."""
    relief = gaussian_filter(rng.standard_normal((120, 140)), 5)
    return 0.45 + 3e-3 * relief / relief.std()


def view(wide, down=0, right=0):
    """What `ABOVE` sees of it from so many pixels lower and farther right."""
    return wide[20 + down : 100 + down, 20 + right : 120 + right]


def test_a_camera_that_moves_along_the_bed_is_told_by_its_relief(wide, rng):
    for down, right in ((0, 10), (-4, 0), (3, -3)):
        later = view(wide, down, right) + 3e-4 * rng.standard_normal((80, 100))
        later[:20, 30:50] = np.nan  # hidden
        later[30:50, 30:70] += 0.02  # molded
        how = moved(view(wide), later, ABOVE)
        assert how.aside_mm == pytest.approx(5 * np.hypot(down, right), abs=5)  # a pixel
        assert how.said("a.npz").endswith(" mm aside of where it lay in a.npz")
    assert moved(np.full((80, 100), 0.45), view(wide), ABOVE) is None  # no relief: nothing to tell


@pytest.mark.parametrize(("state", "warned"), [("occluded", ""), ("open", "frames 1-1: the bed")])
def test_a_hand_at_rest_is_no_bed_aside(state, warned, wide, capsys):
    """In a recording: what is hidden tells nothing of where the relief lies."""
    states = ("open", state, "open")
    cut = Cut(*np.zeros((2, 3)), tuple(Segment(k, k + 1, s) for k, s in enumerate(states)))
    thumbs = np.stack([np.rint(1e4 * view(wide, right=right)) for right in (0, 10, 0)])
    _check_still(Recording(Path("rec"), ABOVE, 1e-4, (), ()), cut, thumbs, PairView([]))
    said = "".join(capsys.readouterr())
    assert warned in said if warned else not said


def test_a_tilt_by_a_degree_and_a_half_is_told_through_noise(wide, rng):
    slope = np.tan(np.radians(1.5)) * 0.005 * (np.arange(100) - 49.5)
    how = moved(view(wide), view(wide) + slope + 5e-4 * rng.standard_normal((80, 100)), ABOVE)
    assert how.turned_deg == pytest.approx(1.5, abs=0.1) and not how.aside_mm
    assert "turned by 1.5 degrees" in how.said("a.npz")


def test_neither_noise_nor_molding_is_a_camera_that_moved(wide, rng):
    first = view(wide)
    later = first + 5e-4 * gaussian_filter(rng.standard_normal((80, 100)), 0.7)
    assert moved(first, later, ABOVE) is None
    v, u = np.indices((80, 100))
    for _ in range(20):  # holes with rims, all over the bed
        away = np.hypot(v - rng.uniform(5, 75), u - rng.uniform(5, 95)) / rng.uniform(3, 6)
        later = later + 0.015 * (1 - away**2 / 2) * np.exp(-(away**2) / 2)
        assert moved(first, later, ABOVE) is None
    # One heap that is pushed 50 mm over a level bed is no moved bed.
    first, later = (0.45 - 0.03 * np.exp(-((v - 40) ** 2 + (u - at) ** 2) / 50) for at in (40, 50))
    assert moved(first, later, ABOVE) is None


def seen(key, molded, camera, frames=1):
    """A noisy look (metres, NaN: none), averaged over blocks of 2x2 pixels."""
    depth = look(key, molded, camera, frames=frames)
    return averaged(np.where(depth > 0, depth, np.nan), 2)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(2))
def test_twenty_actions_on_a_simulated_bed_are_no_move(seed, rng):
    molded, *_ = bed_of(seed)
    keys = jax.random.split(jax.random.key(seed), 41)
    camera = replace(standing(0, 0.45), pose=None)
    first = seen(keys[0], molded, camera, frames=3)
    material, actions = sim.read_material("flour"), sim.actions_of("robot")
    for k in range(1, 41, 2):
        at = rng.uniform(-1, 1, 2) * (0.15, 0.11)
        act = str(rng.choice(actions)), "robot"
        molded = sim.apply_action(keys[k], molded, material, act, at.astype(np.float32))
        assert moved(first, seen(keys[k + 1], molded, camera), camera, 2) is None


def test_averages_keep_what_is_half_known():
    image = np.arange(20.0).reshape(4, 5)
    image[0, :2] = image[2:, 2] = image[3, 3] = np.nan
    np.testing.assert_array_equal(averaged(image, 2), [[5.5, 5.0], [13.0, np.nan]])
