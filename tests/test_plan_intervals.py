"""The 80 % intervals that a plan carries: of its images' pixels and of its distances."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jshape import Plan, rollout, to_mm
from jshape.actions import first_pixels
from jshape.cli import plan as table
from jshape.errors import BadFile
from jshape.models.spread import LEAST_MM, radii_px
from jshape.planning.intervals import IN_D
from jshape.viz import pictures
from tests.reference.spread import around_slowly
from tests.test_bank import CAMERA, bank_of

SPREAD = np.array([[0.3, 0.2], [0.5, 0.0]], np.float32)
ACTIONS, AT = ["grasp", "poke", "grasp"], [(10, 9), (12, 10), (25, 20)]


@pytest.fixture
def images(rng):
    return rng.uniform(0.3, 0.6, (2, *CAMERA.shape)).astype(np.float32)


@pytest.fixture
def bank(rng):
    return replace(bank_of(rng, [0.5, 0.5]), intervals=jnp.asarray(SPREAD))


@pytest.fixture
def plan(bank, images):
    return rollout(*images, ACTIONS, AT, bank=bank)


def squares_slowly(plan):
    """(K+1, H, W) squares of the half widths after each action, mm²."""
    radii, found = radii_px(CAMERA), [np.zeros(CAMERA.shape)]
    firsts = first_pixels(plan.positions, plan.rois)
    for k, ((u, v), (w, h)) in enumerate(zip(firsts, plan.rois, strict=True)):
        window = np.s_[v : v + h, u : u + w]
        change = np.asarray(to_mm(plan.images[k + 1][window] - plan.images[k][window], CAMERA))
        mm, share = plan.spreads[k]
        found.append(found[-1].copy())
        found[-1][window] += np.maximum(mm + share * around_slowly(change, radii), LEAST_MM) ** 2
    return np.stack(found)


def test_where_rois_overlap_squares_add(plan):
    np.testing.assert_array_equal(plan.spreads, SPREAD[[0, 1, 0]])
    expected = squares_slowly(plan)
    for k in range(4):
        np.testing.assert_allclose(plan.half_widths_after(k), expected[k] ** 0.5, rtol=1e-4)
    np.testing.assert_array_equal(plan.half_widths_mm, plan.half_widths_after(3))
    assert (plan.half_widths_mm == 0).any() and plan.half_widths_mm.max() > 1.0


def test_the_interval_of_d_is_half_of_the_mean_half_width(plan, bank, images):
    means = (squares_slowly(plan) ** 0.5).mean((1, 2))
    np.testing.assert_allclose(plan.distance_half_widths_mm, IN_D * means, rtol=1e-4)
    assert plan.interval_after(0) == ""
    assert plan.interval_after(3) == f", 80 %: ±{plan.distance_half_widths_mm[3]:.2f}"
    assert plan.columns()["80 % (mm)"][2] == f"±{plan.distance_half_widths_mm[3]:.2f}"
    seen = np.zeros(CAMERA.shape, bool)
    seen[:, :15] = True
    part = rollout(*images, ACTIONS, AT, bank=bank, seen=seen)
    found = IN_D * part.half_widths_mm[seen].mean()
    np.testing.assert_allclose(part.distance_half_widths_mm[-1], found, rtol=1e-5)
    rest = plan.rest(2)  # the bed is looked at: only what comes now is not sure
    assert rest.distance_half_widths_mm.shape == (2,) and rest.distance_half_widths_mm[0] == 0
    np.testing.assert_array_equal(rest.spreads, SPREAD[:1])


def test_what_is_not_known_is_not_claimed(bank, images, capsys):
    """A bank without a spread; one that knows that of some actions only."""
    without = rollout(*images, ACTIONS, AT, bank=replace(bank, intervals=None))
    assert without.half_widths_mm is None and without.distance_half_widths_mm is None
    assert without.interval_after(3) == "" and "80 % (mm)" not in without.columns()
    table._print(without, "greedy")
    assert "80 %" not in capsys.readouterr().out
    some = replace(bank, intervals=jnp.array([[0.3, 0.2], [jnp.nan, jnp.nan]]))
    some = rollout(*images, ACTIONS, AT, bank=some)
    assert np.isfinite(some.half_widths_after(1)).all() and np.isnan(some.half_widths_mm).any()
    np.testing.assert_array_equal(
        np.isfinite(some.distance_half_widths_mm), [True, True, False, False]
    )
    assert some.columns()["80 % (mm)"][1:] == ["", ""] and some.interval_after(3) == ""
    nothing = rollout(*images, [], bank=bank)
    assert nothing.half_widths_mm is None and nothing.interval_after(0) == ""


def test_pictures_and_tables_show_it(plan, capsys):
    plain = replace(plan, spreads=np.full((3, 2), np.nan, np.float32))
    titles = {ax.get_title() for ax in pictures.plan_figure(plan).axes}
    assert titles - {ax.get_title() for ax in pictures.plan_figure(plain).axes} == {
        "four of five pixels are within ±", "predicted - goal, beyond ±",
    }  # fmt: skip
    table._print(plan, "greedy")
    said = f"{plan.distances_mm[-1]:.3f} mm from the goal{plan.interval_after(3)}"
    assert said in capsys.readouterr().out


def test_files_keep_it(plan, tmp_path):
    path = tmp_path / "plan.json"
    plan.to_json(path)
    back, content = Plan.from_json(path), json.loads(path.read_text())
    np.testing.assert_array_equal(back.spreads, plan.spreads)
    np.testing.assert_array_equal(back.half_widths_mm, plan.half_widths_mm)
    steps = content["steps"]
    widths = [step["half_width_mm"] for step in steps]
    np.testing.assert_allclose(widths, plan.distance_half_widths_mm[1:], rtol=1e-6)
    for bad in ([0.3], [0.3, -0.1], [0.3, "x"], "wide"):
        path.write_text(json.dumps(content | {"steps": [steps[0] | {"spread": bad}, *steps[1:]]}))
        with pytest.raises(BadFile, match="step 1: spread"):
            Plan.from_json(path)
    old = [
        {k: v for k, v in step.items() if k not in ("spread", "half_width_mm")} for step in steps
    ]
    path.write_text(json.dumps(content | {"steps": old}))
    assert Plan.from_json(path).half_widths_mm is None
    replace(plan, spreads=np.full((3, 2), np.nan, np.float32)).to_json(path)
    assert json.loads(path.read_text())["steps"][0]["half_width_mm"] is None
    plan.to_json(path, images=False)  # the interval of d is in the file for people
    assert json.loads(path.read_text())["steps"] == steps
    assert Plan.from_json(path).half_widths_mm is None
