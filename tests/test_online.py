"""A bank learns from its own actions: little from few, nothing bad, and no nonsense."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import jshape
from jshape import Pairs, metric
from jshape.actions import PlacedAction
from jshape.data.view import image_of_depth
from jshape.errors import BadBank, BadDataset
from jshape.learn.lessons import Lesson, hand_of, lesson, lessons_of
from jshape.learn.online import CHANGED, KEPT, Evidence, corrected
from jshape.planning.api import rollout


@pytest.fixture(scope="module")
def bank():
    return jshape.load_bank("pressed-flour-robot")


@pytest.fixture(scope="module")
def other(bank):
    """The bank of a hand 2.5 mm lower, in material that gives way less and heaps up more."""
    numbers = np.array([2.5e-3, -0.2, 0.4], np.float32)
    hands = tuple(corrected(hand, numbers) for hand in bank.predictors)
    return replace(bank, predictors=hands)


def lessons(truth, count, seed=0, actions=("press", "poke", "pinch")):
    """What a bank's actions do to wavy beds, with 0.1 mm of noise that neighbours share."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        name = actions[k % len(actions)]
        hand = hand_of(truth, name)
        shape = hand.grid.shape
        waves, noise = (ndimage.gaussian_filter(rng.normal(size=shape), 4) for _ in range(2))
        before = (0.445 + 2e-3 * waves / waves.std()).astype(np.float32)
        strength = float(rng.choice([0.5, 1.0]))
        after = before + np.asarray(hand.change(before, strength)) + 1e-4 * noise / noise.std()
        which = truth.actions.index(name)
        found.append(
            Lesson(which, before, after.astype(np.float32), np.ones(shape, np.float32), strength)
        )
    return found


def error(bank, held_out):
    return np.mean([one.error_mm(hand_of(bank, bank.actions[one.action])) for one in held_out])


def noted(bank, given):
    evidence = Evidence(bank)
    for one in given:
        evidence = evidence.note(one)
    return evidence


def test_few_looks_teach_most_of_what_a_hand_does_otherwise(bank, other):
    evidence = noted(bank, lessons(other, 9))
    held_out = lessons(other, 6, seed=1)
    assert error(evidence.bank, held_out) < 0.5 * error(bank, held_out)
    unseen = lessons(other, 4, seed=2, actions=("knock", "grasp"))  # one hand does them all
    assert error(evidence.bank, unseen) < 0.8 * error(bank, unseen)


def test_a_bank_that_is_right_stays_so(bank):
    held_out = lessons(bank, 6, seed=1)
    evidence = Evidence(bank)
    for one in lessons(bank, 8):
        evidence = evidence.note(one)
        assert error(evidence.bank, held_out) < error(bank, held_out) + 0.03
    assert (np.asarray(evidence.bank.errors_mm) < np.asarray(bank.errors_mm)).all()


