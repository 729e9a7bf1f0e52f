"""The options of a search: one set, one place of defaults, the same plan by every way in."""

import inspect
import json
from dataclasses import fields

import jax.numpy as jnp
import numpy as np
import pytest

import jshape
from jshape.app.editor_state import EditorState
from jshape.cli.main import main
from jshape.errors import BadOption
from jshape.io.cameras import write_camera
from jshape.io.images import write_depth_png
from jshape.models.difference import Difference
from jshape.planning.options import GROUPS
from jshape.robot.loop import mold
from tests.test_loop import Obedient

CAMERA = jshape.Camera(72, 60, 90.0, 90.0, 36.0, 30.0, 0.42, 0.47)
UNIT = 1e-5


@pytest.fixture(scope="module")
def bank():
    v, u = np.mgrid[0:13, 0:17]
    dent = np.exp(-(((u - 8) / 4) ** 2) - ((v - 6) / 2) ** 2).astype(np.float32)
    predictors = tuple(Difference(jnp.asarray(-depth * dent)) for depth in (0.1, 0.25))
    return jshape.Bank(CAMERA, predictors, ("press", "poke"), "D", jnp.array([0.1, 0.2]))


@pytest.fixture(scope="module")
def depths(bank):
    """The bed, and a goal that no single action makes, in whole counts."""
    flat = np.full(CAMERA.shape, 0.44)
    goal = flat.copy()
    goal[20:34, 15:50] += 0.004
    return tuple(np.rint(depth / UNIT) * UNIT for depth in (flat, goal))


@pytest.fixture
def folder(tmp_path, monkeypatch, bank, depths):
    monkeypatch.chdir(tmp_path)
    jshape.save_bank(bank, tmp_path / "bank")
    for name, depth in zip(("now", "goal"), depths, strict=True):
        write_depth_png(f"{name}.png", depth, UNIT)
    write_camera(tmp_path / "camera.json", CAMERA, UNIT)
    return tmp_path


def said(plan):
    """All that a plan does."""
    return (
        plan.actions, plan.exact_positions.tolist(), plan.strengths.tolist(), plan.yaws.tolist(),
        plan.status, len(plan.patches),
    )  # fmt: skip


@pytest.mark.full
def test_every_way_in_gives_the_same_plan(folder, bank, depths, capsys):
    found = jshape.plan_depth(*depths, bank=bank)
    assert len(found) > 1 and set(found.strengths.tolist()) - {1.0} and found.yaws.any()
    ways = {"plan": jshape.plan(found.initial, found.goal, bank=bank)}
    assert main(["plan", "now.png", "goal.png", "--bank", "bank", "--out", "out", "--json"]) == 0
    ways["jshape plan"] = jshape.Plan.from_json(folder / "out" / "plan.json")
    ways["mold"] = mold(
        Obedient(bank, found.initial), found.goal, bank, confirm=lambda ahead: False
    ).first_plan
    editor = EditorState(str(folder / "bank"))
    editor.load_bed(folder / "now.png")
    editor.load_goal(folder / "goal.png")
    ways["studio"] = editor.make_plan()
    (folder / "jshape.toml").write_text('[plan]\nbank = "bank"\n')
    capsys.readouterr()
    assert main(["plan", "now.png", "goal.png", "--config", "jshape.toml", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [step["position"] for step in told["steps"]] == found.positions.tolist()
    for way, plan in ways.items():
        assert said(plan) == said(found), way
        np.testing.assert_allclose(plan.distances, found.distances, rtol=1e-4)  # frames in counts


def test_keywords_are_few_and_all_in_the_signature():
    for function in (jshape.plan, jshape.plan_depth):
        keywords = [
            one for one in inspect.signature(function).parameters.values()
            if one.kind is not one.POSITIONAL_OR_KEYWORD
        ]  # fmt: skip
        assert len(keywords) <= 8 and all(one.kind is one.KEYWORD_ONLY for one in keywords)
        assert set(GROUPS) <= {one.name for one in keywords}


def test_the_papers_search_is_one_preset(bank, depths):
    own = jshape.options(jshape.PAPER, bank=bank)
    found = jshape.plan_depth(*depths, **own)
    assert set(found.strengths.tolist()) == {1.0} and not found.yaws.any()
    whole = {tuple(at) for at in jshape.grid(CAMERA, margin=bank.largest_roi).tolist()}
    assert {tuple(at) for at in found.positions.tolist()} <= whole and len(whole) == 15
    assert jshape.PAPER["bank"] in jshape.list_banks()


def test_options_are_fields_of_the_records():
    found = jshape.options(max_steps=3, stride=9, reachable=None, planner="careful")
    assert found["stop"] == jshape.StopCriteria(max_steps=3)
    assert found["space"] == jshape.SearchSpace(stride=9) and found["planner"] == "careful"
    names = [one.name for kind in GROUPS.values() for one in fields(kind)]
    assert len(set(names)) == len(names), "a field says what it is without its record"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jshape.options(max_step=3), "unknown option 'max_step'; did you mean max_steps?"),
        (lambda: jshape.SearchSpace(strides=3), "did you mean stride?"),  # pyright: ignore
        (
            lambda: jshape.plan(0, 0, max_steps=3),
            r"field of stop: stop=StopCriteria\(max_steps=...\)",
        ),
        (lambda: jshape.plan_depth(0, 0, plannner="careful"), "did you mean planner?"),
        (lambda: jshape.plan_depth(0, 0, window=(0, 0, 9, 9)), r"'window'; .*NaN beyond it"),
        (lambda: jshape.plan_depth(0, 0, xyz=1), "'xyz'; allowed: z0, zstar, camera"),
    ],
)
def test_a_misspelt_option_says_what_may_be_meant(call, words):
    with pytest.raises(BadOption, match=words) as caught:
        call()
    assert isinstance(caught.value, TypeError)


def test_options_of_frames_are_refused_where_there_are_none(bank):
    image = np.full(CAMERA.shape, 0.5, np.float32)
    with pytest.raises(jshape.JShapeError, match="constraints: max_missing .*plan_depth"):
        jshape.plan(image, image, bank=bank, **jshape.options(max_missing=0.3))
