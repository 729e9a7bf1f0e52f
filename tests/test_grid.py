"""Grids of banks and data sets in shards: the same by every engine, and nothing computed twice."""

import json
import shutil
from dataclasses import replace
from itertools import islice

import jax
import numpy as np
import pytest

from jshape import Camera, Pairs, load_bank, save_pairs
from jshape.cli.main import main
from jshape.data.simulate import simulate_pairs
from jshape.errors import BadDataset, BadFile, JShapeError, UnknownName
from jshape.grid import grid as grids
from jshape.grid import shards
from jshape.grid.engines import OnRay, forking
from jshape.grid.grid import Cell, Grid
from jshape.io import files
from jshape.io.datasets import load_pairs
from jshape.learn.evaluate import cross_validate

QUICK = {"width": 1, "epochs": 2, "batch": 4}
CAMERA = Camera(48, 40, 50.0, 50.0, 24.0, 20.0, 0.42, 0.47)


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
        camera=CAMERA, depth_unit=1e-5, prior=prior, posterior=posterior, centre=centre,
        action=np.array(["poke"] * count), agent=np.array(["robot", "human"] * 5),
        material=np.array(["flour"] * count), size=np.array([[16, 16]] * count),
        id=np.array([f"p{k}" for k in range(count)]),
    )  # fmt: skip


class Counting:
    """An engine that notes what it was given, and dies after so many tasks."""

    def __init__(self, lives=10**9):
        self.lives, self.tasks = lives, []

    def __call__(self, work, shared, tasks):
        for number, task in enumerate(tasks[: self.lives]):
            self.tasks.append(task)
            yield number, work(shared, task)
        if len(tasks) > self.lives:
            raise KeyboardInterrupt

    @property
    def cells(self):
        return [cell for task in self.tasks for cell in task]


def banks_of(out):
    return {path.parent.name: path.read_bytes() for path in out.glob("cells/*/effects.npz")}


def errors_of(grid, out):
    found = grids.finished(grid, out)
    return {cell: trial.error_mm.tolist() for cell, trial in found.items()}


@pytest.fixture(scope="module")
def whole(pairs, tmp_path_factory):
    """A grid with a network, uninterrupted: (grid, folder)."""
    grid = Grid(pairs, ("D", "C", "CR"), partitions=2, options=QUICK)
    out = tmp_path_factory.mktemp("grid") / "out"
    engine = Counting()
    made = [done.cell for done in grids.run(grid, out, engine)]
    assert made == engine.cells and sorted(made) == sorted(grid.cells) and len(made) == 12
    return grid, out


def test_its_numbers_are_those_of_an_evaluation(whole, pairs):
    grid, out = whole
    scores, summary = grids.conclude(grid, out, {})
    assert (summary["cells"], summary["finished"], summary["failed"]) == (12, 12, [])
    for agent in ("robot", "human"):
        mine = pairs.of(agent=agent)
        expected = cross_validate(mine, grid.kinds, partitions=2, **QUICK)
        found = [score for score in scores if score.agent == agent]
        assert [s.predictor for s in found] == ["D", "C", "CR"]
        assert [s._replace(floor_mm=None, floor_from="") for s in found] == [
            s._replace(floor_mm=None, floor_from="") for s in expected
        ]
    bank = load_bank(out / "cells" / "robot-poke-CR-1")
    assert (bank.kind, bank.actions) == ("CR", ("poke",))
    trial = grids.finished(grid, out)[Cell("robot", "poke", "CR", 1)]
    np.testing.assert_allclose(bank.errors_mm, [trial.error_mm.mean()], rtol=1e-6)
    assert (out / "scores.csv").is_file() and (out / "scores.png").is_file()


def test_a_killed_grid_goes_on_and_computes_nothing_twice(whole, tmp_path):
    grid, out = whole
    first, second, third = Counting(lives=3), Counting(), Counting()
    with pytest.raises(KeyboardInterrupt):
        list(grids.run(grid, tmp_path, first))
    # In another order, and larger: what is there is found.
    other = replace(grid, kinds=("CR", "C", "D", "P"), agents=("human", "robot"))
    kept = errors_of(other, tmp_path)
    assert sorted(kept) == sorted(first.cells)
    list(grids.run(grid, tmp_path, second))
    assert not {*first.cells} & {*second.cells}
    assert {*first.cells} | {*second.cells} == {*grid.cells}
    assert errors_of(grid, tmp_path) == errors_of(*whole) and banks_of(tmp_path) == banks_of(out)
    list(grids.run(grid, tmp_path, third))
    assert third.cells == []
    assert grids.in_tasks(other.cells)[0] == (
        Cell("robot", "poke", "CR", 0), Cell("robot", "poke", "C", 0)
    )  # fmt: skip


