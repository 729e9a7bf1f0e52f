"""Grids of banks and data sets in shards: what one process makes, and nothing computed twice."""

import shutil
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import grid
from benchmarks.grid import Cell, main
from jshape import Bank, Camera, Pairs, load_bank, save_pairs
from jshape.cli.main import main as jshape
from jshape.errors import JShapeError
from jshape.learn.evaluate import cross_validate
from jshape.learn.report import scores_csv
from jshape.models.difference import Difference
from jshape.models.refined import Refined
from jshape.planning.devices import cores

QUICK = ["--width", "1", "--epochs", "2", "--batch", "4"]
CAMERA = Camera(48, 40, 50.0, 50.0, 24.0, 20.0, 0.42, 0.47)


class Serial:
    """In place of Ray: notes the tasks, and dies after so many."""

    def __init__(self, lives=10**9):
        self.lives, self.tasks = lives, []

    def __call__(self, work, tasks, *shared, **where):
        for task in tasks:
            if len(self.tasks) == self.lives:
                raise KeyboardInterrupt
            self.tasks.append(task)
            yield work(task, *shared)


@pytest.fixture
def serial(monkeypatch):
    def put(lives=10**9):
        monkeypatch.setattr(grid, "mapped", found := Serial(lives))
        return found

    return put


@pytest.fixture(scope="module")
def pairs():
    """Five pits by each of two agents: two tasks of one shape, so that networks compile once."""
    rng, count = np.random.default_rng(0), 10
    prior = np.full((count, *CAMERA.shape), 44000, np.uint16)
    posterior = prior.copy()
    centre = np.stack([rng.integers(10, 38, count), rng.integers(10, 30, count)], -1)
    for k, (u, v) in enumerate(centre):
        posterior[k, v - 4 : v + 4, u - 4 : u + 4] += np.uint16(300 + 50 * k)
    return Pairs(
        camera=CAMERA,
        depth_unit=1e-5,
        prior=prior,
        posterior=posterior,
        centre=centre,
        action=np.array(["poke"] * count),
        agent=np.array(["robot", "human"] * 5),
        material=np.array(["flour"] * count),
        size=np.array([[16, 16]] * count),
        id=np.array([f"p{k}" for k in range(count)]),
    )


@pytest.fixture
def train(pairs, tmp_path):
    save_pairs(pairs, tmp_path / "pairs")
    return lambda *more: main(
        ["train", str(tmp_path / "pairs"), "--out", str(tmp_path / "grid"), *QUICK, *more]
    )


@pytest.mark.full
def test_a_killed_grid_goes_on_and_its_numbers_are_those_of_an_evaluation(
    train, pairs, serial, tmp_path, capsys
):
    asked = ("--kinds", "D", "--partitions", "2")
    first = serial(lives=3)
    assert train(*asked) == 130 and "interrupted" in capsys.readouterr().err
    rest = serial()
    assert train(*asked) == 0
    assert "4 cells, 3 of them finished before" in capsys.readouterr().out
    made = [cell for task in (*first.tasks, *rest.tasks) for cell in task]
    assert len(made) == len({*made}) == 4
    out = tmp_path / "grid"
    assert load_bank(out / "robot-poke-D-1").kind == "D"
    expected = []
    for agent in ("robot", "human"):
        scores = cross_validate(pairs.of(agent=agent), ("D",), partitions=2)
        expected += scores_csv([s._replace(floor_mm=None) for s in scores]).splitlines()[1:]

    def numbers(lines):
        return sorted(line.split(",")[:6] for line in lines)

    assert numbers((out / "scores.csv").read_text().splitlines()[1:]) == numbers(expected)
    again = serial()
    assert train(*asked) == 0 and again.tasks == []


