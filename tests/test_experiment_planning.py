"""The planning benchmark: what it measures, that it goes on after a stop, what it refuses."""

import json
import shutil
from dataclasses import replace
from functools import lru_cache

import cv2
import jax
import numpy as np
import pytest

import jshape
from benchmarks.experiments import baselines, measures, planning, results
from benchmarks.experiments import methods as methods
from benchmarks.experiments.__main__ import main
from benchmarks.experiments.measures import limit_of
from benchmarks.experiments.planning import Case, Settings, run_planning
from benchmarks.experiments.problems import Applied, Problem
from jshape import PAPER_BOX, JShapeError, metric, plan, sim
from jshape.errors import BadBank, BadDataset, BadFile, UnknownName
from jshape.models.difference import Difference
from jshape.planning.evaluate import candidates_at
from jshape.planning.plan import Plan
from jshape.planning.search import PLANNERS
from jshape.planning.search.base import SearchLimits, SearchProblem, Status
from jshape.planning.state import search_state
from tests.conftest import paper

SMALL = {
    "tiny": {"bank": "flour-robot", "positions": "4x3"},
    "surplus": methods.FLOOR | {"planner": "surplus", "stride": 32},
}
"""Methods that plan at once."""
SETTINGS = Settings(problems=2, methods=tuple(SMALL), max_steps=2)
LINES = 2 * 2 * 2 * 2


