"""A sequence that somebody gives: predicted as a plan is."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest

import jshape
from jshape import JShapeError, Status, plan, rollout
from jshape.actions import PlacedAction
from jshape.errors import BadBank, BadImage, BadPosition, UnknownName
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from tests.conftest import paper


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Still(Predictor):
    """A predictor of somebody else: nothing changes."""

    roi = (20, 30)

    def __call__(self, roi, corner, strength=1.0):
        return roi


PLACES = np.array([[91, 92], [239, 92], [387, 92], [91, 302], [239, 197], [387, 302]])


@pytest.mark.full
def test_a_plan_given_back_is_predicted_as_it_was(bank, molded):
    now, goal, _ = molded
    found = plan(now, goal, bank=bank, **paper(positions=PLACES))
    again = rollout(now, goal, found.actions, found.positions, bank=bank)
    np.testing.assert_array_equal(again.images, found.images)
    np.testing.assert_array_equal(again.distances, found.distances)
    np.testing.assert_array_equal(again.positions, found.positions)
    np.testing.assert_array_equal(rollout(now, goal, found, bank=bank).images, found.images)
    assert [act.action for act in found] == list(found.actions) and found[1] == list(found)[1]
    assert found[0].position == tuple(found.positions[0].tolist())
    assert found[0].roi == bank.roi(found[0].action)
    shorter = rollout(now, goal, found.actions[1:], found.positions[1:], bank=bank)
    assert shorter.status is Status.PLAN_ENDED
    assert len(shorter) == 2 and shorter.distances[-1] > found.distances[-1]


@pytest.mark.full
def test_turned_stronger_and_exact_places_count():
    bank = jshape.load_bank("pressed-flour-robot")
    now = np.full(bank.camera.shape, 0.6, np.float32)
    place = [[200.25, 190.5]]

    def change(**more):
        found = rollout(now, now, ["knock"], more.pop("at", place), bank=bank, **more)
        return found.images[-1] - now

    plain = change()
    assert np.abs(change(strengths=[2.0])).sum() > 1.3 * np.abs(plain).sum()
    assert np.abs(change(yaws=[0.8]) - plain).max() > 1e-3
    assert np.abs(change(at=[[200, 190]]) - plain).max() > 1e-5
    moved = change(at=[[3, 5]])  # its ROI would leave the image
    assert moved[:60, :60].any()


def test_an_empty_sequence_leaves_the_bed(bank, molded):
    now, goal, _ = molded
    nothing = rollout(now, goal, [], [], bank=bank)
    assert len(nothing) == 0 and nothing.images.shape[0] == 1
    assert nothing.distances[0] == jshape.distance(now, goal)


def test_a_hand_that_cannot_turn_is_not_turned(molded):
    now, goal, _ = molded
    bank = Bank(jshape.PAPER_BOX, (Still(),), ("press",), kind="X")
    assert rollout(now, goal, ["press"], [[100, 100]], bank=bank).distances.size == 2
    with pytest.raises(BadBank, match="kind 'X' cannot turn the hand; yaws must be 0"):
        rollout(now, goal, ["press"], [[100, 100]], yaws=[0.5], bank=bank)


@pytest.mark.parametrize(
    "given, error, words",
    [
        ({"actions": ["stir"]}, UnknownName, "stir"),
        ({"positions": [[1, 2], [3, 4]]}, BadPosition, "2 positions for 1 actions"),
        ({"positions": [[480, 5]]}, BadPosition, r"\(480, 5\) is outside the 480x395"),
        ({"positions": [[np.nan, 5]]}, BadPosition, "outside"),
        ({"strengths": [0.0]}, JShapeError, "above 0"),
        ({"strengths": [1.0, 2.0]}, JShapeError, "1 numbers"),
        ({"yaws": [np.inf]}, JShapeError, "radians"),
        ({"positions": None}, BadPosition, "0 positions for 1 actions"),
        ({"actions": [PlacedAction("knock", (9, 9))]}, JShapeError, "go with names of actions"),
        ({"actions": [PlacedAction("knock", (480, 5))], "positions": None}, BadPosition, "outside"),
        ({"I0": np.zeros((3, 3), np.float32)}, BadImage, "I0"),
    ],
)
def test_odd_sequences_are_refused(bank, molded, given, error, words):
    now, goal, _ = molded
    usual = {"I0": now, "Istar": goal, "actions": [bank.actions[0]], "positions": [[239, 197]]}
    with pytest.raises(error, match=words):
        rollout(**(usual | given), bank=bank)
