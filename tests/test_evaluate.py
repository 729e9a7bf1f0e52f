"""Evaluation: the same partitions for all, hand-computed errors and floors, tables, the command."""

import csv
import json
from dataclasses import replace
from itertools import chain

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import PAPER_BOX, Bank, Pairs, load_bank, metric, save_bank, save_pairs, to_mm
from jshape.cli.evaluate import _explained
from jshape.cli.main import main
from jshape.data.missing import fill_nan
from jshape.data.simulate import simulate_pairs, together
from jshape.errors import BadBank, BadCamera, BadDataset, JShapeError, UnknownName
from jshape.io.kinds import KINDS
from jshape.learn import study as studies
from jshape.learn.evaluate import cross_validate, evaluate, few_shot, scores_of
from jshape.learn.fit import FITTERS, fit
from jshape.learn.noise_floor import noise_floor
from jshape.learn.report import markdown, scores_csv, scores_figure, scores_table, sizes_table
from jshape.learn.scores import Comparison, Score, Trial, compare, roi_errors_mm, summarise
from jshape.learn.study import Candidate, Study, split_pairs
from jshape.models.difference import Difference, fit_difference
from jshape.models.refined import Refined
from jshape.viz.style import png

UNIT = 1e-5


@pytest.fixture
def pairs(rng):
    """Two actions, two agents, 8 pairs of each: a level bed gets a pit whose depth varies."""
    return pits(rng, ["robot", "human"], 8)