def test_cells_of_other_settings_or_pairs_are_refused(pairs, tmp_path):
    grid = Grid(pairs, ("D",), partitions=1, options={"seed": 0})
    list(grids.run(grid, tmp_path))
    moved = replace(pairs, posterior=pairs.posterior + (pairs.agent == "human")[:, None, None])
    for other, why in (
        (replace(grid, seed=1), "another split_seed: 0, now 1"),
        (replace(grid, test_share=0.4), "another test_share: 0.25, now 0.4"),
        (replace(grid, options={"seed": 2}), "another seed: 0, now 2"),
        (replace(grid, pairs=replace(moved, posterior=moved.posterior.astype(np.uint16))),
         "human-poke-D-0: was made with other pairs"),
    ):  # fmt: skip
        with pytest.raises(BadFile, match=f"{why}; choose another folder, or .*--overwrite"):
            list(grids.run(other, tmp_path))
    # f_D has no width, the robot's pairs are the same, and the first partition stays.
    again = Counting()
    list(grids.run(replace(other, options={"width": 5}), tmp_path, again, overwrite=True))
    assert again.cells == [Cell("human", "poke", "D", 0)]
    again = Counting()
    list(grids.run(replace(other, partitions=2, actions=("poke",)), tmp_path, again))
    assert [cell.partition for cell in again.cells] == [1, 1]

    manifest = tmp_path / "cells" / "robot-poke-D-0" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"trial"', '"trail"'))
    with pytest.raises(BadFile, match="robot-poke-D-0: is a bank, but not a cell"):
        grids.finished(other, tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadFile, match="is for a grid, but holds notes.txt"):
        grids.finished(other, tmp_path)


def test_what_makes_no_grid(pairs):
    with pytest.raises(UnknownName, match="unknown kind of bank 'X'"):
        Grid(pairs, ("X",))
    with pytest.raises(UnknownName, match="unknown agent 'dog'"):
        Grid(pairs, agents=("dog",))
    with pytest.raises(UnknownName, match="unknown action 'tap'"):
        Grid(pairs, actions=("tap",))
    with pytest.raises(JShapeError, match="partitions is 0"):
        Grid(pairs, partitions=0)
    with pytest.raises(JShapeError, match="unknown option 'depth'"):
        Grid(pairs, options={"depth": 3})
    with pytest.raises(BadDataset, match="poke of robot: 1 pair"):
        Grid(pairs.select(np.arange(1)))
    tricky = Cell("../a-b", "c/d", "D", 0), Cell("../a", "b-c/d", "D", 0)
    assert [cell.name for cell in tricky] == ["..%2Fa%2Db-c%2Fd-D-0", "..%2Fa-b%2Dc%2Fd-D-0"]


