"""What the experiments with pages measure, on tiny sizes."""

import csv
import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from benchmarks import clouds
from benchmarks.experiments import metric as race
from benchmarks.experiments import metric_figures, ranking, samples, studies, viewpoint
from benchmarks.experiments.__main__ import main
from benchmarks.experiments.samples import CAMERAS, Asked, smaller
from jshape import PAPER_BOX, metric, sim
from jshape.cli.tables import progress
from jshape.errors import BadDataset
from jshape.io import datasets

SMALL = CAMERAS["240x198"]


@pytest.fixture(scope="module")
def pair():
    """An irregular bed before and after two actions, seen by a small camera."""
    return race.seen(*race.beds(0), SMALL)


@pytest.fixture(scope="module")
def pairs():
    """Four pokes of each agent."""
    return samples.pairs_of(None, seed=3, count=4, actions=("poke",))


def test_a_smaller_camera_sees_the_same(pair):
    corners = [[0, 0], [PAPER_BOX.width / 2 - 0.5, PAPER_BOX.height / 2 - 0.5]]
    for u, v in corners:
        big = ((2 * u + 0.5 - PAPER_BOX.u0) / PAPER_BOX.fx, (2 * v + 0.5 - PAPER_BOX.v0))
        small = smaller(PAPER_BOX, 2)
        assert (u - small.u0) / small.fx == pytest.approx(big[0])
        assert (v - small.v0) / small.fy == pytest.approx(big[1] / PAPER_BOX.fy)
    assert SMALL.shape == (198, 240)


def test_d_is_the_mean_distance_of_the_clouds_points(pair):
    p, q = pair.clouds()
    assert pair.d_mm == pytest.approx(np.linalg.norm(p - q, axis=1).mean(), rel=1e-4)


def test_the_earth_mover_agrees_with_d_on_the_same_pixels_only(pair):
    rows = race.transported(pair, (100, 400), seed=0)
    for row in rows:
        if row["choice"] == "same pixels":
            assert row["value_mm"] == pytest.approx(row["d_same_pixels_mm"], rel=0.01)
        else:  # points beside each other: their spacing is read
            assert row["value_mm"] > 3 * row["d_mm"]
    drawn = [row["value_mm"] for row in rows if row["choice"] == "random"]
    assert drawn[-1] < drawn[0]
    assert {row["method"] for row in rows} == {
        f"EMD ({mover})" for mover in clouds.installed(clouds.MOVERS)
    }


def test_d_is_far_quicker_than_what_looks_for_neighbours(pair):
    rows = {row["method"]: row for row in race.timed(pair, "240x198")}
    chamfers = [row for name, row in rows.items() if name.startswith("Chamfer")]
    assert len(chamfers) == len(clouds.installed(clouds.TREES))
    assert all(row["times_d"] > 20 for row in chamfers)
    values = [row["value_mm"] for row in chamfers]
    assert values[0] == pytest.approx(values[-1], rel=1e-4)
    assert values[0] < rows["d"]["value_mm"]  # the nearest is never farther than the matched
    assert rows["depth difference"]["value_mm"] < rows["d"]["value_mm"]


def test_scores_of_a_ranking():
    falling, rising = np.array([[4.0, 3.0, 2.0, 0.0]]), np.array([[1.0, 2.0, 3.0, 4.0]])
    assert ranking.scores(falling) | {} == {
        "kendall": 1.0, "kendall_least": 1.0, "falls": 1.0, "start_mm": 4.0, "goal_mm": 0.0,
        "left_at_goal": 0.0,
    }  # fmt: skip
    both = ranking.scores(np.concatenate([falling, rising]))
    assert (both["kendall"], both["kendall_least"], both["falls"]) == (0.0, -1.0, 0.5)


@pytest.mark.full
def test_d_follows_a_molding_sequence_and_random_points_do_not():
    rows, curves = ranking.rank(0, 2, 3, samples.silent)
    found = {row["method"]: row for row in rows}
    assert found["d"]["kendall"] > 0.8 and found["d"]["left_at_goal"] < 0.6
    drawn = next(row for name, row in found.items() if name.startswith("EMD") and "random" in name)
    assert drawn["left_at_goal"] > 0.6
    assert all(values.shape == (2, 4) for values in curves.values())
    figure = metric_figures.ranking_figure(curves)
    assert [ax.get_title() for ax in figure.axes[: len(curves)]] == list(curves)


