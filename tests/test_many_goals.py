"""Many goals and beds at once: the plans are those of one by one."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jshape
from jshape import compiling, options, plan, plan_batch
from jshape.planning import many
from jshape.planning.devices import Execution
from jshape.planning.evaluate import sweep
from jshape.planning.search import greedy
from tests.test_many_candidates import CAMERA, SMALL, differences, hands, on, rough

__all__ = ["hands"]
COUNT = 5


def problems(kind, hands):
    """A bank, beds and goals (B, H, W)."""
    rng = np.random.default_rng(3)
    if kind == "image":
        bank, shape, size = differences(rng), CAMERA.shape, 3.0
    else:
        bank, shape, size = hands, SMALL.shape, 6.0
    beds, goals = (np.stack([rough(rng, shape, size) for _ in range(COUNT)]) for _ in range(2))
    goals[-1] = beds[-1]  # one that is reached at once: they end at different times
    return bank, beds, goals


def assert_same(one, other):
    assert one.actions == other.actions and one.status == other.status
    assert one.evaluations == other.evaluations
    for name in ("positions", "exact_positions", "strengths", "yaws", "lengths", "distances"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-6)


@pytest.mark.full
@pytest.mark.parametrize("kind", ["image", "ground"])
def test_a_batch_is_planned_as_one_by_one(kind, hands, monkeypatch):
    """By a CPU's threads, and vmapped as on an accelerator, some goals a call."""
    bank, beds, goals = problems(kind, hands)
    how = options(bank=bank, max_steps=4, stride=8, strengths=(0.5, 1.0), min_gain_mm=0.0)
    alone = [plan(*pair, **how) for pair in zip(beds, goals, strict=True)]
    assert len({len(one) for one in alone}) > 1
    found = plan_batch(beds, goals, **how)
    vmapped = lambda asked: greedy.search_each(asked, 2)  # noqa: E731
    monkeypatch.setattr(many, "search_each", vmapped)
    for batch in (found, plan_batch(beds, goals, **how)):
        for one, other in zip(batch, alone, strict=True):
            assert_same(one, other)


@pytest.mark.slow
def test_many_candidates_and_carries_too(monkeypatch):
    """What material costs, and the actions after it has cost."""
    bank = jshape.load_bank("moving-flour-robot").seen_by(SMALL, 0.45)
    chosen = {name: bank.predictor(name) for name in ("poke", "scoop", "pour")}
    bank = replace(
        bank, actions=tuple(chosen), predictors=tuple(chosen.values()), errors_mm=None,
        intervals=None,
    )  # fmt: skip
    v, u = np.mgrid[: SMALL.height, : SMALL.width]

    def mound(at, high=0.25):
        return np.float32(high * np.exp(-((u - at) ** 2 + (v - 49) ** 2) / 128))

    bed = 0.5 + mound(35)
    goals = np.stack([0.5 + mound(85), 0.5 + mound(75, 0.2) - mound(30, 0.1)])
    how = options(bank=bank, max_steps=4, stride=10, yaws=1, strengths=(0.5, 1.0), lengths=(1.0,))
    how = options(how, min_gain_mm=0.0)
    alone = [plan(bed, goal, **how) for goal in goals]
    assert "pour" in alone[0].actions
    vmapped = lambda asked: greedy.search_each(asked, 2)  # noqa: E731
    for search in (greedy.search_each, vmapped):
        monkeypatch.setattr(many, "search_each", search)
        for one, other in zip(plan_batch(bed, goals, **how), alone, strict=True):
            assert_same(one, other)


def test_another_number_of_goals_compiles_nothing(hands):
    bank, beds, goals = problems("image", hands)
    how = options(bank=bank, max_steps=4, stride=8, strengths=(0.5, 1.0), min_gain_mm=0.0)
    plan_batch(beds[:2], goals[:2], **how)
    compiled = []
    compiling.listen(lambda: compiled.append(1))
    found = plan_batch(beds[0], goals, **how)  # of one bed
    assert not compiled and [len(one) > 0 for one in found] == [True] * COUNT
    assert all(one.seconds == found[0].seconds > 0 for one in found)
    assert plan_batch(beds[:0], goals[:0], **how) == []


@pytest.mark.parametrize(
    "named", [{"evaluations": 50}, pytest.param({"planner": "careful"}, marks=pytest.mark.full)]
)
def test_other_searches_are_planned_one_after_the_other(named, hands):
    bank, beds, goals = problems("image", hands)
    how = options(bank=bank, max_steps=2, stride=8, strengths=(0.5, 1.0), **named)
    for one, other in zip(
        plan_batch(beds[:2], goals[:2], **how), map(lambda *x: plan(*x, **how), beds, goals[:2]),
        strict=False,
    ):  # fmt: skip
        assert_same(one, other)


def test_what_does_not_fit_together_is_refused(hands):
    bank, beds, goals = problems("image", hands)
    with pytest.raises(jshape.JShapeError, match="5 beds, 3 goals were given"):
        plan_batch(beds, goals[:3], bank=bank)
    with pytest.raises(jshape.JShapeError, match=r"Istars\[1\] has 1 pixels that are NaN"):
        goals[1, 3, 4] = np.nan
        plan_batch(beds, goals, bank=bank)
    with pytest.raises(jshape.JShapeError, match="1 beds, 5 goals and 2 plans to start with"):
        plan_batch(beds[:1], goals, bank=bank, start=[None, None])


@pytest.mark.parametrize("kind", ["image", pytest.param("ground", marks=pytest.mark.full)])
def test_a_vmapped_sweep_finds_the_same(kind, hands):
    """An accelerator's way beside the CPU's, both on the CPU."""
    state, candidates = on(kind, 7, hands)
    in_a_row, vmapped = (sweep(state, candidates, Execution(n)) for n in (0, 20_000))
    for one, other in zip(in_a_row, vmapped, strict=True):
        assert np.count_nonzero(one)
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=2e-7)


def test_an_accelerator_has_its_chunks_of_its_memory(monkeypatch):
    class Card:
        def memory_stats(self):
            return {"bytes_limit": 2**33}

    from jshape.planning import devices

    assert Execution().nodes == 0 and devices.goals_together(2**20, 100) == 1
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "local_devices", lambda: [Card()])
    assert Execution().nodes == 2**22 and Execution(chunk=7).nodes == 7
    assert [devices.goals_together(2**20, n) for n in (1, 5, 10**6)] == [1, 8, 256]
    assert devices.goals_together(2**40, 9) == 1
