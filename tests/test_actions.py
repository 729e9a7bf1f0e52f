"""Table I, boxes, ROIs and visible places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import D435_BAZAR, PAPER_ACTIONS, PAPER_BOX
from jshape.actions import (
    PAPER_Z,
    Cuboid,
    box_of,
    first_pixels,
    fits,
    grid,
    is_visible,
    place,
    roi_from_box,
    roi_size,
    visible_range,
)
from jshape.errors import BadPosition, UnknownName


def test_table_one():
    assert PAPER_ACTIONS.names == ("grasp", "knock", "press", "pinch", "poke")
    assert PAPER_ACTIONS.named("press").half_size == (0.046, 0.103, 0.050)
    with pytest.raises(UnknownName, match="'tap'; allowed: grasp, knock"):
        PAPER_ACTIONS.named("tap")


def corners(box):
    return np.array([[x, y, z] for x in box[:2] for y in box[2:4] for z in box[4:]])


@settings(max_examples=200)
@given(
    x=st.tuples(st.floats(-0.6, 0.6), st.floats(0.001, 0.3)),
    y=st.tuples(st.floats(-0.4, 0.4), st.floats(0.001, 0.3)),
    z=st.tuples(st.floats(0.3, 0.6), st.floats(0.001, 0.2)),
)
def test_the_roi_is_the_bounding_rectangle_of_the_projected_corners(x, y, z):
    """All sign cases of Table RoiCorners at once, against the eight corners projected."""
    box = Cuboid(x[0], sum(x), y[0], sum(y), z[0], sum(z))
    camera, cloud = D435_BAZAR, corners(box)
    u = np.clip(np.rint(camera.fx * cloud[:, 0] / cloud[:, 2] + camera.u0), 0, 847)
    v = np.clip(np.rint(camera.fy * cloud[:, 1] / cloud[:, 2] + camera.v0), 0, 479)
    assert roi_from_box(camera, box) == (u.min(), v.min(), u.max(), v.max())


@pytest.mark.parametrize(
    ("box", "corner_depths"),
    [  # signs of (X-, X+): which depth gives the left and the right column
        ((0.1, 0.2), ("far", "near")),
        ((-0.2, -0.1), ("near", "far")),
        ((-0.1, 0.1), ("near", "near")),
    ],
)
def test_each_sign_case_of_the_table(box, corner_depths):
    depth = {"near": 0.40, "far": 0.50}
    roi = roi_from_box(D435_BAZAR, Cuboid(*box, 0.0, 0.05, 0.40, 0.50))
    left, right = (
        np.rint(433 * x / depth[d] + 421) for x, d in zip(box, corner_depths, strict=True)
    )
    assert (roi.left, roi.right) == (left, right)


def test_a_box_behind_the_camera_is_refused():
    with pytest.raises(BadPosition, match="-0.01"):
        roi_from_box(D435_BAZAR, Cuboid(0, 1, 0, 1, -0.01, 0.5))


@pytest.mark.parametrize("action", PAPER_ACTIONS, ids=lambda a: a.name)
def test_hypothesis_three_gives_one_roi_size_everywhere(action):
    w, h = roi_size(D435_BAZAR, action)
    dx, dy, _ = action.half_size
    assert (w, h) == (round(2 * 433 * dx / 0.45), round(2 * 433 * dy / 0.45))
    thin = type(action)(action.name, (dx, dy, 1e-9))
    roi = roi_from_box(D435_BAZAR, box_of(thin, (0.01, -0.01, PAPER_Z)))
    clamped_w = min(w, 847)
    assert abs((roi.right - roi.left) - clamped_w) <= 1 and abs((roi.bottom - roi.top) - h) <= 1


@pytest.mark.parametrize("name", ["knock", "press", "pinch", "poke"])
def test_the_visible_range_is_where_the_box_is_visible(name, rng):
    """The printed condition, against projecting the eight corners.

    The printed condition mixes the faces; it is sufficient and necessary only for boxes on one
    side of the axis, so it is checked for a thin box, where the faces coincide.
    """
    action = PAPER_ACTIONS.named(name)
    thin = type(action)(name, (*action.half_size[:2], 1e-9))
    (x0, x1), (y0, y1) = visible_range(D435_BAZAR, thin)
    for x, y in rng.uniform((x0 - 0.1, y0 - 0.1), (x1 + 0.1, y1 + 0.1), (200, 2)):
        inside = x0 <= x <= x1 and y0 <= y <= y1
        assert is_visible(D435_BAZAR, thin, (x, y, PAPER_Z)) == inside


def test_the_first_pixel_of_a_roi():
    np.testing.assert_array_equal(first_pixels(np.array([[96, 91]]), (183, 40)), [[5, 71]])


def test_grids_span_the_image_and_refuse_what_cannot_be():
    places = grid(PAPER_BOX, 297, 1)[:, 0]
    np.testing.assert_array_equal(places, np.linspace(91, 388, 297).round())
    assert grid(PAPER_BOX, 5, 3)[[0, -1]].tolist() == [[91, 91], [388, 303]]
    for columns, rows in [(300, 1), (0, 3), (5, -2)]:
        with pytest.raises(BadPosition, match="places on a line of"):
            grid(PAPER_BOX, columns, rows, margin=(183, 183))
    for margin in [(0, 0), (481, 10)]:
        with pytest.raises(BadPosition, match="does not fit"):
            grid(PAPER_BOX, margin=margin)


def test_positions_outside_are_refused_shifted_or_dropped():
    where = {"grasp": np.array([[81, 91], [240, 197]]), "poke": np.array([[81, 91], [479, 9]])}
    rois = {"grasp": (183, 183), "poke": (40, 45)}
    with pytest.raises(BadPosition, match=r"2 ROI\(s\) leave.*grasp at \(81, 91\), poke at \(479"):
        place(PAPER_BOX, where, rois)
    dropped = place(PAPER_BOX, where, rois, "drop")
    assert [len(dropped[name]) for name in where] == [1, 1]
    shifted = place(PAPER_BOX, where, rois, "shift")
    np.testing.assert_array_equal(shifted["grasp"], [[91, 91], [240, 197]])
    np.testing.assert_array_equal(shifted["poke"], [[81, 91], [460, 22]])
    for name in where:
        assert fits(PAPER_BOX, shifted[name], rois[name]).all()
    with pytest.raises(BadPosition, match="larger than the 480x395 image"):
        place(PAPER_BOX, {"grasp": where["grasp"]}, {"grasp": (500, 10)}, "shift")
    with pytest.raises(UnknownName, match="refuse, shift, drop"):
        place(PAPER_BOX, where, rois, "clamp")
