"""Table I, ROIs and where they fit."""

from dataclasses import replace

import numpy as np
import pytest

from jshape import D435_BAZAR, PAPER_ACTIONS, PAPER_BOX
from jshape.actions import (
    PAPER_Z,
    PlacedAction,
    first_pixels,
    fits,
    grid,
    linked,
    place,
    roi_size,
)
from jshape.errors import BadPosition, UnknownName


def test_table_one():
    assert PAPER_ACTIONS.names == ("grasp", "knock", "press", "pinch", "poke")
    assert PAPER_ACTIONS.named("press").half_size == (0.046, 0.103, 0.050)
    with pytest.raises(UnknownName, match="'tap'; allowed: grasp, knock"):
        PAPER_ACTIONS.named("tap")


@pytest.mark.parametrize("action", PAPER_ACTIONS, ids=lambda a: a.name)
def test_hypothesis_three_gives_one_roi_size_everywhere(action):
    w, h = roi_size(D435_BAZAR, action)
    dx, dy, _ = action.half_size
    assert (w, h) == (round(2 * 433 * dx / 0.45), round(2 * 433 * dy / 0.45))
    # The projection of the box's front: what is seen from straight above.
    corners = np.array([[x, y, PAPER_Z] for x in (-dx, dx) for y in (-dy, dy)])
    wide = replace(D435_BAZAR, width=1000, height=1000, u0=500.0, v0=500.0)
    v, u = np.nonzero(wide.project(corners))
    assert abs(np.ptp(u) - w) <= 1 and abs(np.ptp(v) - h) <= 1


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


def test_strokes_lead_through_the_middle_or_to_the_next_place():
    acts = linked([
        PlacedAction("sweep", (100.0, 50.0), stroke=(30.0, -8.0)),
        PlacedAction("scoop", (40.0, 60.0), stroke=(50.5, -39.75)),
        PlacedAction("pour", (90.5, 20.25)),
        PlacedAction("sweep", (10.0, 10.0), stroke=(6.0, 0.0)),
    ])  # fmt: skip
    assert [act.carries for act in acts] == [False, True, False, False]
    np.testing.assert_allclose(acts[0].ends, [[85, 54], [115, 46]])  # a path
    np.testing.assert_allclose(acts[1].ends, [[40, 60], [90.5, 20.25]])  # a carry
    np.testing.assert_allclose(acts[2].ends, [[90.5, 20.25]] * 2)
    np.testing.assert_allclose(acts[3].ends, [[7, 10], [13, 10]])  # the last one's is a path
    near = replace(acts[1], stroke=(50.0, -39.0))
    assert not linked([near, acts[2]])[0].carries and linked([near, acts[2]], 1.0)[0].carries
    assert linked([]) == ()


def test_an_action_says_what_is_not_as_trained():
    plain = PlacedAction("press", (91.4, 92.0))
    assert plain.words(PAPER_BOX) == "press (91, 92)" and plain.how == {}
    other = replace(plain, strength=0.5, yaw=np.pi / 6, length=2.0, stroke=(43.3, 0.0))
    assert other.how == {"strength": 0.5, "yaw": np.pi / 6, "length": 2.0}
    mm = 43.3 / 433.0 * 1e3 * (0.42 + 0.47) / 2
    said = f"yaw 30°, {mm:.0f} mm long"
    assert other.words(PAPER_BOX, "(3, 4) mm") == f"press x0.5 (3, 4) mm, {said}"
    assert replace(plain, strength=0.999).deep == ""
    assert replace(plain, strength=0.25).deep == " x0.25"
