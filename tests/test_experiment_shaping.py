"""Goals that are planned and carried out: retrieval, the search tree, what the paper varied."""

import json

import jax
import numpy as np
import pytest

from benchmarks.experiments import EXPERIMENTS, generalization, open_loop, shaping
from benchmarks.experiments.open_loop import Method
from benchmarks.experiments.problems import Applied
from benchmarks.experiments.samples import Asked
from benchmarks.experiments.shaping_figures import outcomes_figure, tree_figure
from jshape import PAPER_BOX, actions, metric, sim
from jshape.errors import UnknownName
from jshape.io import banks
from jshape.robot.simulated import SimulatedWorld


@pytest.fixture(scope="module")
def told():
    """A knock and a poke in level flour, planned with f_D at the paper's places."""
    bed = sim.flat_bed()
    applied = [Applied("knock", (91, 91), 1.0, 0.0), Applied("poke", (388, 303), 1.0, 0.0)]
    other = SimulatedWorld(jax.random.key(3), bed)
    for one in applied:
        other.act(*one)
    bank = open_loop.with_actions(banks.load_bank("flour-robot"), shaping.ACTIONS)
    method = Method("f_D", bank, "robot, flour", shaping.GRID, shaping.TRIED[shaping.GRID], 0.0)
    (outcome,) = shaping.shaped(5, bed, other.bed, applied, [method])
    return outcome


@pytest.mark.full
def test_the_plan_is_what_was_applied_and_the_distance_falls(told):
    row = told.row
    assert row["exact"] and row["retrieved"] == 1.0 and row["falls"]
    assert row["planned"] == "knock (91, 91), poke (388, 303)" == row["applied"]
    assert row["obtained_mm"] < 0.6 * row["before_mm"]
    assert told.images.shape == (3, *PAPER_BOX.shape)
    seen = [metric.to_mm(metric.distance(i, told.plan.goal), PAPER_BOX) for i in told.images]
    np.testing.assert_allclose(told.distances_mm, seen, rtol=1e-5)
    assert told.distances_mm[0] == pytest.approx(told.plan.distances_mm[0], rel=1e-5)


@pytest.mark.full
def test_the_tree_holds_the_best_of_each_step(told):
    layers = shaping.tree(told, count=3)
    assert [len(layer) for layer in layers] == [3, 3, 3]
    for step, layer in enumerate(layers[:-1]):
        best = layer[0]
        assert best.chosen and not any(one.chosen for one in layer[1:])
        assert best.action == told.plan.actions[step]
        assert best.position == tuple(told.plan.positions[step])
        assert best.distance_mm == pytest.approx(told.plan.distances_mm[step + 1], abs=1e-3)
        distances = [one.distance_mm for one in layer]
        assert distances == sorted(distances)
    # Every action at every place, one by one on whole images: none is better than the chosen.
    bank, start, goal = told.method.bank, told.plan.images[0], told.plan.goal
    after = []
    for name in bank.actions:
        w, h = bank.roi(name)
        for u, v in actions.grid(PAPER_BOX, 5, 3).tolist():
            window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
            image = start.copy()
            image[window] = bank.predict(name, image[window], position=(u, v))
            after.append(float(metric.to_mm(metric.distance(image, goal), PAPER_BOX)))
    np.testing.assert_allclose([one.distance_mm for one in layers[0]], sorted(after)[:3], atol=1e-3)
    assert min(one.distance_mm for one in layers[-1]) >= told.plan.distances_mm[-1] - 1e-3


@pytest.mark.full
def test_the_figures_say_what_was_chosen(told):
    layers = shaping.tree(told, count=3)
    drawn = tree_figure(["one"], [1.0], [layers]).axes[0]
    said = [text.get_text() for text in drawn.texts]
    assert any(text.startswith("knock (91, 91)") for text in said)
    assert "none lowers d: stop" in said and len(said) == 1 + 9 + 1
    bold = [line for line in drawn.lines if line.get_linewidth() > 2]
    assert len(bold) == 2
    axes = outcomes_figure(["one"], [told], [[told]]).axes
    np.testing.assert_allclose(axes[4].lines[1].get_ydata(), told.distances_mm)


def test_shaping_writes_a_row_for_every_method(told, tmp_path, monkeypatch):
    monkeypatch.setattr(shaping, "PROBLEMS", {True: (0,)})
    monkeypatch.setattr(shaping, "methods", lambda *_: [
        Method("f_P", told.method.bank, "robot, flour", shaping.GRID, told.method.tried, 0.0)
    ])  # fmt: skip
    beds, applied = (sim.flat_bed(), sim.flat_bed(sim.DEPTH - 0.005)), list(told.applied)
    monkeypatch.setattr(shaping, "problem", lambda *_: (*beds, applied))
    content = shaping.run(tmp_path / "out", Asked(quick=True))
    (row,) = content["rows"]
    assert row["problem"] == 1 and row["goal_by"] == "robot"
    # No action makes the whole bed 5 mm lower.
    assert row["before_mm"] == pytest.approx(5, rel=0.1)
    assert row["actions"] == 0 == row["retrieved"] and not row["falls"]
    assert content == json.loads((tmp_path / "out" / "results.json").read_text())
    for name in shaping.FIGURES:
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")


def test_a_bank_is_cut_to_some_actions(bank):
    cut = open_loop.with_actions(bank, ("poke",))
    assert cut.actions == ("poke",) and cut.roi("poke") == bank.roi("poke")
    with pytest.raises(UnknownName, match="grasp"):
        open_loop.with_actions(bank, ("grasp",))


def test_situations_are_what_they_say():
    places = {tuple(place) for place in actions.grid(PAPER_BOX, 7, 3).tolist()}
    for situation in generalization.SITUATIONS:
        for k in range(8):
            applied = generalization.drawn(np.random.default_rng(k), situation)
            assert len({one.action for one in applied}) == 3
            assert {one.position for one in applied} <= places
            apart = abs(applied[0].position[0] - applied[1].position[0])
            assert (apart < 60) == situation.overlapping
            deep = [one for one in applied if one.strength > 1]
            assert {one.action for one in deep} == (
                {"knock", "poke"} if situation.deeper else set()
            )
            assert all(2.0 <= one.strength <= 2.9 for one in deep)


@pytest.mark.full
def test_generalization_counts_what_each_predictor_finds(tmp_path, monkeypatch, bank):
    known = [
        Method("f_D", bank, "nobody", name, {"positions": actions.grid(PAPER_BOX, 7, 3)}, 0.0)
        for name in ("f_D sand", "f_P sand")
    ]
    level = generalization.SITUATIONS[0]
    monkeypatch.setattr(generalization, "SITUATIONS", (level,) * 2)
    monkeypatch.setattr(generalization, "methods", lambda *_: known)
    applied = [Applied("knock", (240, 197), 1.0, 0.0)]
    monkeypatch.setattr(generalization, "drawn", lambda *_: applied)
    content = generalization.run(tmp_path / "out", Asked(quick=True))
    assert {row["situation"] for row in content["rows"]} == {"level flour"}
    first, second = (
        [row for row in content["rows"] if row["name"] == method.where] for method in known
    )
    for one, other in zip(first, second, strict=True):  # the same bank, so the same is done
        assert one["planned"] == other["planned"] and one["applied"] == "knock (240, 197)"
        assert one["obtained_each_mm"] == other["obtained_each_mm"]
    assert all((tmp_path / "out" / name).is_file() for name in generalization.FIGURES)


def test_both_are_commands():
    assert {"shaping", "generalization"} <= set(EXPERIMENTS)