@pytest.mark.full
def test_turning_the_camera_changes_depths_but_not_distances():
    rows = []
    for name, beds in viewpoint.surfaces(0).items():
        rendered = viewpoint.below(beds, 0.0)
        for move in ("pan", "tilt"):
            for view in viewpoint.views(move, 3):
                rows.append({"surface": name} | viewpoint.measure(rendered, view))
    for line in viewpoint.spreads(rows):
        assert line["weighted_spread"] < 0.3 * line["unweighted_spread"]
        assert line["even_spread"] < 0.005 and line["unweighted_spread"] > 0.05


def test_between_planes_the_ray_is_longer_from_the_side():
    level = sim.flat_bed()
    beds = level, sim.loose_bed(np.asarray(level.height) - 0.01)
    shift = 0.1
    view = viewpoint.View("sideways", shift, 0.0, 0.0, shift)
    row = viewpoint.measure(viewpoint.below(beds, shift), view)
    assert row["unweighted_mm"] == pytest.approx(10, abs=0.01)
    x = np.linspace(shift - viewpoint.PATCH, shift + viewpoint.PATCH, 201)
    y = np.linspace(-viewpoint.PATCH, viewpoint.PATCH, 201)
    rays = np.sqrt(1 + (x[:, None] ** 2 + y**2) / sim.SURFACE**2)
    assert row["weighted_mm"] == pytest.approx(10 * rays.mean(), rel=2e-3)


def test_a_turn_leaves_the_points_where_they_are():
    bed = sim.irregular_bed(jax.random.key(1), 0.004)
    depth = np.asarray(sim.render(bed, viewpoint.WIDE))
    for view in (viewpoint.View("pan", 25.0, 25.0, 0.0, 0.0), viewpoint.View("tilt", 9, 0, 9, 0)):
        along, points = viewpoint.seen_from(depth, view)
        middle = np.s_[200:280:20, 380:460:20]
        x, y, z = points[middle].reshape(-1, 3).T
        u = viewpoint.WIDE.fx * x / z + viewpoint.WIDE.u0
        v = viewpoint.WIDE.fy * y / z + viewpoint.WIDE.v0
        there = depth[np.rint(v).astype(int), np.rint(u).astype(int)]
        np.testing.assert_allclose(z, there, atol=1e-3)
        back = points[middle].reshape(-1, 3) @ viewpoint.turn(view)
        np.testing.assert_allclose(back[:, 2], along[middle].reshape(-1))


@pytest.mark.slow
def test_viewpoint_writes_a_page_with_every_view(tmp_path):
    out = tmp_path / "out"
    told = viewpoint.run(out, Asked(quick=True))
    assert len(told["rows"]) == 2 * len(viewpoint.MOVES) * 3
    assert all((out / name).is_file() for name in viewpoint.FIGURES)
    assert "turns about its centre" in (out / "page.html").read_text()


@pytest.mark.full
def test_pairs_are_made_once_and_do_not_depend_on_what_else_is_asked_for(monkeypatch):
    made = []
    real = samples.simulate_pairs

    def watched(key, count, **options):
        for pair in real(key, count, **options):
            made.append((pair.agent, pair.action))
            yield pair

    monkeypatch.setattr(samples, "simulate_pairs", watched)
    samples.forget()
    few = samples.pairs_of(None, seed=5, count=1, actions=("poke",), agents=("human",))
    both = samples.pairs_of(None, seed=5, count=2, actions=("poke",))
    assert made == [("human", "poke"), *[("robot", "poke")] * 2, ("human", "poke")]
    human = both.of(agent="human")
    np.testing.assert_array_equal(few.posterior[0], human.posterior[0])
    assert (human.posterior[0] != human.posterior[1]).any()
    deep = samples.pairs_of(
        None, seed=5, count=1, actions=("poke",), agents=("human",), strengths=(2.0, 2.0)
    )
    assert deep.strength.tolist() == [2.0] and len(made) == 5
    samples.forget()


@pytest.mark.full
def test_a_progress_bar_uses_no_pairs_up():
    found = samples.pairs_of(None, seed=5, count=1, actions=("poke",), progress=progress)
    assert len(found) == len(samples.AGENTS)
    samples.forget()


