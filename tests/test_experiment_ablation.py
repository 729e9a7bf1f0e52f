"""What is left out of f_P is really left out, and the page says what that changes."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.experiments import ablation, components
from benchmarks.experiments.__main__ import main
from benchmarks.experiments.components import (
    AsSeen,
    Trials,
    Variant,
    added,
    fit_variant,
    left_out,
)
from jshape.data.pairs import Pairs
from jshape.io import datasets
from jshape.learn import imprint as learning
from jshape.learn.imprint import SCALES, fit_imprint, fitted
from jshape.learn.scores import Trial
from jshape.models.difference import fit_difference
from tests.test_imprint import CAMERA, examples_of, tool


@pytest.fixture(scope="module")
def examples():
    """Six pairs of a round tool on hills."""
    return examples_of(tool(), 6)


@pytest.fixture
def short(monkeypatch):
    """Fits of three steps."""
    monkeypatch.setattr(learning, "STEPS", (3, 3))
    monkeypatch.setattr(learning, "PER_MANY", 0)


def pairs_of(examples, strengths=None):
    """The ROIs of examples as small images of their own: a data set of two actions."""
    h, w = examples.prior.shape[1:]
    camera = replace(CAMERA, width=w, height=h, u0=w / 2, v0=h / 2)
    many = len(examples.prior)
    prior, posterior = (
        np.asarray(1e4 * camera.depth(np.clip(255 * roi, 1, 250)), np.uint16)
        for roi in (np.asarray(examples.prior), np.asarray(examples.posterior))
    )
    return Pairs(
        camera=camera, depth_unit=1e-4, prior=prior, posterior=posterior,
        action=np.array(["knock", "poke"] * (many // 2)), agent=np.array(["robot"] * many),
        material=np.array(["flour"] * many),
        centre=np.array([[w // 2, h // 2]] * many, np.int32),
        size=np.array([[w, h]] * many, np.int32), id=np.array([f"{k}" for k in range(many)]),
        strength=np.ones(many, np.float32) if strengths is None else strengths,
    )  # fmt: skip


@pytest.fixture(scope="module")
def pairs():
    return pairs_of(examples_of(tool(), 8))


def without(examples, *left, **view):
    return fit_variant(Variant("", "", left, **view), examples, CAMERA)


@pytest.mark.slow
@pytest.mark.parametrize("strengths", [None, (0.3, 2.0)])
def test_with_all_components_it_is_f_p(short, strengths):
    for turned in (False, True):  # an action that raises the ground has no tool
        examples = examples_of(tool(), 4, strengths=strengths)
        if turned:
            examples = examples._replace(prior=examples.posterior, posterior=examples.prior)
        expected = fit_imprint(examples, CAMERA)
        for name in fitted(expected):
            found = getattr(without(examples), name)
            np.testing.assert_array_equal(found, getattr(expected, name))


@pytest.mark.slow
def test_what_is_left_out_stays_as_it_was_and_the_rest_is_fitted(examples, short):
    guess = without(examples, "descent")
    maps = ("reference", "tool", "give", "rest", "swell", "follow")
    for left in ((), ("swell",), ("rest",), ("follow",), ("reference",), ("tool",)):
        found = without(examples, *left)
        still = set(left) | ({"tool", "give", "swell"} if "tool" in left else set())
        for name in maps:
            same = np.array_equal(getattr(found, name), getattr(guess, name))
            gone = not np.asarray(getattr(found, name)).any()
            if name not in still:
                assert not same and not gone, (left, name)
            elif name in ("reference", "tool"):
                assert same, (left, name)
            else:
                assert gone, (left, name)


@pytest.mark.slow
def test_without_a_tool_the_first_guess_is_the_mean_change(examples):
    off = without(examples, "tool", "descent", "absolute")
    flat = jnp.full(off.tool.shape, off.grid.depth)
    assert float(off.deepest) == pytest.approx(float(off.rest.max()))
    np.testing.assert_allclose(off.change(flat), off.rest, atol=1e-7)


@pytest.mark.slow
def test_squares_are_lowered_if_absolute_errors_are_not(examples, monkeypatch):
    monkeypatch.setattr(learning, "STEPS", (40, 40))
    monkeypatch.setattr(learning, "PER_MANY", 0)
    true = np.asarray(examples.posterior)
    errors = {}
    for left in ((), ("absolute",)):
        found = without(examples, *left)
        after = found(jnp.asarray(examples.prior), jnp.asarray(examples.corner))
        errors[left] = np.asarray(after) - true
    mean = {left: float(np.abs(gap).mean()) for left, gap in errors.items()}
    square = {left: float((gap**2).mean()) for left, gap in errors.items()}
    assert mean[()] < mean["absolute",] and square[()] != square["absolute",]


@pytest.mark.slow
def test_the_image_itself_knows_no_place(examples):
    roi = jnp.asarray(examples.prior[0])

    def changes(**view):
        found = without(examples, "tool", "descent", **view)
        places = jnp.array([[0, 0], [400, 300]], jnp.int32)
        return [np.asarray(found(roi, place) - roi) for place in places]

    here, there = changes(view=AsSeen)
    np.testing.assert_allclose(here, there, atol=1e-6)
    # The mean change, on a grid of half the resolution.
    mean = np.asarray(fit_difference(examples.prior, examples.posterior).delta)
    assert np.abs(here - mean).mean() < 0.15 * np.abs(mean).mean()
    here, there = changes()
    assert np.abs(here - there).mean() > 0.1 * np.abs(here).mean()


KNOWN = {"depth", "descent", "absolute", "mirror", "heap", *SCALES} - {"give"}


@pytest.mark.parametrize("varied", [False, True])
def test_each_step_has_one_component_more_and_the_last_is_all_of_f_p(varied):
    chain, without = added(varied), left_out(varied)
    assert [chain[0].name, chain[-1].name, without[0].name] == ["f_D", "f_P", "f_P"]
    assert chain[-1].without == without[0].without == ()
    for before, after in zip(chain[1:], chain[2:], strict=False):
        assert len(set(before.without) - set(after.without) - {"descent"}) == 1
        assert set(after.without) < set(before.without) <= KNOWN
    assert [set(v.without) for v in without[2:]] == [{n} for n in components.SAID if n in KNOWN][
        : len(without) - 2
    ]
    assert any("stroke" in v.without for v in without) == varied
    said = {v.name: v.said for v in (*chain, *without)}
    assert "descent" in said["f_D with view, absolute"]
    assert said["f_P without absolute"].startswith("squared error")
    assert "growing rims" in said["f_P without tool"]
    assert len({v.name for v in (*chain, *without)}) == len(chain) + len(without) - 1


@pytest.mark.full
def test_variants_that_do_the_same_are_fitted_once(pairs, monkeypatch):
    made = []
    real = components.bank_of
    monkeypatch.setattr(components, "bank_of", lambda v, *a: (made.append(v.name), real(v, *a))[1])
    guess = ("descent", "tool")
    several = [Variant("f_D", ""), Variant("a", "", guess), Variant("b", "", guess[::-1]),
               Variant("c", "", guess, AsSeen)]  # fmt: skip
    trials = Trials(pairs, several, 2, 0)
    found = [trial for step in trials for trial in step]
    assert made == ["f_D", "a", "c"] * 2 and len(trials) == 6
    errors = {name: [t.error_mm.tolist() for t in found if t.predictor == name] for name in "abc"}
    assert errors["a"] == errors["b"] != errors["c"] and len(errors["a"]) == 4
    assert all(set(t.id) <= set(pairs.of(action=t.action).id) for t in found)


@pytest.mark.slow
def test_the_changes_add_up_from_f_d_to_f_p(tmp_path, pairs, short, capsys):
    datasets.save_pairs(pairs, tmp_path / "data")
    out = tmp_path / "out"
    code = main(["ablation", "--data", str(tmp_path / "data"), "--out", str(out),
                 "--actions", "poke", "--partitions", "2"])  # fmt: skip
    assert code == 0, capsys.readouterr().err
    from jshape.io.files import read_json

    rows = read_json(out / "results.json")["rows"]
    chain = [row for row in rows if row["part"] == ablation.ADDED]
    assert [row["step"] for row in chain] == list(range(len(added(False))))
    whole = sum(row["changed_by_mm"] for row in chain[1:])
    assert whole == pytest.approx(chain[-1]["mean_mm"] - chain[0]["mean_mm"], abs=1e-5)
    for row in (row for row in rows if row["part"] == ablation.LEFT_OUT and row["step"]):
        gap = row["mean_mm"] - chain[-1]["mean_mm"]
        assert row["changed_by_mm"] == pytest.approx(gap, abs=1e-5) and row["count"] == 2
    page = (out / "page.html").read_text()
    assert all(f"{row['mean_mm']:.3f} ± {row['std_mm']:.3f}" in page for row in rows)
    assert all(row["actions_std_mm"] == pytest.approx(row["std_mm"], abs=1e-6) for row in rows)


LINE = {"set": "s", "agent": "robot", "part": "added", "step": 1, "component": "i",
        "predictor": "f_P", "std_mm": 0.1, "actions_std_mm": 0.07, "change_mm": 3.0, "better": 0.5,
        "over_whole_mm": None, "over_whole_error_mm": None}  # fmt: skip


def test_means_are_over_the_actions_and_errors_shrink_with_them():
    rows = [LINE | {"action": a, "mean_mm": m, "changed_by_mm": c, "changed_error_mm": e}
            for a, m, c, e in (("poke", 1.0, -0.2, 0.03), ("knock", 2.0, -0.4, 0.04))]  # fmt: skip
    (mean,) = ablation.mean_over_actions(rows, "s", "robot")
    assert (mean["mean_mm"], mean["changed_by_mm"]) == pytest.approx((1.5, -0.3))
    assert mean["changed_error_mm"] == pytest.approx(0.025)
    assert mean["std_mm"] == 0.07


def test_the_spread_is_that_of_the_mean_over_the_actions():
    def trial(action, error):
        one = np.full(2, error)
        return Trial("f_P", "robot", "robot", action, 6, np.array(["a", "b"]), one, one)

    # Two partitions: what one action is worse by, the other is better by.
    trials = [trial("poke", 1.0), trial("knock", 3.0), trial("poke", 2.0), trial("knock", 2.0)]
    assert ablation._spread(trials, "f_P", "robot") == 0.0
    assert ablation._spread(trials[:3] + trials[1:2], "f_P", "robot") == pytest.approx(0.25)


def test_the_page_says_what_harms_and_claims_no_gain_that_noise_may_be():
    def line(part, step, name, by=None, error=None, over=None):
        return LINE | {"part": part, "step": step, "component": name, "predictor": name,
                       "mean_mm": 1.0, "changed_by_mm": by, "changed_error_mm": error,
                       "over_whole_mm": over, "over_whole_error_mm": over and 0.01}  # fmt: skip

    start = [line("added", 0, "f_D", over=0.2), line("left out", 0, "f_P")]
    mean = [*start, line("added", 1, "tool", -0.3, 0.1, -0.05), line("added", 2, "salt", 0.2, 0.09),
            line("left out", 1, "rims gone", 0.3, 0.1),
            line("left out", 2, "salt gone", -0.3, 0.1)]  # fmt: skip
    _, up, ahead, down = ablation.words([mean], 4)
    assert "most is gained by: tool -0.300 mm" in up
    assert "The error grows with: salt +0.200 mm. These are harmful" in up
    assert ahead == "Better than f_P with all its components: tool -0.050 mm."
    assert "grows: rims gone +0.300 mm" in down and "falls: salt gone -0.300 mm" in down
    noise = [*start, line("added", 1, "tool", -0.3, 0.2, 0.05),
             line("left out", 1, "rims gone", -0.3, 0.2)]  # fmt: skip
    _, up, down = ablation.words([noise], 4)
    assert "none gains more than twice its standard error" in up and "harmful" not in up + down
    assert "No change beyond twice the standard error: rims gone." in down
