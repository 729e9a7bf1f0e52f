"""The training loop, on a problem small enough to see through: one number per pixel."""

import json
import subprocess
import sys
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import PAPER_BOX, Pairs, fit, load_bank, load_pairs, save_bank, save_pairs
from jshape.cli.main import main
from jshape.data.pairs import Examples
from jshape.errors import BadDataset, BadFile, JShapeError
from jshape.io.banks import bank_manifest
from jshape.learn import fit as fitting
from jshape.learn import training
from jshape.learn.evaluate import cross_validate
from jshape.learn.settings import Training, settings_from
from jshape.learn.training import Hooks, roi_loss, split, train
from jshape.learn.validation import validate
from jshape.models.difference import Difference

QUICK = Training(epochs=12, batch=4, learning_rate=0.01, patience=0, save_every=3)


@pytest.fixture
def examples(rng):
    prior = rng.random((11, 3, 4)).astype(np.float32)
    change = np.linspace(-0.3, 0.3, 12, dtype=np.float32).reshape(3, 4)
    noise = 0.01 * rng.normal(size=prior.shape).astype(np.float32)
    return Examples(prior, prior + change + noise, np.zeros((11, 2), np.int32))


def zero():
    return Difference(jnp.zeros((3, 4)))


class Memory:
    """Keeps checkpoints, and dies after so many saves, as a process may."""

    where = "memory"

    def __init__(self, lives=10**9):
        self.kept, self.lives, self.saves = None, lives, 0

    def load(self):
        return self.kept

    def save(self, arrays, facts):
        self.kept = ({k: np.array(v) for k, v in arrays.items()}, dict(facts))
        self.saves += 1
        if self.saves >= self.lives:
            raise KeyboardInterrupt


def losses(found):
    return [row[:3] for row in found.curve]


@pytest.mark.full
def test_it_learns_and_is_reproducible(examples):
    found = train(roi_loss, zero(), examples, replace(QUICK, epochs=100))
    target = np.linspace(-0.3, 0.3, 12).reshape(3, 4)
    assert np.abs(np.asarray(found.params.delta) - target).max() < 0.03
    again = train(roi_loss, zero(), examples, replace(QUICK, epochs=100))
    assert losses(found) == losses(again)
    np.testing.assert_array_equal(found.params.delta, again.params.delta)
    other = train(roi_loss, zero(), examples, replace(QUICK, seed=1))
    assert losses(other) != losses(found)[:12]


@pytest.mark.full
@pytest.mark.parametrize("lives", [1, 2, 3])
def test_a_killed_training_ends_where_an_uninterrupted_one_does(examples, lives):
    whole = train(roi_loss, zero(), examples, QUICK)
    keep = Memory(lives)
    with pytest.raises(KeyboardInterrupt):
        train(roi_loss, zero(), examples, QUICK, Hooks(keep=keep))
    keep.lives = 10**9
    rest = train(roi_loss, zero(), examples, QUICK, Hooks(keep=keep))
    assert losses(rest) == losses(whole) and len(rest.curve) == 12
    np.testing.assert_array_equal(rest.params.delta, whole.params.delta)


def test_a_finished_training_is_not_repeated_but_may_be_made_longer(examples):
    keep, told = Memory(), []
    short = train(roi_loss, zero(), examples, QUICK, Hooks("poke", told.append, keep))
    assert [len(p.curve) for p in told] == list(range(1, 13))
    assert [p.done for p in told] == [False] * 11 + [True] and told[0].action == "poke"
    saves = keep.saves
    again = train(roi_loss, zero(), examples, QUICK, Hooks("poke", told.append, keep))
    assert again.curve == short.curve and keep.saves == saves
    assert len(told) == 13 and told[-1].done
    longer = train(roi_loss, zero(), examples, replace(QUICK, epochs=20), Hooks(keep=keep))
    assert losses(longer) == losses(train(roi_loss, zero(), examples, replace(QUICK, epochs=20)))


def test_a_checkpoint_of_something_else_is_refused(examples):
    keep = Memory()
    train(roi_loss, zero(), examples, QUICK, Hooks(keep=keep))
    moved = examples._replace(posterior=examples.posterior + np.float32(0.01))
    for start, data, settings in (
        (zero(), moved, QUICK),
        (zero(), examples, replace(QUICK, seed=1)),
        (zero(), examples, replace(QUICK, learning_rate=0.02)),
        (Difference(jnp.ones((3, 4))), examples, QUICK),
    ):
        with pytest.raises(BadFile, match="memory: holds a training with other pairs or settings"):
            train(roi_loss, start, data, settings, Hooks(keep=keep))
    del keep.kept[0]["leaf.0"]
    with pytest.raises(BadFile, match="memory: its checkpoint is incomplete"):
        train(roi_loss, zero(), examples, QUICK, Hooks(keep=keep))


