"""The bed and its plane in frames that show more than the bed, real ones among them."""

import numpy as np
import pytest

from jshape import Camera, heightmap
from jshape.camera import matrix
from jshape.data.planes import bed_in, fit_plane
from jshape.data.view import view_above
from jshape.errors import BadImage, JShapeError
from jshape.io.formats import read_array
from tests.seen_beds import SMALL, seen_by, standing


@pytest.fixture(scope="module")
def box():
    """A bed at 20 degrees before a floor that fills more of the view, and its camera."""
    depth = seen_by(standing(20))
    v = np.arange(SMALL.height)[:, None]
    floor = 0.8 / (1 + 0.3 * (v - 59.5) / 140)
    return np.where(depth > 0, depth, floor * np.ones_like(depth)), depth > 0


def test_a_bed_before_a_floor_that_fills_more_of_the_view(box):
    depth, inside = box
    assert inside.mean() < 0.45
    holes = depth.copy()
    holes[60:63, 90:93] = np.nan
    found = bed_in(holes, SMALL)
    assert (found == inside).mean() > 0.99 and not found[60:63, 90:93].any()


@pytest.mark.parametrize(
    ("step", "expected"), [(-0.03, 0.57), (0.03, 0.6)], ids=["a box on a table", "a pit in the bed"]
)
def test_what_fills_the_middle_is_the_bed_if_it_stands_above(step, expected):
    """Seen from straight above, where neither's walls are seen; both are the smaller surface."""
    depth = np.full(SMALL.shape, 0.6, np.float32)
    middle = np.s_[35:85, 50:115]
    depth[middle] += step
    view = view_above(SMALL, depth)
    assert matrix(heightmap(depth, SMALL).frame)[2, 3] == pytest.approx(expected, abs=1e-3)
    area = view.target.width * view.target.height / float(view.target.fx) ** 2
    seen = depth[middle].shape if step < 0 else depth.shape
    assert area == pytest.approx(np.prod(seen) * (expected / 140) ** 2, rel=0.06)


def test_a_heap_does_not_tilt_the_plane():
    camera = standing(20)
    depth = seen_by(camera)
    depth[depth == 0] = np.nan
    plane = fit_plane(depth, camera)
    tilt = np.degrees(np.arccos(plane[2] / np.linalg.norm(plane)))
    assert tilt == pytest.approx(20, abs=0.06)


def test_a_bed_that_is_all_hills_has_a_plane():
    v, u = np.mgrid[:120, :160]
    hills = 0.45 + 0.025 * np.sin(u / 9) * np.sin(v / 11)
    found = heightmap(hills.astype(np.float32), SMALL)
    relief = np.ptp(found.heights[found.mask])
    assert relief == pytest.approx(0.05, abs=0.005)
    assert np.degrees(np.arccos(-np.array(found.frame)[2, 2])) < 1.5


def test_what_is_no_bed_is_refused(rng):
    with pytest.raises(BadImage, match="largest surface without a step holds .* at least 10%"):
        heightmap(rng.uniform(0.3, 0.7, SMALL.shape).astype(np.float32), SMALL)
    v, u = np.mgrid[:120, :160]
    waves = 0.55 + 0.11 * np.sin(u / 12) + 0.11 * np.sin(v / 12)
    with pytest.raises(BadImage, match="of the bed lies within 60 mm of one, at least 50% must"):
        heightmap(waves.astype(np.float32), SMALL)


def test_a_bed_wider_than_a_map_has_coarser_nodes():
    camera = Camera(1280, 160, 970.0, 970.0, 639.5, 79.5, 0.3, 0.7)
    depth = np.full(camera.shape, 0.45, np.float32)
    found = heightmap(depth, camera)
    wide = found.heights.shape[1] * float(found.pitch)
    assert found.heights.shape[1] == 1024 and wide == pytest.approx(1280 / 970 * 0.45, rel=0.01)
    said = "^depth: nodes 0.2 mm apart are too many for a bed of 593 mm; 0.58 mm or more"
    with pytest.raises(JShapeError, match=said):
        heightmap(depth, camera, pitch=2e-4)
    assert heightmap(depth, camera, pitch=5.8e-4).heights.shape[1] == 1023


SR300 = Camera(640, 480, 619.871, 619.871, 314.241, 238.906, 0.5, 1.2, bits=16)
KINECT = Camera(512, 424, 365.5, 365.5, 257.0, 207.0, 0.5, 2.5, bits=16)


def test_a_real_bin_seen_from_the_side(shared_data):
    counts = read_array(shared_data / "real/realsense_sr300/background-0.depth.png")
    found = heightmap(counts, SR300, depth_unit=1e-4)
    frame = np.array(found.frame)
    assert np.degrees(np.arccos(-frame[2, 2])) == pytest.approx(34, abs=0.5)
    # By hand: the bin's floor is 0.39 x 0.55 m; the rest of the frame, 0.9 x 1 m, is left out.
    wide, tall = np.ptp(found.x), np.ptp(found.y)
    assert wide == pytest.approx(0.41, abs=0.02) and tall == pytest.approx(0.60, abs=0.03)
    middle = np.s_[90:-90, 40:-40]
    floor = found.heights[middle][found.mask[middle]]
    assert found.mask[middle].mean() > 0.99 and np.abs(floor).max() < 0.012
    again = read_array(shared_data / "real/realsense_sr300/input-0.depth.png")
    things = heightmap(again, SR300, depth_unit=1e-4, like=found)
    # Behind the box that stands there, nothing was seen, and nothing is made up.
    hidden = (slice(153, 165), slice(127, 180))
    assert found.mask[hidden].all() and things.mask[hidden].mean() < 0.1


def test_a_real_sandbox_among_its_surroundings(shared_data):
    counts = np.load(shared_data / "real/sand/kinect_v2_raw.npy")
    found = heightmap(counts, KINECT)
    frame = np.array(found.frame)
    assert np.degrees(np.arccos(-frame[2, 2])) < 3
    assert frame[2, 3] == pytest.approx(1.19, abs=0.02), "the sand, not the floor 0.8 m below"
    at = [np.abs(axis).argmin() for axis in (found.y + 0.1, found.x - 0.05)]
    assert 0.05 < found.heights[tuple(at)] < 0.08, "the heap in the middle"
    assert heightmap(counts, KINECT, window=(90, 85, 378, 305)).mask.mean() > 0.96