def test_nonsense_teaches_next_to_nothing(bank, other):
    given, held_out = lessons(other, 6), lessons(other, 6, seed=1)
    after = given[2].after.copy()
    after[: len(after) // 2] -= 0.03  # an object lies there
    without = noted(bank, given[:2] + given[3:]).bank
    strange = noted(bank, [*given[:2], given[2]._replace(after=after), *given[3:]]).bank
    assert error(strange, held_out) < error(without, held_out) + 0.05 < error(bank, held_out)


def test_the_start_is_kept_while_it_foretells_better(bank):
    given = lessons(bank, 4)
    rng = np.random.default_rng(3)
    for k, one in enumerate(given):  # every action goes otherwise each time
        gap = 2e-3 * (-1) ** (k // 2) * np.sign(rng.normal())
        given[k] = one._replace(after=one.after + np.float32(gap))
    evidence = noted(bank, given)
    lost = sum(one.learned_mm - one.start_mm for one in evidence.judged)
    kept = evidence.bank.predictors[0] is bank.predictors[0]
    assert kept == (lost > 0)


def test_a_change_of_hand_is_got_over_at_once(bank, other):
    held_out = lessons(bank, 6, seed=1)
    evidence = noted(bank, lessons(other, 12))
    assert error(evidence.bank, held_out) > 1.5 * error(bank, held_out)
    for one in lessons(bank, 3, seed=2):  # now another hand: that of the start
        evidence = evidence.note(one)
    assert error(evidence.bank, held_out) < error(bank, held_out) + 0.03
    assert len(evidence.judged) == 3 - 1 + CHANGED - 1 and evidence.count == 15


def test_a_shallow_look_says_little_of_deep_ones(bank):
    (one,) = lessons(bank, 1, actions=("knock",))
    hand = hand_of(bank, "knock")
    after = one.before + np.asarray(hand.change(one.before, 0.2)) + np.float32(4e-4)
    shallow = one._replace(after=after, strength=0.2)
    found = hand_of(noted(bank, [shallow]).bank, "knock")
    gap = np.abs(
        np.asarray(found.change(one.before, 1.0)) - np.asarray(hand.change(one.before, 1.0))
    )
    assert 1e3 * gap.mean() < 0.15  # 2 mm, times what one such look is believed


def test_errors_follow_those_of_the_run(bank, other):
    first = noted(bank, lessons(other, 1)).bank.errors_mm
    assert (np.asarray(first) > 0.25 * np.asarray(bank.errors_mm)).all()
    unknown = replace(bank, errors_mm=None)
    assert noted(unknown, lessons(other, 2)).bank.errors_mm is None


def test_memory_does_not_grow(bank):
    (one,) = lessons(bank, 1)
    evidence = Evidence(bank)
    evidence = replace(evidence, judged=noted(bank, [one]).judged * KEPT, count=KEPT)
    evidence = evidence.note(one)
    assert len(evidence.judged) == KEPT and evidence.count == KEPT + 1


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_lesson_is_in_the_hand_s_own_frame(bank, other, yaw):
    rng = np.random.default_rng(0)
    bed = ndimage.gaussian_filter(rng.normal(size=bank.camera.shape), 12)
    depth = 0.445 + 2e-3 * bed / bed.std()
    image = image_of_depth(depth.astype(np.float32), bank.camera).image
    act = PlacedAction("press", (230, 180), 0.7, yaw)
    done = rollout(
        image, image, ["press"], [act.position], strengths=[0.7], yaws=[yaw], bank=other
    ).images[1]
    one = lesson(bank, act, image, np.asarray(done))
    true, start = (one.error_mm(hand_of(hands, "press")) for hands in (other, bank))
    assert true < 0.07 and true < 0.3 * start  # half of a node's rounding, turned twice


def test_a_bank_adapts_to_pairs_that_were_recorded(bank, other):
    depth = np.full(bank.camera.shape, 0.445, np.float32)
    image = image_of_depth(depth, bank.camera).image
    at = {"press": (150, 150), "pinch": (330, 240), "poke": (240, 100)}
    done = [
        np.asarray(rollout(image, image, [PlacedAction(name, at[name])], bank=other).images[1])
        for name in at
    ]
    counts = [
        np.rint(np.asarray(bank.camera.depth(metric.unweigh(one, bank.camera))) / 1e-5)
        for one in (image, *done)
    ]
    names, count = np.array(list(at)), len(at)
    pairs = Pairs(
        bank.camera, 1e-5,
        np.array([counts[0]] * count, np.uint16), np.array(counts[1:], np.uint16),
        names, np.array(["robot"] * count), np.array(["flour"] * count),
        np.array(list(at.values()), np.int32), np.array([bank.roi(name) for name in at]), names,
    )  # fmt: skip
    found = lessons_of(bank, pairs)
    assert error(jshape.adapt(bank, pairs), found) < 0.8 * error(bank, found)


def test_what_teaches_nothing_is_refused(bank):
    image = np.full(bank.camera.shape, 0.5, np.float32)
    blind = np.full_like(image, np.nan)
    with pytest.raises(BadDataset, match="seen"):
        lesson(bank, PlacedAction("press", (230, 180)), image, blind)
    with pytest.raises(BadDataset, match="times as long"):
        lesson(bank, PlacedAction("press", (230, 180), length=2.0), image, image)
    with pytest.raises(BadBank, match="kind 'P'"):
        Evidence(jshape.load_bank("flour-robot"))