def test_f_c_is_what_is_inside_f_cr(train, pairs, serial, monkeypatch):
    asked = serial()
    monkeypatch.setattr(grid, "fit", None)  # it fails, and says so
    assert train("--kinds", "CR", "D", "C", "--partitions", "1", "--agents", "robot") == 2
    together = [Cell("robot", "poke", kind, 0) for kind in ("CR", "C")]
    assert asked.tasks == [together, [Cell("robot", "poke", "D", 0)]]

    inside, outside = (Difference(jnp.full((16, 16), d, jnp.float32)) for d in (-0.1, -0.2))
    refined = Refined(inside, outside, jnp.zeros((16, 16)), jnp.float32(0.0))
    whole = Bank(CAMERA, (refined,), ("poke",), "CR")
    monkeypatch.setattr(grid, "fit", lambda *more, **options: whole)
    (_, first, _), (_, second, trial) = grid.fitted(together, pairs, {})
    assert first is whole and second.kind == "C" and second.predictor("poke") is inside
    assert trial.predictor == "C" and len(trial.error_mm) == 1


def test_cells_of_other_pairs_or_options_are_refused(train, pairs, serial, tmp_path, capsys):
    serial()
    assert train("--kinds", "D", "--partitions", "1") == 0
    assert train("--kinds", "D", "--partitions", "1", "--seed", "1") == 2
    assert "robot-poke-D-0: is of other pairs or options" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "pairs")
    save_pairs(replace(pairs, posterior=pairs.posterior + np.uint16(1)), tmp_path / "pairs")
    assert train("--kinds", "D", "--partitions", "1") == 2
    assert "is of other pairs or options; remove it" in capsys.readouterr().err
    assert train("--width", "0") == 2 and "width is 0" in capsys.readouterr().err
    tricky = Cell("../a-b", "c/d", "D", 0), Cell("../a", "b-c/d", "D", 0)
    assert [cell.name for cell in tricky] == ["..%2Fa%2Db-c%2Fd-D-0", "..%2Fa-b%2Dc%2Fd-D-0"]


def test_a_cell_that_fails_is_named_and_the_others_go_on(train, serial, monkeypatch, capsys):
    fit = grid.fit

    def failing(training, kind, **options):
        if training.agent[0] == "robot":
            raise FloatingPointError("not finite")
        return fit(training, kind, **options)

    monkeypatch.setattr(grid, "fit", failing)
    serial()
    assert train("--kinds", "D", "--partitions", "1") == 2
    said = capsys.readouterr().out
    assert "robot-poke-D-0 failed: FloatingPointError: not finite" in said and "human" in said


SIMULATED = ["--pairs", "3", "--actions", "poke", "knock", "--beds", "flat", "curved"]
SIMULATED += ["--frames", "1", "--strengths", "0.5", "2", "--seed", "5"]


@pytest.mark.full
def test_shards_are_what_one_process_makes(serial, tmp_path, capsys):
    """Byte for byte, after a Ctrl-C."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert jshape(["dataset", "simulate", str(whole), *SIMULATED]) == 0
    call = ["simulate", str(out), *SIMULATED, "--size", "2"]
    first = serial(lives=2)
    assert main(call) == 130 and not out.exists()
    assert main([*call, "--frames", "2"]) == 2
    assert "out.shards: holds shards of other options" in capsys.readouterr().err
    rest = serial()
    assert main(call) == 0
    assert [shard.start for shard in (*first.tasks, *rest.tasks)] == [0, 2, 3, 5]
    assert not (tmp_path / "out.shards").exists()
    files = [path for path in sorted(whole.rglob("*")) if path.is_file()]
    assert len(files) == 2 + 2 * 6
    for path in files:
        assert (out / path.relative_to(whole)).read_bytes() == path.read_bytes()
    assert main([*call[:2], "--actions", "tap"]) == 2 and "'tap'" in capsys.readouterr().err


def double(task, shared):
    if task == "bad":
        raise JShapeError(f"{task} of {shared}")
    return 2 * task


@pytest.mark.full
def test_ray_runs_pieces_and_hands_errors_on():
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        found = []
        with pytest.raises(JShapeError, match="^bad of all$"):
            for number in grid.mapped(double, [3, 4, 5, "bad"], "all", cpus=cores()):
                found.append(number)
        assert 6 in found and {*found} <= {6, 8, 10}
        assert not ray.is_initialized()  # it was started here, and is left
