"""The authors' way of computing Algorithm 1, as the benchmarks transcribe it."""

from dataclasses import replace

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import growth
from benchmarks.authors import SPREAD, Agreement, rounding_cannot_decide, steps_of
from benchmarks.plan_as_authors import authors_way, plan_as_authors
from benchmarks.problems import Problem, made_problem, rounded, weighed
from jshape import Camera
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from tests.reference import greedy as twin

CAMERA = Camera(40, 30, 40.0, 40.0, 20.0, 15.0, 0.42, 0.47)
ROIS = {"a": (11, 9), "b": (7, 12)}
PLACES = {name: np.array([[8, 8], [20, 14], [13, 16], [30, 20], [31, 9]]) for name in ROIS}


def problem(seed=0, **options) -> Problem:
    rng = np.random.default_rng(7)
    deltas = (-rng.uniform(0.05, 0.2, (h, w)) for w, h in ROIS.values())
    made = tuple(Difference(jnp.asarray(delta, jnp.float32)) for delta in deltas)
    options = {"strengths": SPREAD, "noise": 2.0} | options
    return made_problem(Bank(CAMERA, made, tuple(ROIS)), PLACES, 4, seed=seed, **options)


def deltas_of(made):
    return [np.asarray(predictor.delta) for predictor in made.bank.predictors]


def test_eight_bits_are_read_back_as_written():
    levels = np.random.default_rng(0).integers(0, 256, CAMERA.shape).astype(np.uint8)
    assert (rounded(weighed(levels, CAMERA), CAMERA) == levels).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_first_step_is_the_twins(seed):
    made = problem(seed)
    images = [weighed(x, CAMERA) for x in (made.luminance, made.wanted)]
    steps, _, _ = twin.greedy(*images, deltas_of(made), list(PLACES.values()), 1)
    assert authors_way(made, 1).steps == [step[:2] for step in steps]


def test_images_are_rounded_between_steps():
    made = problem()
    plan = authors_way(made, 3)
    assert len(plan.steps) == 3
    for before, after, (action, place) in zip(
        plan.images, plan.images[1:], plan.steps, strict=False
    ):
        exact = twin.inject(before, deltas_of(made)[action], PLACES["a"][place])
        np.testing.assert_array_equal(after, weighed(rounded(exact, CAMERA), CAMERA))
        assert (after != exact).any()


def test_it_stops_where_nothing_gains():
    made = problem()
    assert authors_way(replace(made, wanted=made.luminance), 3).steps == []
    long = authors_way(made, 50)
    assert 0 < len(long.steps) < 50
    again = authors_way(replace(made, luminance=rounded(long.images[-1], CAMERA)), 50)
    assert again.steps == []


def test_files_and_tuning_change_no_plan(tmp_path):
    made = problem()
    plain = authors_way(made, 4)
    assert authors_way(made, 4, files=True).steps == plain.steps
    assert authors_way(made, 4, tuned=True).steps == plain.steps
    predictors = [lambda roi, first, d=d: np.clip(roi + d, 0, 1) for d in deltas_of(made)]
    plan_as_authors(
        *made.exact_images, made.rays, made.to_mm, predictors, list(ROIS.values()),
        list(PLACES.values()), 1, folder=tmp_path,
    )  # fmt: skip
    kept = sorted(tmp_path.glob("*/img.png"))
    assert len(kept) == made.count == 10
    first = twin.inject(weighed(made.luminance, CAMERA), deltas_of(made)[0], PLACES["a"][0])
    seen = cv2.imread(str(tmp_path / "0_0_0" / "img.png"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(seen, rounded(first, CAMERA))


@pytest.mark.full
def test_both_ways_agree_where_rounding_cannot_decide():
    agreement = Agreement()
    for seed in range(6):
        agreement.compare(problem(seed), 5)
    assert agreement.decided_alike == agreement.decided > agreement.choices / 2
    assert agreement.alike <= agreement.choices


def test_what_rounding_cannot_decide():
    made = problem()
    now = made.images[0]
    nothing = np.zeros(CAMERA.shape)
    assert rounding_cannot_decide(made, now, nothing)
    assert not rounding_cannot_decide(made, now, nothing + 0.1)
    beside = nothing.copy()
    beside[:, -1] = 1.0  # in no window
    assert rounding_cannot_decide(made, now, beside)
    best = authors_way(made, 1).steps[0][1]
    tie = replace(made, places={name: at[[best, best]] for name, at in PLACES.items()})
    assert not rounding_cannot_decide(tie, now, nothing)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3))
def test_evaluations_are_counted_as_the_search_makes_them(seed):
    made = problem(seed)
    plan = made.ours(3)
    count, pixels = made.evaluated(plan)
    assert count == plan.evaluations
    assert count * 84 <= pixels <= count * 99  # 7x12 and 11x9
    assert steps_of(made, plan) == [step[:2] for step in made.twin(3)]


def test_rounds_leave_out_what_took_its_time():
    calls = {"slow": 0, "fast": 0}

    def call(name):
        calls[name] += 1

    clock = iter(np.cumsum([0, 2.0, 0, 0.1, 0, 0.1, 0, 0.1]).tolist())
    found = growth.in_rounds(
        {"slow": lambda: call("slow"), "fast": lambda: call("fast")}, rounds=3, most=1.0,
        clock=lambda: next(clock),
    )  # fmt: skip
    assert calls == {"slow": 1, "fast": 3}
    assert found == {"slow": pytest.approx(2.0), "fast": pytest.approx(0.1)}


def test_the_curves_are_drawn(tmp_path):
    lines = {name: [(1, 1e-3 * k), (10, 1.1e-3 * k)] for k, name in enumerate(growth.LOOKS, 1)}
    growth.draw({("title", "steps"): lines}, tmp_path / "curves.png")
    assert cv2.imread(str(tmp_path / "curves.png")).std() > 10