def overshooting(params, batch):
    """Falls until `params` passes 0.05, then rises: the best is in the middle."""
    return jnp.abs(params["x"] - 0.05) + 0.0 * batch.prior.sum((1, 2))


@pytest.mark.full
def test_it_stops_when_nothing_improves_and_keeps_the_best(examples):
    start = {"x": jnp.asarray(0.0)}
    settings = replace(QUICK, epochs=200, learning_rate=0.03, patience=5, batch=100)
    found = train(overshooting, start, examples, settings)
    best = min(found.curve, key=lambda row: row.score)
    assert len(found.curve) == best.epoch + 5 < 200
    assert abs(abs(float(found.params["x"]) - 0.05) - best.validation) < 1e-7
    assert float(start["x"]) == 0.0  # not consumed
    assert len(train(overshooting, start, examples, replace(settings, patience=0)).curve) == 200


def test_the_split_is_the_seeds(examples):
    left, out = split(examples, Training(validation=0.2))
    assert (len(left.prior), len(out.prior)) == (9, 2)
    whole = np.concatenate([left.prior, out.prior])
    assert sorted(whole[:, 0, 0].tolist()) == sorted(examples.prior[:, 0, 0].tolist())
    for a, b in zip(out, split(examples, Training(validation=0.2))[1], strict=True):
        np.testing.assert_array_equal(a, b)
    two = examples.select(np.arange(2))
    assert [len(part.prior) for part in split(two, Training(validation=0.01))] == [1, 1]
    assert [len(part.prior) for part in split(two, Training(validation=0.9))] == [1, 1]
    assert len(split(examples, Training(validation=0.0))[0].prior) == 11


def test_too_few_pairs_are_refused(examples):
    with pytest.raises(BadDataset, match="no pairs to train with"):
        train(roi_loss, zero(), examples.select(np.arange(0)), QUICK)
    one = examples.select(np.arange(1))
    with pytest.raises(BadDataset, match="1 pair cannot be split .*validation=0"):
        train(roi_loss, zero(), one, QUICK)
    found = train(roi_loss, zero(), one, replace(QUICK, validation=0.0))
    assert np.isnan(found.curve[-1].validation) and found.curve[-1].score < found.curve[0].score
    blind = examples._replace(prior=examples.prior.copy())
    blind.prior[4] = np.nan
    with pytest.raises(BadDataset, match="1 of 11 pairs have no pixel .* number 5"):
        train(roi_loss, zero(), blind, QUICK)


@pytest.mark.full
def test_missing_pixels_do_not_count(examples, rng):
    holes = rng.random(examples.prior.shape) < 0.2
    holed = examples._replace(posterior=np.where(holes, np.nan, examples.posterior))
    loss = roi_loss(zero(), Examples(*map(jnp.asarray, holed)))
    gap = np.abs(examples.posterior - examples.prior)
    expected = [gap[k][~holes[k]].mean() for k in range(11)]
    np.testing.assert_allclose(loss, expected, rtol=1e-5)
    both = holed._replace(prior=np.where(np.roll(holes, 1), np.nan, examples.prior))
    slope = jax.grad(lambda p: roi_loss(p, Examples(*map(jnp.asarray, both))).sum())(zero())
    assert np.isfinite(slope.delta).all() and np.abs(slope.delta).max() > 0


def test_batches_hold_every_example_once(examples):
    order = np.random.default_rng(0).permutation(11)
    for most, size in ((4, 4), (8, 6), (100, 11), (1, 1), (10, 6)):
        seen = []
        for batch, counted in training._batches(examples, order, most):
            assert batch.prior.shape == (size, 3, 4)
            seen += np.asarray(batch.prior)[np.asarray(counted), 0, 0].tolist()
        assert seen == examples.prior[order, 0, 0].tolist()


TRACED = []


def counting(params, batch):
    TRACED.append(batch.prior.shape)
    return roi_loss(params, batch)


def test_a_second_training_compiles_nothing(examples):
    train(counting, zero(), examples, QUICK)
    first = len(TRACED)
    train(counting, zero(), examples.select(np.arange(11)[::-1]), replace(QUICK, seed=3))
    assert first > 0 and len(TRACED) == first


def nowhere(params, batch):
    return params.delta.sum() * jnp.nan + 0 * batch.prior.sum((1, 2))


def test_a_loss_that_is_no_number_stops_at_once(examples):
    with pytest.raises(JShapeError, match=r"poke: the loss of epoch 1 is nan; lower learning_rate"):
        train(nowhere, zero(), examples, QUICK, Hooks("poke"))