def pits(rng, agents, each, *, deepest=600, centre=None, rough=0):
    count, (h, w) = 2 * len(agents) * each, PAPER_BOX.shape
    prior = np.full((count, h, w), round(0.44 / UNIT), np.uint16)
    if rough:
        prior += rng.integers(0, rough, (count, 1, 1)).astype(np.uint16)
    posterior = prior.copy()
    if centre is None:
        centre = np.stack([rng.integers(60, 420, count), rng.integers(60, 330, count)], -1)
    depth = rng.integers(400, deepest, count)
    for k, (u, v) in enumerate(centre):
        posterior[k, v - 10 : v + 10, u - 10 : u + 10] += depth[k].astype(np.uint16)
    action = np.array(["knock", "poke"] * (count // 2))
    return Pairs(
        camera=PAPER_BOX, depth_unit=UNIT, prior=prior, posterior=posterior, action=action,
        agent=np.repeat(agents, 2 * each), material=np.array(["flour"] * count), centre=centre,
        size=np.where(action[:, None] == "knock", [[40, 30]], [[24, 26]]),
        id=np.array([f"p{k}" for k in range(count)]),
    )  # fmt: skip


def half(examples, camera, settings, start, hooks):
    """A predictor to compare with: half of f_D, or where it started from."""
    if start is not None:
        return start
    change = np.nanmean(examples.posterior - examples.prior, 0)
    return Difference(jnp.asarray(0.5 * change, jnp.float32))


@pytest.fixture
def kind_h(monkeypatch):
    monkeypatch.setitem(FITTERS, "H", half)


def test_partitions_split_every_action_of_every_agent_once(pairs):
    splits = split_pairs(pairs, 3, 0.25, 0)
    for per_agent in splits:
        for agent, (train, test) in per_agent.items():
            together = np.sort(np.concatenate([train, test]))
            np.testing.assert_array_equal(together, np.flatnonzero(pairs.agent == agent))
            assert sorted(pairs.action[test]) == ["knock"] * 2 + ["poke"] * 2
    assert not np.array_equal(splits[0]["robot"].test, splits[1]["robot"].test)


@pytest.mark.full
def test_all_candidates_are_tested_on_the_same_pairs(pairs, kind_h):
    """Paired: same tests, same changes; and f_D's numbers do not depend on its company."""
    study = Study(pairs, [Candidate("D"), Candidate("H")], partitions=3)
    steps = list(study)
    assert len(steps) == len(study) == 3 * 2 * 2
    for one, other in zip(steps[::2], steps[1::2], strict=True):
        assert [t.predictor for t in one + other] == ["D"] * 2 + ["H"] * 2
        for a, b in zip(one, other, strict=True):
            assert a.id.tolist() == b.id.tolist() and a.action == b.action
            np.testing.assert_array_equal(a.change_mm, b.change_mm)
            assert (a.error_mm < b.error_mm).all()  # half a pit is further off than a mean pit
    both = cross_validate(pairs, ["D", "H"], partitions=3)
    assert [s for s in both if s.predictor == "D"] == cross_validate(pairs, partitions=3)


@pytest.mark.full
def test_training_pairs_are_never_tested(pairs, monkeypatch):
    fitted = []

    def spy(training, *args, **more):
        fitted.append(set(training.id.tolist()))
        return fit(training, *args, **more)

    monkeypatch.setattr(studies, "fit", spy)
    for trials in Study(pairs, [Candidate("D")], across=True):
        for trial in trials:
            assert not fitted[-1] & set(trial.id.tolist())


@pytest.mark.full
def test_smaller_training_sets_are_nested_and_the_test_stays(pairs, monkeypatch):
    fitted = []

    def spy(training, *args, **more):
        fitted.append(training)
        return fit(training, *args, **more)

    monkeypatch.setattr(studies, "fit", spy)
    steps = list(Study(pairs, [Candidate("D")], partitions=1, sizes=(2, 4)))
    for small, large in (fitted[:2], fitted[2:]):
        assert set(small.id) < set(large.id)
        assert [int((small.action == a).sum()) for a in small.actions] == [2, 2]
    for small, large in zip(steps[::2], steps[1::2], strict=True):
        assert [(t.pairs, t.id.tolist()) for t in small] == [(2, t.id.tolist()) for t in large]
    scores = cross_validate(pairs, sizes=(2, 4), partitions=2)
    assert sorted({s.pairs for s in scores}) == [2, 4] and len(scores) == 2 * 2 * 2


@pytest.mark.full
def test_across_agents_names_both(pairs):
    scores = cross_validate(pairs, across=True, partitions=2)
    assert {(s.trained_on, s.agent) for s in scores} == {
        (a, b) for a in ("robot", "human") for b in ("robot", "human")
    }
    own = [s for s in scores if s.trained_on == s.agent]
    assert own == cross_validate(pairs, partitions=2)
    with pytest.raises(BadDataset, match="two; all pairs are of robot"):
        cross_validate(pairs.of(agent="robot"), across=True)


def test_refined_and_unrefined_share_one_training(pairs, monkeypatch):
    """Fitters that are quick stand in for networks: f_C is what is inside f_CR."""

    def refined(examples, *others):
        inside = half(examples, *others)
        mask = jnp.ones(inside.delta.shape, jnp.float32)
        return Refined(inside, fit_difference(*examples[:2]), mask, jnp.float32(0.1))

    fitted = []
    for kind, fitter in {"C": half, "CR": refined}.items():

        def spy(*arguments, kind=kind, fitter=fitter):
            fitted.append(kind)
            return fitter(*arguments)

        monkeypatch.setitem(FITTERS, kind, spy)
    study = Study(pairs.of(agent="robot"), [Candidate("C"), Candidate("CR")], partitions=1)
    both = list(chain.from_iterable(study))
    assert fitted == ["CR", "CR"]  # once per action
    alone = list(chain.from_iterable(replace(study, candidates=[Candidate("C")])))
    assert fitted[2:] == ["C", "C"]
    for a, b in zip([t for t in both if t.predictor == "C"], alone, strict=True):
        np.testing.assert_array_equal(a.error_mm, b.error_mm)
    for a, b in zip([t for t in both if t.predictor == "CR"], alone, strict=True):
        assert (a.error_mm != b.error_mm).all()


@pytest.mark.full
def test_few_shot_compares_start_adapted_and_scratch(pairs, kind_h):
    start = fit(pairs.of(agent="human"), "H")
    scores = scores_of(few_shot(pairs.of(agent="robot"), start, (2, 4), partitions=2))
    found = {(s.predictor, s.pairs) for s in scores}
    assert found == {("start as it is", 0)} | {
        (name, n) for name in ("H from start", "H from scratch", "D from scratch") for n in (2, 4)
    }
    errors = {(s.predictor, s.pairs, s.action): s.mean_mm for s in scores}
    # `half` returns what it started from, so adapting changes nothing.
    assert errors["start as it is", 0, "poke"] == errors["H from start", 4, "poke"]
    with pytest.raises(BadBank, match="'D'"):
        few_shot(pairs, fit(pairs))
    with pytest.raises(BadBank, match="knows knead; the pairs are of knock, poke"):
        few_shot(pairs, Bank(PAPER_BOX, start.predictors[:1], ("knead",), "H"), (2,))


@pytest.mark.full
def test_other_rois_are_measured_over_the_same_pixels(pairs):
    """A bank with a smaller (larger) ROI predicts no change around it (is cut)."""
    whole = fit(pairs)
    delta = np.asarray(whole.predictor("knock").delta)  # (30, 40), centred at [15, 20]
    small = Bank(PAPER_BOX, (Difference(jnp.asarray(delta[5:24, 9:33])),), ("knock",))
    padded = np.zeros((30, 40), np.float32)
    padded[6:25, 8:32] = delta[5:24, 9:33]  # its centre [9, 12] falls on [15, 20]
    same = Bank(PAPER_BOX, (Difference(jnp.asarray(padded)),), ("knock",))
    np.testing.assert_allclose(
        roi_errors_mm(small, pairs, "knock", size=(40, 30))[0],
        roi_errors_mm(same, pairs, "knock")[0], rtol=1e-5,
    )  # fmt: skip
    large = np.pad(delta, ((3, 4), (5, 6)), constant_values=0.3)  # centred at [18, 25]
    large = Bank(PAPER_BOX, (Difference(jnp.asarray(large)),), ("knock",))
    np.testing.assert_allclose(
        roi_errors_mm(large, pairs, "knock", size=(40, 30))[0],
        roi_errors_mm(whole, pairs, "knock")[0], rtol=1e-5,
    )  # fmt: skip


class Finite(Difference):
    """Refuses gaps, as predictors other than f_D may."""

    def __call__(self, roi, corner, strength=1.0):
        return jnp.where(jnp.isfinite(roi).all(), 1.0, jnp.nan) * super().__call__(
            roi, corner, strength
        )


@pytest.mark.full
def test_each_pair_is_predicted_along_its_own_path():
    """Of a bank whose sweeps are 85 mm long, pairs of 85 and of 119 mm."""
    bank = load_bank("moving-flour-robot")
    usual, longer = (
        together(simulate_pairs(jax.random.key(k), 1, actions=("sweep",), length=length))
        for k, length in ((3, 1.0), (4, 1.4))
    )
    names = ("prior", "posterior", "action", "agent", "material", "centre", "size", "id",
             "strength", "path_mm")  # fmt: skip
    both = replace(usual, **{
        name: np.concatenate([getattr(one, name) for one in (longer, usual)]) for name in names
    })  # fmt: skip
    error, change = roi_errors_mm(bank, both, "sweep")
    alone = roi_errors_mm(bank, usual, "sweep")
    np.testing.assert_allclose((error[1], change[1]), np.ravel(alone), rtol=1e-6)
    # By hand, the same hand drawn 1.4 times as far, in a window as much longer.
    hand = bank.predictor("sweep").lengthened(float(longer.path_mm[0]) / 85.0)
    rois = longer.rois("sweep", hand.roi, padded=True)
    after = hand(jnp.asarray(fill_nan(rois.prior[0])), rois.corner[0], rois.strengths[0])
    off = np.abs(np.asarray(after) - rois.posterior[0])[rois.seen[0]].mean()
    assert error[0] == pytest.approx(float(to_mm(off, PAPER_BOX)), rel=1e-4)
    assert hand.roi[0] == bank.roi("sweep")[0] + 34  # 34 mm, a pixel each
    # Predicted as if it were 85 mm long it is farther off, over the same pixels.
    shorter = replace(both, path_mm=np.full(2, 85.0, np.float32))
    wrong = roi_errors_mm(bank, shorter, "sweep", size=hand.roi)[0]
    assert error[0] < 0.7 * wrong[0]
    (line,) = evaluate(bank, both)
    assert line.mean_mm == pytest.approx(error.mean(), rel=1e-6)


@pytest.mark.full
def test_gaps_are_filled_for_the_predictor_and_left_out_of_the_error(pairs):
    jax.tree_util.register_dataclass(Finite)
    bank = fit(pairs)
    other = Bank(PAPER_BOX, tuple(Finite(p.delta) for p in bank.predictors), bank.actions)
    u, v = pairs.centre[0]
    holed = replace(pairs, prior=pairs.prior.copy())
    holed.prior[0, v - 2 : v + 2, u : u + 5] = 0
    error, _ = roi_errors_mm(other, holed, "knock")
    assert np.isfinite(error).all()
    np.testing.assert_allclose(error, roi_errors_mm(bank, holed, "knock")[0], rtol=1e-5)
    whole = roi_errors_mm(bank, pairs, "knock")[0]
    np.testing.assert_allclose(error[1:], whole[1:], rtol=1e-5)
    # By hand: the mean over the 1180 pixels seen of what the whole pair is off by.
    rois = pairs.rois("knock")
    gap = np.abs(rois.prior[0] + np.asarray(bank.predictor("knock").delta) - rois.posterior[0])
    gap[13:17, 20:25] = np.nan
    by_hand = np.nanmean(gap) * float(metric.to_mm(1.0, PAPER_BOX))
    np.testing.assert_allclose(error[0], by_hand, rtol=1e-4)


def test_strength_reaches_the_predictor(pairs):
    bank = fit(pairs)
    rois = pairs.rois("poke")
    delta = np.asarray(bank.predictor("poke").delta)
    gap = np.abs(np.clip(rois.prior + 2.5 * delta, 0, 1) - rois.posterior).mean((1, 2))
    deeper = replace(pairs, strength=np.full(len(pairs), 2.5, np.float32))
    error, _ = roi_errors_mm(bank, deeper, "poke")
    np.testing.assert_allclose(error, gap * float(metric.to_mm(1.0, PAPER_BOX)), rtol=1e-4)


def test_the_floor_of_exact_repetitions_is_zero(rng):
    places = np.repeat([[100, 100], [300, 200]], 6, 0)
    pairs = pits(rng, ["robot"], 6, deepest=401, centre=places)  # always 400 counts
    for floor in noise_floor(pairs).values():
        assert (floor.mm, floor.how, floor.count) == (0.0, "repetitions", 2 * 3)


def test_the_floor_is_the_mean_difference_over_sqrt_2(rng):
    pairs = pits(rng, ["robot"], 4, centre=np.full((8, 2), 200))
    floor = noise_floor(pairs)["poke", "robot"]
    after = pairs.rois("poke").posterior
    gaps = [np.abs(after[a] - after[b]).mean() for a in range(4) for b in range(a)]
    by_hand = np.mean(gaps) * float(metric.to_mm(1.0, PAPER_BOX)) / 2**0.5
    assert (floor.how, floor.count) == ("repetitions", 6)
    np.testing.assert_allclose(floor.mm, by_hand, rtol=1e-4)
    other_beds = replace(
        pairs, prior=pairs.prior + 100 * np.arange(8, dtype=np.uint16)[:, None, None]
    )
    assert noise_floor(other_beds)["poke", "robot"].how == "flat"
    mixed = replace(pairs, material=np.array([*"aaaabbbb"]))
    assert ("poke", "robot") not in noise_floor(mixed)  # one couple of each material is too few


def test_the_best_constant_is_at_the_floor(rng):
    """What the division by the root of 2 claims, for normal repetitions around one result."""
    draws = rng.normal(size=4000)
    pair_gap = np.abs(draws[:2000] - draws[2000:]).mean()
    np.testing.assert_allclose(pair_gap / 2**0.5, np.abs(draws).mean(), rtol=0.05)


def test_the_floor_of_flat_beds_at_other_places(rng):
    """Levels differ by 1 mm; the pits do not: nothing is left but the grid's interpolation."""
    pairs = pits(rng, ["robot"], 4, deepest=401, rough=100)
    for floor in noise_floor(pairs).values():
        assert floor.how == "flat" and floor.count == 6
        assert floor.mm < 0.35  # of a pit of 4 mm; its walls are a pixel or two wide
    hills = pairs.prior + (500 * np.sin(np.arange(480) / 9) ** 2).astype(np.uint16)
    assert noise_floor(replace(pairs, prior=hills)) == {}


def test_surfaces_without_a_common_pixel_give_no_floor(rng, monkeypatch):
    pairs = pits(rng, ["robot"], 4, deepest=401, rough=100)
    monkeypatch.setattr(
        "jshape.learn.noise_floor._from_above", lambda *_: jnp.full((4, 4), jnp.nan)
    )
    assert noise_floor(pairs) == {}


def trial(predictor, errors, ids="abc", **more):
    fixed = {"trained_on": "robot", "agent": "robot", "action": "poke", "pairs": 5} | more
    errors = np.array(errors, float)
    return Trial(predictor, **fixed, id=np.array([*ids]), error_mm=errors, change_mm=errors + 5)


def test_summary_and_comparison_by_hand():
    trials = [
        trial("D", [1.0, 2.0, 3.0]), trial("P", [0.5, 1.0, 3.0]),
        trial("D", [4.0, 2.0], "ad"), trial("P", [4.5, 1.0], "ad"),
    ]  # fmt: skip
    d, p = summarise(trials)
    assert (d.count, d.mean_mm, d.floor_mm) == (5, 2.4, None) and p.mean_mm == 2.0
    assert d.std_mm == np.std([2.0, 3.0])  # of the partitions' means
    assert d.change_mm == pytest.approx(7.4)
    (found,) = compare(trials, "D")
    gaps = [np.mean([-0.5, 0.5]), -1.0, 0.0, -1.0]  # pair a was tested twice and counts once
    assert found.count == 4 and found.better == 0.5
    assert found.difference_mm == pytest.approx(np.mean(gaps))
    assert found.error_mm == pytest.approx(np.std(gaps, ddof=1) / 2)


def test_tables_say_what_the_scores_say():
    trials = [trial(n, e, action=a) for n, e in (("D", [2.0] * 3), ("P", [1.0] * 3)) for a in "xy"]
    head, rows = scores_table(summarise(trials))
    assert head[-3:] == ("D (mm)", "P (mm)", "P / D")
    assert rows[0] == ("x", "robot", "3", "7.00", "-", "2.00 ± 0.00", "1.00 ± 0.00", "0.50")
    assert rows[-1][0] == "mean" and rows[-1][-1] == "0.50"
    text = markdown(head, rows)
    assert text.splitlines()[1] == "|" + " --- |" * 8 and text.count("\n") == 5
    read = list(csv.DictReader(scores_csv(summarise(trials)).splitlines()))
    assert read[0]["mean_mm"] == "2.0" and read[0]["floor_mm"] == "" and len(read) == 4
    sized = [trial("D", [2.0], "a", pairs=n, action=a) for n in (0, 5) for a in "xy"]
    assert [row[1] for row in sizes_table(summarise(sized))[1]] == ["none", "5"]
    assert png(scores_figure(summarise(trials)))[:4] == b"\x89PNG"


@pytest.mark.parametrize("name", ["D", "P from a bank with a name that goes on and on"])
def test_the_legend_fits_beside_one_action(name):
    scores = summarise([trial(name, [2.0])])
    figure = scores_figure([scores[0]._replace(floor_mm=0.5, floor_from="flat")])
    figure.canvas.draw()
    box, whole = figure.legends[0].get_window_extent(), figure.bbox
    assert whole.x0 <= box.x0 and box.x1 <= whole.x1


def test_splits_that_make_no_sense_are_refused(pairs):
    for more, match in (
        ({"partitions": 0}, "partitions is 0"),
        ({"test_share": 0.0}, "test_share is 0.0"),
        ({"test_share": 1.0}, "test_share is 1.0"),
        ({"test_share": float("nan")}, "test_share is nan"),
    ):
        with pytest.raises(JShapeError, match=match):
            split_pairs(pairs, **more)
        with pytest.raises(JShapeError, match=match):
            Study(pairs, [Candidate("D")], **more)
    with pytest.raises(BadDataset, match="no pairs"):
        Study(pairs.select(np.arange(0)), [Candidate("D")])


def test_what_cannot_be_compared_is_refused(pairs, kind_h):
    with pytest.raises(UnknownName, match="'Q'; allowed: D"):
        cross_validate(pairs, ["D", "Q"])
    with pytest.raises(BadDataset, match="12 pairs per action: knock of robot has 6"):
        cross_validate(pairs, sizes=(5, 12))
    with pytest.raises(JShapeError, match="different ones"):
        list(Study(pairs, [Candidate("D"), Candidate("D")]))
    with pytest.raises(BadBank, match="has no bank"):
        Study(pairs, [Candidate("H", fitted=False)])
    other = replace(pairs, camera=replace(PAPER_BOX, fx=500.0))
    with pytest.raises(BadCamera, match="fx"):
        few_shot(other, fit(pairs, "H"), (2,))
    blind = replace(pairs, posterior=np.zeros_like(pairs.posterior))
    with pytest.raises(BadDataset, match="pair p0: no pixel of its ROI"):
        evaluate(fit(pairs), blind)


@pytest.fixture
def folder(tmp_path, pairs, monkeypatch):
    """A data set on disk, in the working directory."""
    monkeypatch.chdir(tmp_path)
    save_pairs(pairs, tmp_path / "pairs")
    return tmp_path


@pytest.mark.full
def test_the_command_writes_every_table_and_figure(folder, capsys, pairs, kind_h, monkeypatch):
    monkeypatch.setitem(KINDS, "H", KINDS["D"])
    save_bank(fit(pairs.of(agent="human"), "H"), folder / "human-bank")
    arguments = ["evaluate", "pairs", "--kinds", "D", "H", "--partitions", "2", "--width", "2",
                 "--across-agents", "--sizes", "2", "5", "25", "--start", "human-bank", "--few",
                 "3", "--out", "out"]  # fmt: skip
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "training sets of 25 pairs are left out: knock of robot has 6" in text
    assert "robot -> human" in text and "H from human-bank" in text and "pair by pair" in text
    rows = list(csv.DictReader((folder / "out" / "scores.csv").read_text().splitlines()))
    assert len(rows) == 2 * 4 * 2  # kinds, couples of agents, actions
    assert "D (mm) | H (mm) | H / D" in (folder / "out" / "scores.md").read_text()
    for name in ("scores.png", "sizes.png", "transfer.png"):
        picture = cv2.imread(str(folder / "out" / name))
        assert min(picture.shape[:2]) > 200 and picture.std() > 10
    assert main([*arguments, "--overwrite", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["sizes"]) == 2 * 2 * 2 * 2 and result["notes"]
    assert {s["predictor"] for s in result["transfer"]} >= {"human-bank as it is"}
    assert result["scores"][0]["floor_mm"] > 0


@pytest.mark.full
def test_the_command_refuses_in_one_line(folder, capsys):
    for more, words in {
        ("--kinds", "D", "Q"): "'Q'; allowed: D",
        ("--kinds", "D", "--kind", "C"): "give one of the two",
        ("--few", "5"): "needs the bank to start from",
        ("--sizes", "25"): "sets of 25 pairs per action: knock of robot has 6",
        ("--bank", "bank", "--sizes", "5"): "--sizes: for fitting; with --bank nothing is fitted",
        ("--bank", "bank", "--patience", "0"): "--patience: for fitting",
    }.items():
        assert main(["evaluate", "pairs", *more]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and words in err


@pytest.mark.full
def test_without_few_a_small_data_set_adapts_with_what_it_has(folder, capsys, pairs, kind_h,
                                                              monkeypatch):  # fmt: skip
    monkeypatch.setitem(KINDS, "H", KINDS["D"])
    save_bank(fit(pairs, "H"), folder / "start")
    few = pairs.select(np.flatnonzero(pairs.agent == "robot")[:8])  # 4 of each, 3 to fit to
    save_pairs(few, folder / "few")
    for name, sizes in {"few": {0, 3}, "pairs": {0, 5}}.items():
        call = ["evaluate", name, "--partitions", "1", "--start", "start", "--json"]
        assert main(call) == 0
        result = json.loads(capsys.readouterr().out)
        assert {s["pairs"] for s in result["transfer"]} == sizes


@pytest.mark.parametrize(
    ("floor", "difference", "said"),
    [
        (0.87, 0.08, "is at the noise floor (0.85 mm, floor 0.87), so nothing is to be won here"),
        (0.5, 0.08, "4 pairs cannot tell them apart"),
        (None, -0.05, "4 pairs cannot tell them apart"),
        (0.5, 0.3, None),
    ],
)
def test_it_is_explained_why_a_predictor_is_not_better(floor, difference, said):
    base = Score("poke", "human", 8, 0.85, 0.01, 3.0, floor, "flat", "D", "human", 4)
    other = base._replace(predictor="P", mean_mm=0.85 + difference)
    pair = Comparison("poke", "human", "human", "P", "D", 4, difference, 0.059, 0.25)
    found = _explained([base, other], [pair])
    assert found == [] if said is None else said in found[0] and len(found) == 1