def test_the_command_says_what_failed_and_goes_on(pairs, tmp_path, capsys, monkeypatch):
    strong = replace(pairs, strength=np.where(pairs.agent == "robot", 1.0, 2.0).astype("f4"))
    save_pairs(strong, tmp_path / "pairs")
    call = ["grid", "train", str(tmp_path / "pairs"), "--out", str(tmp_path / "grid")]
    call += ["--partitions", "1", "--width", "1", "--epochs", "1", "--batch", "4", "--kinds", "D"]
    assert main([*call, "C"]) == 0
    out = capsys.readouterr().out
    assert "4 cells, 0 of them finished before" in out
    assert "failed: human-poke-C-0: poke: pairs of strengths from 2 to 2" in out
    assert main([*call, "C", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["finished"], len(summary["failed"])) == (3, 1)
    assert main([*call[:-1], "C", "--agents", "human"]) == 2
    assert "error: no cell could be computed: poke: pairs of" in capsys.readouterr().err
    assert main([*call, "--cpus", "2"]) == 2
    assert capsys.readouterr().err == "jshape: error: --cpus is for --engine ray\n"

    fitted = grids.fitted

    def dying(grid, task):
        if task[0].partition == 1:
            raise KeyboardInterrupt
        return fitted(grid, task)

    monkeypatch.setattr(grids, "fitted", dying)
    call[call.index("--partitions") + 1] = "2"
    assert main([*call, "--json"]) == 130
    said = capsys.readouterr()
    assert json.loads(said.out)["finished"] == 2
    assert "interrupted with 2 of 4 cells finished; the same command goes on" in said.err


def test_any_error_of_a_cell_is_its_own(pairs, tmp_path, monkeypatch):
    fit = grids.fit

    def failing(training, kind, **options):
        if training.agent[0] == "robot":
            raise FloatingPointError("not\nfinite")
        return fit(training, kind, **options)

    monkeypatch.setattr(grids, "fit", failing)
    grid = Grid(pairs, partitions=1)
    first, second = sorted(grids.run(grid, tmp_path), key=lambda done: done.cell)
    assert (first.cell.agent, first.problem) == ("human", "") and first.bank is not None
    assert (second.problem, second.bank) == ("FloatingPointError: not finite", None)

    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(grids, "fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(grids.run(grid, tmp_path))


def test_the_table_is_of_all_that_belongs_together(pairs, tmp_path, capsys, monkeypatch):
    save_pairs(pairs, tmp_path / "pairs")
    out = tmp_path / "grid"
    call = ["grid", "train", str(tmp_path / "pairs"), "--out", str(out), "--kinds", "D"]

    def interrupted(grid, task):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(grids, "fitted", interrupted)
        assert main([*call, "--partitions", "2"]) == 130
    said = capsys.readouterr().out
    assert f"no cell is finished, so there is no table: {out / 'summary.json'}" in said
    assert "banks, table and figure" not in said
    assert [path.name for path in out.iterdir()] == ["summary.json"]

    assert main([*call, "--partitions", "2"]) == 0
    wide = (out / "scores.csv").read_text()
    assert "not asked for now" not in capsys.readouterr().out
    assert main([*call, "--partitions", "1", "--agents", "human"]) == 0
    assert "finished before and not asked for now: 3 cells" in capsys.readouterr().out
    assert sorted((out / "scores.csv").read_text().splitlines()) == sorted(wide.splitlines())
    # Cells of another seed do not belong to them.
    narrow = ["--partitions", "1", "--agents", "human", "--seed", "1", "--overwrite", "--json"]
    assert main([*call, *narrow]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["finished"], summary["others"], len(summary["scores"])) == (1, 0, 1)


SMALL = shards.Simulation(
    pairs=3, actions=("poke", "knock"), beds=("flat", "curved"), frames=1, strengths=(0.5, 2.0),
    seed=5, size=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A data set in shards, interrupted once."""
    out = tmp_path_factory.mktemp("shards") / "pairs"
    first = list(islice(shards.simulate(SMALL, out), 2))
    assert first == ["000000", "000002"] and not out.exists()
    with pytest.raises(BadFile, match="pairs.shards: holds shards .* another seed: 5, now 6; give"):
        next(shards.simulate(replace(SMALL, seed=6), out))
    with pytest.raises(BadFile, match="another size: 2, now 3"):
        next(shards.simulate(replace(SMALL, size=3), out))
    rest = Counting()
    assert list(shards.simulate(SMALL, out, rest)) == ["000000", "000002", "000003", "000005"]
    assert [shard.name for shard in rest.tasks] == ["000003", "000005"]
    assert not out.with_name("pairs.shards").exists()
    return out


def test_shards_are_what_one_process_makes(simulated):
    """Bit for bit, with the names of `dataset simulate`."""
    found = load_pairs(simulated)
    expected = list(
        simulate_pairs(
            jax.random.key(5), 3, actions=SMALL.actions, agents=SMALL.agents, beds=SMALL.beds,
            frames=1, strengths=SMALL.strengths,
        )
    )  # fmt: skip
    assert len(found) == len(expected) == len(SMALL) == 6
    assert found.id.tolist() == [f"{pair.action}_robot_{k:05d}" for k, pair in enumerate(expected)]
    for name in ("prior", "posterior", "strength"):
        made = np.array([getattr(pair, name) for pair in expected])
        np.testing.assert_array_equal(getattr(found, name), made.astype(getattr(found, name).dtype))
    assert found.centre.tolist() == [list(pair.position) for pair in expected]
    with pytest.raises(UnknownName, match="'tap'; allowed"):
        next(shards.simulate(replace(SMALL, actions=("tap",)), simulated.parent / "no"))


def test_a_damaged_shard_is_made_again(simulated, tmp_path, capsys, monkeypatch):
    """By the command, after a Ctrl-C; only that shard, and the data set is what it would be."""
    done, work = [], shards.simulated

    def dying(simulation, shard):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(shard.name)
        return work(simulation, shard)

    out = tmp_path / "pairs"
    call = ["grid", "simulate", str(out), "--pairs", "3", "--actions", "poke", "knock", "--beds"]
    call += ["flat", "curved", "--frames", "1", "--strengths", "0.5", "2", "--seed", "5"]
    monkeypatch.setattr(shards, "simulated", dying)
    assert main([*call, "--size", "2"]) == 130
    said = capsys.readouterr().err
    assert "2 of 4 shards are finished; they are kept in" in said and "goes on" in said
    assert "error" not in said and not out.exists()

    kept = tmp_path / "pairs.shards"
    monkeypatch.setattr(shards, "simulated", work)
    frames = sorted(kept.glob("00000[02]/frames/*.png"))
    frames[0].write_bytes(frames[1].read_bytes())  # an image still, but another
    rest, said = Counting(), []
    assert len(list(shards.simulate(SMALL, out, rest, say=said.append))) == 4
    assert [shard.name for shard in rest.tasks] == ["000000", "000003", "000005"]
    assert said == [f"{kept / '000000'}: damaged or not finished; it is made again"]
    for path in simulated.rglob("*.*"):
        assert (out / path.relative_to(simulated)).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("harm", ["table", "frame", "checksums", "more"])
def test_what_a_whole_shard_is(simulated, tmp_path, harm):
    folder = tmp_path / "000000"
    shutil.copytree(simulated, folder)
    checksums = files.write_json(tmp_path / "000000.json", shards._digests(folder))
    assert shards._is_whole(folder)
    frame = next(folder.glob("frames/*.png"))
    if harm == "table":
        (folder / "pairs.csv").unlink()
    elif harm == "frame":
        frame.write_bytes(frame.read_bytes()[:-1])
    elif harm == "checksums":
        checksums.unlink()
    else:
        (folder / "more.txt").write_text("")
    assert not shards._is_whole(folder)


@pytest.fixture(scope="module")
def ray():
    """Ray's workers on two cores, started once for all tests here."""
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        options = {"log_to_driver": False, "logging_level": "ERROR"}
        with forking():
            ray.init("local", num_cpus=2, include_dashboard=False, **options)
        yield ray
        ray.shutdown()


def test_ray_makes_the_same(ray, whole, simulated, tmp_path):
    grid, out = whole
    made = list(grids.run(grid, tmp_path / "grid", OnRay()))
    assert sorted(done.cell for done in made) == sorted(grid.cells)
    # A worker has other threads than this process, which may add up in another order.
    alone, spread = errors_of(grid, out), errors_of(grid, tmp_path / "grid")
    assert alone.keys() == spread.keys()
    for cell, errors in alone.items():
        np.testing.assert_allclose(spread[cell], errors, rtol=1e-4)
    list(shards.simulate(SMALL, tmp_path / "pairs", OnRay()))
    for path in sorted(simulated.rglob("*")):
        if path.is_file():
            there = tmp_path / "pairs" / path.relative_to(simulated)
            assert there.read_bytes() == path.read_bytes()
    assert ray.is_initialized()  # it was started by others and is left to them


def double(shared, task):
    if task == "bad":
        raise JShapeError(f"{task} of {shared}")
    return 2 * task


def test_ray_hands_errors_on(ray):
    assert sorted(OnRay(cpus=2)(double, "all", [3, 4, 5])) == [(0, 6), (1, 8), (2, 10)]
    assert list(OnRay()(double, "all", [])) == []
    with pytest.raises(JShapeError, match="^bad of all$"):
        list(OnRay()(double, "all", ["bad", 1]))
    given_up = OnRay()(double, "all", [1, 2, 3])
    next(given_up)
    given_up.close()
    assert sorted(OnRay()(double, "all", [1])) == [(0, 2)]