@pytest.mark.parametrize(
    "options, match",
    [
        ({"epoch": 3}, "unknown option of training 'epoch'; allowed: epochs, batch"),
        ({"epochs": 0}, "epochs is 0; expected a whole number from 1 to"),
        ({"batch": 2.5}, "batch is 2.5; expected a whole"),
        ({"width": True}, "width is True"),
        ({"patience": -1}, "patience is -1; expected a whole number from 0"),
        ({"seed": 2**32}, "seed is 4294967296"),
        ({"learning_rate": 0}, "learning_rate is 0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"learning_rate": "a"}, "learning_rate is 'a'"),
        ({"validation": 1.0}, "validation is 1.0; expected a number from 0 to 0.9"),
        ({"morphology": "open"}, "morphology is 'open'; allowed: erode, dilate"),
    ],
    ids=str,
)
def test_bad_settings_are_refused(options, match):
    with pytest.raises(JShapeError, match=match):
        settings_from(options)


@pytest.mark.full
def test_a_process_killed_in_the_middle_goes_on(tmp_path):
    """kill -9 of `jshape train`, the same command again: the same bank as without the kill."""
    data, options = _small_dataset(tmp_path), ["--kind", "C", "--width", "2", "--epochs", "40"]
    options += ["--batch", "4", "--save-every", "4", "--patience", "0", "--learning-rate", "0.003"]

    def command(out):
        return [sys.executable, "-m", "jshape", "train", str(data), "--out", str(out), *options]

    killed = tmp_path / "killed"
    process = subprocess.Popen(command(killed), stderr=subprocess.PIPE)
    saved = tmp_path / "killed.training"
    deadline = time.monotonic() + 120
    while len(list(saved.glob("action-poke/saved-*"))) == 0 and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    assert process.communicate()[1] == b"" and process.returncode == -9
    assert saved.is_dir() and not killed.exists()
    done = subprocess.run(command(killed), capture_output=True, text=True)
    assert done.returncode == 0 and f"going on from {saved}" in done.stderr
    assert not saved.exists()
    assert main([*command(tmp_path / "whole")[3:], "--json"]) == 0
    rows = [
        (tmp_path / name / "curve.csv").read_text().splitlines() for name in ("killed", "whole")
    ]
    assert len(rows[0]) == 41
    assert [r.rsplit(",", 1)[0] for r in rows[0]] == [r.rsplit(",", 1)[0] for r in rows[1]]
    arrays = [(tmp_path / name / "effects.npz").read_bytes() for name in ("killed", "whole")]
    assert arrays[0] == arrays[1]


@pytest.mark.full
def test_a_training_folder_of_something_else_is_refused(tmp_path, capsys, monkeypatch):
    data, out = _small_dataset(tmp_path), tmp_path / "bank"
    quick = ["--kind", "C", "--width", "2", "--epochs", "3", "--batch", "4", "--save-every", "1"]
    call = ["train", str(data), "--out", str(out), *quick]

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("jshape.learn.training._tell", interrupt)
        assert main(call) == 2
    words = capsys.readouterr().err
    network_free = [*call[:4], "--kind", "P"]
    assert main(network_free) == 2
    assert capsys.readouterr().err.endswith(
        f"{out}.training: holds an interrupted training of another kind; --restart removes it\n"
    )
    assert f"the same command goes on from its last checkpoint in {out}.training" in words
    assert main([*call, "--seed", "1"]) == 2
    error = capsys.readouterr().err
    assert "holds a training with other pairs or settings" in error and error.count("\n") == 1
    assert main([*call, "--seed", "1", "--restart", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["training"]["poke"]["epochs"] == 3
    manifest = json.loads((out / "manifest.json").read_text())
    assert set(manifest["checksums"]) == {"effects.npz", "curve.csv", "curve.png"}
    assert main([*call, "--overwrite", "--json"]) == 0  # a trained bank is replaced on demand
    assert main([*call[:3], str(tmp_path / "next"), *quick, "--start", str(out), "--json"]) == 0


@pytest.mark.full
def test_kinds_without_a_network(tmp_path, capsys):
    """Options they do not use are refused, and an interrupted training goes only on demand."""
    call = ["train", str(_small_dataset(tmp_path)), "--out", str(tmp_path / "bank"), "--kind", "D"]
    assert main([*call, "--width", "2", "--learning-rate", "0.1", "--restart"]) == 2
    error = capsys.readouterr().err
    assert "--learning-rate, --width: kind D" in error and error.count("\n") == 1
    (tmp_path / "bank.training" / "action-poke").mkdir(parents=True)
    assert main([*call, "--seed", "1"]) == 2
    assert "of another kind; --restart removes it" in capsys.readouterr().err
    assert (tmp_path / "bank.training" / "action-poke").is_dir()
    assert main([*call, "--restart", "--json"]) == 0
    assert not (tmp_path / "bank.training").exists() and capsys.readouterr().err == ""


@pytest.mark.full
def test_a_trained_bank_knows_its_error(tmp_path, capsys):
    """As cross-validation measures it; from networks' validation; unknown with too few pairs."""
    data, out = _small_dataset(tmp_path), tmp_path / "bank"
    pairs = load_pairs(data)
    save_pairs(pairs.select(np.arange(3)), tmp_path / "few")

    def trained(*options, data=data):
        """What was printed as the action's error, and the errors of the result and the bank."""
        call = ["train", str(data), "--out", str(out), "--overwrite", "--kind", *options]
        assert main(call) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[1].endswith("error (mm)")
        assert main([*call, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert bank_manifest(out)["errors"] == result["errors"]
        return lines[2].split()[-1], result, load_bank(out).errors_mm

    printed, result, errors = trained("D")
    expected = cross_validate(pairs, "D")[0].mean_mm
    (row,) = result["errors"]
    assert row["action"] == "poke" and row["mm"] == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(load_bank(out).intervals, [row["spread"]], rtol=1e-5)
    np.testing.assert_allclose(errors, [expected], rtol=1e-5)
    assert printed == f"{expected:.2f}"
    save_bank(fit(pairs), tmp_path / "start")
    assert trained("D", "--start", str(tmp_path / "start"))[1]["errors"] == result["errors"]

    quick = ["C", "--width", "2", "--epochs", "3", "--batch", "4"]
    _, result, _ = trained(*quick)
    (row,) = result["errors"]
    assert (row["action"], row["mm"]) == ("poke", result["training"]["poke"]["best_mm"])
    printed, result, errors = trained(*quick, "--validation", "0")
    assert (printed, result["errors"], errors) == ("—", [], None)  # nothing was kept out
    printed, result, errors = trained("D", data=tmp_path / "few")
    assert (printed, result["errors"], errors) == ("—", [], None)


@pytest.mark.full
def test_errors_are_of_the_bank_that_was_trained(tmp_path):
    """All agents together, over its ROIs, from its start; unknown where no pair can be spared."""
    pairs = load_pairs(_small_dataset(tmp_path))
    bank, told = fit(pairs), []

    def validation_errors(*arguments, **more):
        return [row.mm for row in validate(*arguments, **more)]

    errors = validation_errors(bank, pairs, report=lambda *what: told.append(what))
    assert told == [("poke", k, 4) for k in range(1, 5)]
    two = replace(pairs, agent=np.array(["robot", "human"] * 3))
    np.testing.assert_array_equal(validation_errors(bank, two), errors)
    # Around the pits nothing is wrong: over twice the pixels it is half as much.
    wide = fit(replace(pairs, size=np.array([[32, 16]] * 6)))
    np.testing.assert_allclose(validation_errors(wide, pairs), errors[0] / 2, rtol=1e-3)

    tool = fitting.fit(pairs, "P")  # however good: f_D is better at pits with steep walls
    apart = validation_errors(tool, pairs)
    assert 0 < apart[0] < 2.0  # of a change of 4 mm
    assert validation_errors(tool, pairs, start=tool)[0] < apart[0]  # which knows these pairs

    holed = pairs.posterior.copy()
    for k, (u, v) in enumerate(pairs.centre):
        # Each has seen an eighth that no other has: a tenth would be filled.
        holed[k, v - 8 : v + 8, u - 6 : u + 6] *= np.arange(12) // 2 == k
    alone = replace(pairs, posterior=holed)
    assert validate(fit(alone), alone) == []


def _small_dataset(folder):
    """Six pits of one action in the paper's box."""
    rng, count, (h, w) = np.random.default_rng(0), 6, PAPER_BOX.shape
    prior = np.full((count, h, w), 44000, np.uint16)
    posterior = prior.copy()
    centre = np.stack([rng.integers(60, 420, count), rng.integers(60, 330, count)], -1)
    for k, (u, v) in enumerate(centre):
        posterior[k, v - 4 : v + 4, u - 4 : u + 4] += np.uint16(300 + 50 * k)
    names = {key: np.array([value] * count) for key, value in
             {"action": "poke", "agent": "robot", "material": "flour"}.items()}  # fmt: skip
    pairs = Pairs(
        camera=PAPER_BOX, depth_unit=1e-5, prior=prior, posterior=posterior, centre=centre,
        size=np.array([[16, 16]] * count), id=np.array([f"p{k}" for k in range(count)]), **names,
    )  # fmt: skip
    save_pairs(pairs, folder / "pairs")
    return folder / "pairs"