@pytest.fixture(scope="module")
def small():
    """The benchmark with few and quick methods; problems are drawn once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(methods, "METHODS", SMALL)
        patch.setattr(planning, "draw", lru_cache(planning.draw))
        patch.setattr(measures, "limit_of", cheap_limit)
        yield


def cheap_limit(problem, bank, method, max_steps):
    """In place of one that takes seconds; of the same problem another one with another bank."""
    LIMITED.append((problem.name, method["bank"], max_steps))
    return 0.25 if problem.kind == "applied" else 0.0


LIMITED = []
"""What limits were asked of."""


@pytest.fixture(scope="module")
def finished(small, tmp_path_factory):
    """A folder with all runs, and the summary."""
    out = tmp_path_factory.mktemp("planning") / "out"
    return out, run_planning(out, SETTINGS, say=lambda line: None)


def lines(out):
    return [json.loads(line) for line in (out / "steps.jsonl").read_text().splitlines()]


@pytest.mark.full
def test_every_run_is_measured_without_the_cameras_noise(finished):
    out, _ = finished
    runs = lines(out)
    assert (
        len(runs) == LINES and len({tuple(run[f] for f in Case._fields) for run in runs}) == LINES
    )
    starts = {}
    for run in runs:
        steps, true = run["steps"], run["true_mm"]
        assert len(true) == len(run["seen_mm"]) == len(steps) + 1 <= 3
        assert len(run["predicted_mm"]) == len(run["plan"]) + 1
        start = starts.setdefault((run["kind"], run["number"]), true[0])
        assert true[0] == pytest.approx(start, rel=1e-5)
        # Noise is the camera's: what it sees is farther from the goal than what is there.
        assert run["kind"] == "applied" or run["seen_mm"][0] > true[0]
        for k, step in enumerate(steps):
            assert step["gain_mm"] == pytest.approx(true[k] - true[k + 1])
        if run["loop"] == "open":
            gains = [step["predicted_gain_mm"] for step in steps]
            np.testing.assert_allclose(gains, -np.diff(run["predicted_mm"]), atol=1e-6)
        measured = run["kind"] == "applied" and run["loop"] == "open"
        assert (run["retrieved"] is not None) == measured


@pytest.mark.full
def test_loops_begin_with_the_same_look_and_so_with_the_same_plan(finished):
    first = {}
    for run in lines(finished[0]):
        known = first.setdefault((run["kind"], run["number"], run["method"]), run["plan"])
        assert run["plan"] == known
    assert any(first.values())


@pytest.mark.full
def test_the_report_has_a_table_per_kind_and_all_figures(finished):
    out, summary = finished
    assert json.loads((out / "summary.json").read_text())["rows"] == summary["rows"]
    assert [row["problems"] for row in summary["rows"]] == [2] * 8
    for row in summary["rows"]:
        mine = [run["true_mm"] for run in lines(out)
                if all(run[f] == row[f] for f in ("kind", "method", "loop"))]  # fmt: skip
        assert row["left"] == pytest.approx(np.mean([d[-1] / d[0] for d in mine]))
        assert row["left_low"] <= row["left"] <= row["left_high"]
        limit = 0.25 if row["kind"] == "applied" else 0.0
        covered = [(1 - d[-1] / d[0]) / (1 - limit) for d in mine]
        assert row["efficiency"] == pytest.approx(np.mean(covered)) and row["limit"] == limit
    assert "\n0 of 16 runs ended below their limit" in (out / "report.md").read_text()
    text = (out / "report.md").read_text()
    assert text.count("| tiny | open | 2 |") == 2 and "letter, %" in text and "retrieved, %" in text
    for name in results.FIGURES:
        picture = cv2.imread(str(out / name))
        assert f"({name})" in text and picture.shape[0] > 150 and picture.std() > 10
    page = (out / "page.html").read_text()
    told = json.loads((out / "results.json").read_text())
    assert [figure["name"] for figure in told["figures"]] == list(results.FIGURES)
    assert "Goals that no action made" in page and "letter, %" in page
    for flat, row in zip(told["rows"], summary["rows"], strict=True):
        assert flat["left"] == row["left"] and "families" not in flat
        assert all(flat[f"left_{k}"] == part["left"] for k, part in row["families"].items())
    # Two problems of each kind, as both methods left them in the closed loop.
    assert len(list((out / "frames").iterdir())) == 8


@pytest.mark.full
def test_a_benchmark_that_was_killed_goes_on(finished, tmp_path, monkeypatch):
    out, _ = finished
    again = tmp_path / "again"
    shutil.copytree(out, again)
    whole = (out / "steps.jsonl").read_bytes().splitlines(keepends=True)
    (again / "steps.jsonl").write_bytes(b"".join(whole[:5]) + whole[5][:40])
    made, written = [], []
    real = planning.attempt
    monkeypatch.setattr(planning, "attempt", lambda *a: (made.append(a[1]), real(*a))[1])
    monkeypatch.setattr(results, "conclude", lambda run, *a: (written.append(run), {})[1])
    LIMITED.clear()
    run_planning(again, SETTINGS, say=lambda line: None)
    assert len(made) == LINES - 5 and len(written) == 2  # also after the first method
    assert LIMITED == [("bowl", "flour-robot", 2)]  # the others were there, and are both methods'
    resumed = measures.summarise(lines(again))
    for before, now in zip(measures.summarise(lines(out)), resumed, strict=True):
        for name in ("kind", "method", "loop", "problems", "actions", "retrieved", "evaluations"):
            assert now[name] == before[name]
        assert now["left"] == pytest.approx(before["left"], rel=1e-4)
    run_planning(again, SETTINGS, say=lambda line: None)
    assert len(made) == LINES - 5
    none = {"say": lambda line: None, "progress": lambda cases, *_: []}
    run_planning(again, SETTINGS, overwrite=True, **none)
    assert not lines(again)


@pytest.mark.full
def test_runs_with_other_settings_are_not_mixed(finished, tmp_path, small):
    out, _ = finished
    with pytest.raises(BadFile, match=r"other settings: seed, drawn \(seed was 0, now 1\)"):
        run_planning(out, replace(SETTINGS, seed=1), say=lambda line: None)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadFile, match="not empty"):
        run_planning(tmp_path, SETTINGS, say=lambda line: None)
    with pytest.raises(UnknownName, match="kind 'hills'"):
        run_planning(tmp_path / "new", replace(SETTINGS, kinds=("hills",)))
    with pytest.raises(BadDataset, match="none is given"):
        run_planning(tmp_path / "new", replace(SETTINGS, kinds=("mpm",)), say=lambda line: None)
    assert not (tmp_path / "new").exists()


def test_methods_that_cannot_run_here_are_named(monkeypatch):
    monkeypatch.setitem(methods.METHODS, "late", {"planner": "not yet"})
    found, notes = methods.methods_of(["late", "surplus"])
    assert list(found) == ["surplus"] and found["surplus"]["patience"] == 1000
    assert len(notes) == 1 and "no planner 'not yet'" in notes[0]
    with pytest.raises(UnknownName, match="method 'best'"):
        methods.methods_of(["best"])


@pytest.mark.full
def test_a_run_that_fails_is_a_result(finished, small, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise JShapeError("the hand is stuck")

    problem = planning.draw(replace(SETTINGS, kinds=("shape",), problems=1), None)["shape"][0]
    bank = planning.banks.load_bank("flour-robot")
    options = methods.options_of(methods.COMMON | SMALL["tiny"], bank, "closed")
    monkeypatch.setattr(planning.Watched, "act", refuse)
    found, bed = planning.attempt(problem, Case("shape", 0, "closed", "tiny"), options, SETTINGS)
    assert found["stop"] == "FAILED" and found["note"] == "the hand is stuck"
    assert found["true_mm"] == [pytest.approx(problem.distance_mm(problem.bed))]
    assert bed is problem.bed
    rows = measures.summarise([{"kind": "shape", "method": "tiny", "loop": "closed"} | found])
    assert rows[0]["failed"] == 1 and rows[0]["left"] == 1 and rows[0]["seen_left"] is None


def test_recorded_sequences_are_planned_with_their_own_places(bank, molded):
    now, goal, applied = molded
    known = tuple(Applied(name, (u, v), 1.0, 0.0) for name, u, v in applied)
    places = np.array([[91, 92], [239, 197], [387, 302]], np.int32)
    problem = Problem("two noisy", "applied", None, now, goal, known, places=places)
    options = methods.options_of(methods.COMMON | {"bank": "", "positions": "7x3"}, bank, "open")
    found, bed = planning.attempt(problem, Case("mpm", 0, "open", "tiny"), options, SETTINGS)
    assert bed is None and found["family"] == "noisy" and not found["true_mm"]
    assert found["retrieved"] == pytest.approx(2 / 3) and not found["exact"]  # of two steps
    more = replace(SETTINGS, max_steps=16)
    found, _ = planning.attempt(problem, Case("mpm", 0, "open", "tiny"), options, more)
    assert (found["retrieved"], found["exact"]) == (1.0, True)
    assert found["predicted_mm"][-1] < 0.1 * found["predicted_mm"][0]


def plan_of(*steps):
    """A plan of (action, u, v)."""
    places = np.array([step[1:] for step in steps], np.int32).reshape(-1, 2)
    return Plan(
        PAPER_BOX, tuple(step[0] for step in steps), places, np.full_like(places, 40),
        np.zeros(len(steps) + 1, np.float32), Status.NO_IMPROVEMENT,
    )  # fmt: skip


def test_an_action_is_retrieved_once_within_10_mm():
    applied = (Applied("knock", (100, 100), 1.4, 0.3), Applied("poke", (200, 200), 1.0, 0.0))

    def measured(*steps, of=applied):
        return tuple(measures.retrieval(of, plan_of(*steps), PAPER_BOX))

    assert measured(("poke", 200, 200), ("knock", 100, 100)) == (1.0, True)
    assert measured() == (0.0, False)
    # 10 mm are 9.62 pixels at 0.45 m.
    assert measured(("knock", 109, 100), ("poke", 200, 191)) == (1.0, True)
    assert measured(("knock", 110, 100), ("poke", 207, 207)) == (0.0, False)
    assert measured(("knock", 106, 107), ("poke", 200, 200)) == (1.0, True)
    # Another type, a needless action, and two for one.
    assert measured(("press", 100, 100), ("poke", 200, 200)) == (0.5, False)
    assert measured(("knock", 100, 100), ("poke", 200, 200), ("poke", 9, 9)) == (1.0, False)
    assert measured(("knock", 100, 100), ("knock", 101, 100)) == (0.5, False)
    # Each planned action counts for one, and the matching is the best: the first fits both.
    near = (Applied("poke", (200, 200), 1.0, 0.0), Applied("poke", (212, 200), 1.0, 0.0))
    assert measured(("poke", 206, 200), of=near) == (0.5, False)
    assert measured(("poke", 206, 200), ("poke", 197, 200), of=near) == (1.0, True)
    assert measured(("poke", 206, 200), ("poke", 220, 200), of=near) == (1.0, True)


def test_a_run_is_held_against_what_no_plan_can_go_below():
    step = {"action": "poke", "strength": 4.0}
    run = {"true_mm": [1.0, 0.3, 0.2], "steps": [step, step], "plan": [], "predicted_mm": [],
           "method": "tiny", "loop": "open", "problem": "bowl"}  # fmt: skip
    bank = jshape.load_bank("pressed-flour-robot")
    error = float(metric.to_mm(bank.error_of_d()[bank.actions.index("poke")], bank.camera))
    assert measures.error_mm(run, bank) == pytest.approx(2 * 2 * error) and error > 0
    below = [run | {"limit": limit, "error_mm": 0.1} for limit in (0.29, 0.31)]
    assert [measures.is_below_limit(one) for one in below] == [False, True]
    text = measures.limits_kept([*below, run])  # of what was made before there were limits
    assert text.startswith("1 of 2 runs ended below") and text.endswith(": tiny, open, bowl")
    planned = run | {"true_mm": [], "plan": [step], "predicted_mm": [1.0, 0.2], "limit": 0.5}
    assert measures.error_mm(planned, bank) == pytest.approx(2 * error)
    assert measures.is_below_limit(planned | {"error_mm": 0.2})


def test_a_limit_is_that_of_what_a_method_may_use():
    camera = jshape.Camera(48, 40, 60.0, 60.0, 24.0, 20.0, 0.42, 0.47)
    bank = jshape.Bank(camera, (Difference(jax.numpy.ones((7, 7)) / 8),), ("poke",))
    now = np.full(camera.shape, 0.5, np.float32)
    goal = now.copy()
    for v, u in ((8, 8), (8, 38), (30, 8), (30, 38)):
        goal[v - 3 : v + 4, u - 3 : u + 4] += 1 / 8
    problem = Problem("four", "applied", None, now, goal, camera=camera)
    method = {"bank": "mine", "stride": 3, "planner": "greedy", "stock_cm3": 1.0}
    assert measures.tried(method) == {"bank": "mine", "stock_cm3": 1.0}
    found = [limit_of(problem, bank, {"bank": "mine"}, most) for most in (1, 3)]
    expected = [jshape.limit(now, goal, bank=bank, max_steps=most).left for most in (1, 3)]
    assert found == expected and found[0] >= 0.74 > found[1] > 0.24
    with pytest.raises(UnknownName, match="knok"):
        limit_of(problem, bank, {"bank": "mine", "yaws": {"knok": 6}}, 1)


def test_families_and_intervals():
    names = {"elliptic bowl": "bowl", "L trench": "trench", "trench 30 deg": "trench",
             "letter S": "letter", "sand 003": "sand", "dough dumpling 001": "dough"}  # fmt: skip
    assert {name: measures.family("shape", name) for name in names} == names
    assert measures.family("applied", "3 actions overlapping") == "overlapping"
    assert measures.family("mpm", "dev1") == "noise-free"
    low, high = measures.interval(np.arange(20) / 19)
    assert 0.35 < low < 0.4 and 0.6 < high < 0.65  # 0.5 ± 1.96 times 0.30 / √20
    assert measures.interval([0.3]) == (0.3, 0.3)


@pytest.fixture
def bumpy(bank):
    """A problem on a level bed with a bump of knock's size and a higher one of poke's."""
    now = np.full(bank.camera.shape, 0.5, np.float32)
    now[60:140, 50:150] += 0.1
    now[280:325, 300:340] += 0.2
    goal = np.full(bank.camera.shape, 0.5, np.float32)
    state = search_state(bank, jax.numpy.asarray(now), jax.numpy.asarray(goal))
    places = {"knock": [[100, 100], [320, 302], [400, 100]], "poke": [[100, 100], [320, 302]]}
    where = {name: np.array(at, np.int32) for name, at in places.items()}
    return SearchProblem(state, candidates_at(state, bank, where), max_steps=4)


def test_the_surplus_is_removed_where_it_is(bank, bumpy):
    found = baselines.surplus(bumpy)
    # The highest first; a poke within the knock's bump is as high as all of it, and comes later.
    steps = [(bank.actions[m], tuple(node[::-1])) for m, node in
             zip(found.move[:2].tolist(), found.node[:2].tolist(), strict=True)]  # fmt: skip
    assert steps == [("poke", (320, 302)), ("knock", (100, 100))]
    assert int(found.steps) == 2 and int(found.status) == Status.NO_IMPROVEMENT
    size = bumpy.state.now.size
    for least, steps in ((0.19 * 40 * 45 / size, 2), (0.21 * 40 * 45 / size, 1), (0.5, 0)):
        problem = replace(bumpy, limits=SearchLimits(min_gain=least))
        assert int(baselines.surplus(problem).steps) == steps
    level = replace(bumpy.state, now=bumpy.state.goal)
    assert int(baselines.surplus(replace(bumpy, state=level)).steps) == 0
    with pytest.raises(BadBank, match="images"):
        ground = replace(bumpy.state, weight=bumpy.state.now)
        baselines.surplus(replace(bumpy, state=ground))


def test_random_draws_from_the_candidates(bumpy):
    found = baselines.random(bumpy)
    known = {(m, *(first + bumpy.state.moves[m].middle).tolist())
             for m in (0, 1) for first in bumpy.candidates.of_move(m)}  # fmt: skip
    drawn = list(zip(found.move[:4].tolist(), *found.node[:4].astype(int).T.tolist(), strict=True))
    assert int(found.steps) == 4 and set(drawn) <= known
    assert (np.asarray(found.strength[:4]) == 1).all() and (found.move[4:] == -1).all()
    np.testing.assert_array_equal(baselines.random(bumpy).node, found.node)
    lower = replace(bumpy, state=replace(bumpy.state, now=bumpy.state.now - 0.01))
    assert (baselines.random(lower).node != found.node).any()
    kept = baselines.random(replace(lower, start=found))
    np.testing.assert_array_equal(kept.node, found.node)


def test_floors_are_planners_for_a_while(bank, molded):
    now, goal, _ = molded
    known = dict(PLANNERS)
    with baselines.floors():
        found = plan(now, goal, bank=bank, **paper(planner="random", max_steps=3))
        assert len(found) == 3 and found.evaluations == 0
    assert known == PLANNERS
    with pytest.raises(UnknownName):
        plan(now, goal, bank=bank, **paper(planner="random"))


@pytest.mark.full
def test_the_command_prints_tables_and_refuses_in_one_line(
    finished, small, capsys, tmp_path, monkeypatch
):
    monkeypatch.setattr(results, "conclude", lambda *_: finished[1])
    out, _ = finished
    same = ["planning", "--out", str(out), "--problems", "2", "--max-steps", "2",
            "--methods", *SMALL]  # fmt: skip
    assert main(same) == 0
    text = capsys.readouterr().out
    assert "16 runs, 16 of them there already" in text and "left, % (95 %)" in text
    assert main([*same, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == LINES
    new = ["planning", "--out", str(tmp_path / "new"), "--methods", "tiny"]
    for more, said in (
        ([*same, "--seed", "3"], "other settings"),
        ([*new, "--methods", "best"], "unknown method 'best'"),
        ([*new, "--kinds", "hills"], "unknown kind 'hills'"),
        ([*new, "--loops", "half"], "unknown loop 'half'"),
        ([*new, "--kinds", "mpm"], "none is given"),
        ([*new, "--data", str(tmp_path)], "neither real/ nor mpm/"),
    ):
        assert main(more) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1
    with pytest.raises(SystemExit):
        main([*new, "--problems", "0"])
    assert "'0' is not a whole number from 1" in capsys.readouterr().err


def test_distances_are_of_the_bed_and_not_of_the_look():
    bed = sim.flat_bed()
    image = np.asarray(metric.weigh(
        PAPER_BOX.luminance(sim.render(bed, PAPER_BOX), quantize=False), PAPER_BOX
    ))  # fmt: skip
    problem = Problem("flat", "shape", bed, image + 1, image + 2, truth=image)  # as if by noise
    for one in problem.ends:
        np.testing.assert_array_equal(one, image)
    world = planning.Watched(planning.SimulatedWorld(jax.random.key(0), bed), problem)
    world.look()
    assert world.true_mm == [0.0] and not world.waits
    world.act("knock", (240, 197))
    assert len(world.true_mm) == 2 and world.true_mm[1] > 0.1 and len(world.waits) == 1