@pytest.mark.full
def test_prediction_crosses_agents_and_csv_equals_json(tmp_path, pairs, capsys):
    datasets.save_pairs(pairs, tmp_path / "data")
    out = tmp_path / "out"
    code = main(["prediction", "--data", str(tmp_path / "data"), "--out", str(out),
                 "--kinds", "D", "--partitions", "2", "--json"])  # fmt: skip
    told = json.loads(capsys.readouterr().out)
    assert code == 0 and told == json.loads((out / "results.json").read_text())
    crossed = {(row["trained_on"], row["agent"]): row for row in told["rows"]}
    assert set(crossed) == {(a, b) for a in samples.AGENTS for b in samples.AGENTS}
    for row in crossed.values():
        assert row["predictor"] == "D" and row["pairs"] == 3 and row["count"] == 2
        assert 0 < row["mean_mm"] < row["change_mm"]
    with (out / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    for line, row in zip(lines, told["rows"], strict=True):
        assert line == {name: "" if value is None else str(value) for name, value in row.items()}
    # Every number of the page's table is one of them.
    page = (out / "page.html").read_text()
    assert all(f"{row['mean_mm']:.2f} ± {row['std_mm']:.2f}" in page for row in told["rows"])


@pytest.mark.full
def test_datasize_leaves_out_what_is_not_there(tmp_path, pairs):
    from benchmarks.experiments import datasize

    datasets.save_pairs(pairs.of(agent="robot"), tmp_path / "data")
    told = datasize.run(
        tmp_path / "out",
        Asked(data=tmp_path / "data", kinds=("D",), sizes=(1, 3, 50), partitions=1),
    )
    assert [row["pairs"] for row in told["rows"]] == [1, 3]
    assert told["notes"] == [
        "Training sets of 50 pairs are left out: poke of robot has 3 pairs to fit to beside those "
        "for testing."
    ]
    with pytest.raises(BadDataset, match="50"):
        datasize.run(tmp_path / "none", Asked(data=tmp_path / "data", kinds=("D",), sizes=(50,)))
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_refinement_compares_one_training_with_itself(tmp_path, pairs, monkeypatch):
    from benchmarks.experiments import refinement

    monkeypatch.setattr(refinement, "COUPLES", refinement.COUPLES[1:])
    datasets.save_pairs(pairs.of(agent="robot"), tmp_path / "data")
    told = refinement.run(
        tmp_path / "out", Asked(data=tmp_path / "data", partitions=1, width=1, epochs=1)
    )
    rows = {row["predictor"]: row for row in told["rows"]}
    assert list(rows) == ["D", "DC", "DCR"]
    for plain, refined in refinement.COUPLES:
        gap = rows[refined]["mean_mm"] - rows[plain]["mean_mm"]
        assert rows[refined]["refined_by_mm"] == pytest.approx(gap, abs=1e-6)
        assert rows[plain]["refined_by_mm"] is None
        assert gap < 0  # hardly trained: what is outside B can only gain
    assert told["settings"]["training"]["width"] == 1


@pytest.mark.full
def test_actions_with_too_few_pairs_are_left_out_and_noted(pairs):
    names = np.array(["knock", *pairs.action[1:].tolist()])
    kept, notes = studies.enough(replace(pairs, action=names), least=4)
    assert set(kept.agent.tolist()) == {"human"} and len(kept) == 4
    assert notes == ["knock of robot is left out: 1 pairs are too few.",
                     "poke of robot is left out: 3 pairs are too few."]  # fmt: skip
    with pytest.raises(BadDataset):
        studies.enough(pairs, least=5)


def test_a_data_set_without_what_is_asked_for_is_refused(tmp_path, pairs):
    datasets.save_pairs(pairs, tmp_path / "data")
    with pytest.raises(BadDataset, match="grasp"):
        samples.pairs_of(tmp_path / "data", seed=0, count=1, actions=("grasp",))
    only = samples.pairs_of(tmp_path / "data", seed=0, count=1, agents=("human",))
    assert set(only.agent.tolist()) == {"human"}


def test_the_distance_shown_is_the_librarys(pair):
    d = metric.to_mm(metric.distance(*pair.images), SMALL)
    assert ranking._d(np.random.default_rng(0), *pair.images) == pytest.approx(float(d))


@pytest.mark.full
def test_refinement_of_a_data_set_takes_its_smallest_action(tmp_path, pairs, monkeypatch):
    from benchmarks.experiments import refinement

    robot = pairs.of(agent="robot")
    names = np.array(["knock"] * len(robot))
    both = {
        name: np.concatenate([getattr(robot, name)] * 2)
        for name in ("prior", "posterior", "agent", "material", "centre", "strength", "path_mm")
    }
    sizes = np.concatenate([robot.size, robot.size - 6])
    ids = np.array([f"{k}" for k in range(2 * len(robot))])
    action = np.concatenate([robot.action, names])
    pairs = replace(robot, **both, size=sizes, id=ids, action=action)
    datasets.save_pairs(pairs, tmp_path / "data")
    monkeypatch.setattr(refinement, "COUPLES", ())
    told = refinement.run(tmp_path / "out", Asked(data=tmp_path / "data", partitions=1))
    assert [(row["predictor"], row["action"]) for row in told["rows"]] == [("D", "knock")]
    assert any("--actions" in note for note in told["notes"])
