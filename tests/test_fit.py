"""f_D: fitting and measuring, against plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from jshape import PAPER_BOX, Bank, Pairs, fit, load_bank, metric, save_bank
from jshape.errors import BadCamera, BadDataset, JShapeError, UnknownName
from jshape.learn.evaluate import cross_validate, evaluate
from jshape.learn.scores import roi_errors_mm
from jshape.learn.validation import validate
from jshape.models.difference import Difference, fit_difference
from jshape.models.imprint import Imprint

UNIT = 1e-5


@pytest.fixture
def pairs(rng):
    """Two actions, two agents: a level bed gets a square pit whose depth varies by pair."""
    count, (h, w) = 12, PAPER_BOX.shape
    prior = np.full((count, h, w), round(0.44 / UNIT), np.uint16)
    posterior = prior.copy()
    centre = np.stack([rng.integers(60, 420, count), rng.integers(60, 330, count)], -1)
    depth = rng.integers(400, 600, count)
    for k, (u, v) in enumerate(centre):
        posterior[k, v - 10 : v + 10, u - 10 : u + 10] += depth[k].astype(np.uint16)
    action = np.array(["knock", "poke"] * 6)
    size = np.where(action[:, None] == "knock", [[40, 30]], [[24, 26]])
    return Pairs(
        camera=PAPER_BOX, depth_unit=UNIT, prior=prior, posterior=posterior, action=action,
        agent=np.array(["robot"] * 6 + ["human"] * 6), material=np.array(["flour"] * count),
        centre=centre, size=size, id=np.array([f"p{k}" for k in range(count)]),
    )  # fmt: skip


def images(pairs):
    """Weighed images by the definition, float64."""
    weight = np.asarray(metric.r_matrix(PAPER_BOX), np.float64)
    for name in ("prior", "posterior"):
        depth = getattr(pairs, name) * UNIT
        level = 255 * (0.47 - depth) / 0.05
        yield np.where(getattr(pairs, name) > 0, np.clip(level, 0, 255), np.nan) * weight


@pytest.mark.full
def test_the_effect_is_the_mean_difference(pairs):
    bank = fit(pairs)
    assert bank.actions == ("knock", "poke") and bank.kind == "D"
    assert bank.rois == {"knock": (40, 30), "poke": (24, 26)}
    prior, posterior = images(pairs)
    for name in bank.actions:
        w, h = bank.roi(name)
        changes = [
            (posterior[k] - prior[k])[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
            for k, (u, v) in enumerate(pairs.centre)
            if pairs.action[k] == name
        ]
        np.testing.assert_allclose(bank.predictor(name).delta, np.mean(changes, 0), atol=1e-6)


@pytest.mark.full
def test_pairs_of_several_strengths(pairs):
    """f_D divides by them, predictions are told them, and networks refuse them."""
    strength = np.linspace(0.5, 2.0, len(pairs)).astype(np.float32)
    several = replace(pairs, strength=strength)
    delta = np.asarray(fit(several).predictor("poke").delta)
    mine = several.of(action="poke")
    examples = mine.rois("poke")
    np.testing.assert_array_equal(examples.strength, strength[1::2])
    np.testing.assert_array_equal(examples.corner, mine.centre - np.array(examples.roi) // 2)
    np.testing.assert_array_equal(examples.select(np.array([2])).strength, strength[[5]])
    change = (examples.posterior - examples.prior).astype(np.float64)
    best = np.tensordot(mine.strength, change, 1) / (mine.strength.astype(float) ** 2).sum()
    np.testing.assert_allclose(delta, best, atol=1e-6)
    bank = fit(several)
    error, _ = roi_errors_mm(bank, several, "poke")
    expected = np.abs(
        np.clip(examples.prior + mine.strength[:, None, None] * delta, 0, 1) - examples.posterior
    ).mean((1, 2)) * float(metric.to_mm(1.0, PAPER_BOX))
    np.testing.assert_allclose(error, expected, rtol=1e-4)
    with pytest.raises(BadDataset, match="knock: pairs of strengths from 0.5 to .*; networks"):
        fit(several, "CR")


@pytest.mark.full
def test_missing_pixels_are_left_out_of_the_mean(pairs):
    whole = fit(pairs)
    u, v = pairs.centre[0]
    holed = replace(pairs, prior=pairs.prior.copy())
    holed.prior[0, v, u] = 0
    delta = np.asarray(fit(holed).predictor("knock").delta)
    same = np.ones(delta.shape, bool)
    same[15, 20] = False
    np.testing.assert_array_equal(delta[same], np.asarray(whole.predictor("knock").delta)[same])
    prior, posterior = images(pairs)
    others = [k for k in range(2, 12, 2)]
    change = [posterior[k][tuple(pairs.centre[k][::-1])] - prior[k][tuple(pairs.centre[k][::-1])]
              for k in others]  # fmt: skip
    np.testing.assert_allclose(delta[15, 20], np.mean(change), atol=1e-6)
    blind = replace(pairs, prior=np.zeros_like(pairs.prior))
    with pytest.raises(BadDataset, match="knock: 1200 of 1200 ROI pixels have no depth reading"):
        fit(blind)


def test_errors_are_the_mean_distance_of_matched_points(pairs):
    bank = fit(pairs)
    error, change = roi_errors_mm(bank, pairs, "poke")
    prior, posterior = images(pairs)
    r_max = float(metric.ray_lengths(PAPER_BOX).max())
    delta = np.asarray(bank.predictor("poke").delta)
    for n, k in enumerate(np.flatnonzero(pairs.action == "poke")):
        u, v = pairs.centre[k]
        window = np.s_[v - 13 : v + 13, u - 12 : u + 12]
        gap = np.abs(np.clip(prior[k][window] + delta, 0, 1) - posterior[k][window])
        np.testing.assert_allclose(error[n], gap.mean() * r_max * 50, rtol=1e-3)
        moved = np.abs(posterior[k][window] - prior[k][window])
        np.testing.assert_allclose(change[n], moved.mean() * r_max * 50, rtol=1e-3)


@pytest.mark.full
def test_evaluation_lists_every_action_and_agent(pairs):
    scores = evaluate(fit(pairs), pairs)
    assert [(s.action, s.agent, s.count) for s in scores] == [
        (a, g, 3) for a in ("knock", "poke") for g in ("robot", "human")
    ]
    folds = cross_validate(pairs, partitions=3)
    assert all(s.count == 3 and 0 < s.mean_mm < s.change_mm for s in folds)
    assert cross_validate(pairs, seed=1) == cross_validate(pairs, seed=1)
    assert cross_validate(pairs, seed=1) != cross_validate(pairs, seed=2)


@pytest.mark.full
def test_what_cannot_be_fitted_or_tested_is_refused(pairs):
    with pytest.raises(UnknownName, match="'Q'; allowed: D"):
        fit(pairs, "Q")
    with pytest.raises(BadDataset, match="no pairs"):
        fit(pairs.select(np.zeros(len(pairs), bool)))
    with pytest.raises(BadDataset, match="1 pair.* cannot be split"):
        cross_validate(pairs.select(np.array([0, 1])))
    other = replace(pairs, camera=replace(PAPER_BOX, fx=500.0))
    with pytest.raises(JShapeError, match="fx is 433, the data set's 500"):
        evaluate(fit(pairs), other)
    moved = replace(pairs, centre=np.full_like(pairs.centre, 3))
    with pytest.raises(BadDataset, match="pair p0: the 40x30 ROI of knock"):
        fit(moved)
    with pytest.raises(UnknownName, match="'tap'; allowed: knock, poke"):
        pairs.of(action="tap")


@pytest.mark.full
@pytest.mark.parametrize("kind", ["C", "P"])
def test_a_fit_that_went_wrong_is_not_kept(pairs, monkeypatch, tmp_path, kind):
    """A predictor that is off on held-out pairs: f_D instead, with a warning and the numbers."""
    from jshape.learn import fit as fitting

    def wrong_for_pokes(examples, camera, settings, start, hooks):
        found = fit_difference(examples.prior, examples.posterior)
        good = examples.prior.shape[2] == 40  # a knock's ROI
        return found if good else Difference(-3.0 * found.delta)

    monkeypatch.setitem(fitting.FITTERS, kind, wrong_for_pokes)
    with pytest.warns(UserWarning) as told:
        bank = fit(pairs, kind, validation=0.4)
    rows = validate(fitting.fit(pairs, kind), pairs, validation=0.4)
    (row,) = [r for r in rows if r.action == "poke"]
    assert row.worse and not row.useless and row.mm > 3 * row.nothing_mm > 3 * row.difference_mm
    assert [str(one.message) for one in told] == [
        f"poke: on {row.tested} held-out pairs, mm off: f_{kind} {row.mm:.2f}, the mean difference "
        f"{row.difference_mm:.2f}, doing nothing {row.nothing_mm:.2f}; the mean difference is kept "
        "for it"
    ]
    np.testing.assert_allclose(bank.errors_mm[1], row.difference_mm, rtol=1e-6)
    if kind == "P":  # the mean difference from above: the hand can be turned
        assert isinstance(bank.predictor("poke"), Imprint)
        error, change = roi_errors_mm(bank, pairs, "poke")
        assert error.mean() < 0.5 * change.mean()
        return
    one = validate(fitting.fit(pairs, kind), pairs, validation=0.2)  # a single pair says nothing
    assert [(r.tested, r.worse, r.useless) for r in one] == [(1, False, False)] * 2
    delta = fit(pairs, "D").predictor("poke").delta
    np.testing.assert_array_equal(bank.predictor("poke").delta, delta)
    bank = Bank(PAPER_BOX, (bank.predictor("poke"),), ("poke",), "C")
    found = load_bank(save_bank(bank, tmp_path / "bank"))
    assert found.kind == "C"
    np.testing.assert_array_equal(found.predictor("poke").delta, delta)


def test_pairs_that_show_no_action_are_said(pairs):
    """Half of them sink and half rise: the mean difference is no better than doing nothing."""
    prior, posterior = pairs.prior.copy(), pairs.posterior.copy()
    other = np.arange(len(pairs)) % 4 < 2
    prior[other], posterior[other] = pairs.posterior[other], pairs.prior[other]
    with pytest.warns(UserWarning, match="its pairs do not show what it does: look at their boxes"):
        fit(replace(pairs, prior=prior, posterior=posterior).of(action="poke"))


@pytest.mark.parametrize(("count", "rows"), [(1, 0), (2, 1), (3, 1)])
def test_few_pairs_are_compared_and_their_error_is_not_claimed(pairs, count, rows):
    few = pairs.of(action="poke").select(np.arange(count))
    bank = fit(few)
    assert bank.errors_mm is None and len(validate(bank, few)) == rows


def test_pairs_of_a_lens_that_distorts_are_refused(pairs):
    bent = replace(pairs.camera, lens=(0.05, 0, 0, 0, 0, 0, 0, 0))
    with pytest.raises(BadCamera, match="lens distorts; jshape heightmap makes a height map of"):
        fit(replace(pairs, camera=bent))
