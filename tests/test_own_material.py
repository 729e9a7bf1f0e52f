"""A material and a hand from files, wherever the command line takes their names."""

import json
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from jshape import sim
from jshape.cli.main import main
from jshape.errors import BadFile, UnknownName
from jshape.io.simulated import agent_of, material_of, read_agent, read_material

DOC = (Path(__file__).parents[1] / "docs" / "own_material.md").read_text()
CLAY, SPATULA, LADLE = re.findall(r"```toml\n(.*?)```", DOC, re.S)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("clay.toml").write_text(CLAY)
    Path("spatula.toml").write_text(SPATULA)
    return tmp_path


def test_the_documented_material_reads():
    clay = read_material("clay.toml")
    assert clay.name == "clay" and clay.elastic == 0.05 and clay.near == pytest.approx(0.01)
    assert clay.repose == pytest.approx(np.radians(45))
    few = {"name": "few", "like": "flour", "pile_mm": 12}
    Path("few.json").write_text(json.dumps(few))
    few = read_material("few.json")
    assert few.pile == pytest.approx(0.012) and few.cohesion == sim.FLOUR.cohesion
    assert material_of("few.json") == few and material_of("sand") is sim.KINETIC_SAND


def test_the_documented_hand_acts():
    spatula = read_agent("spatula.toml")
    bed = sim.flat_bed()
    after = sim.apply_action(
        jax.random.key(0), bed, read_material("clay.toml"), ("scrape", spatula), (0.0, 0.0)
    )
    sunk = np.asarray(bed.height - after.height)
    assert sunk.max() > 0.005 and sunk.min() < -0.001  # a groove, and what it pushed aside
    with pytest.raises(UnknownName, match="unknown action 'poke'; allowed: scrape"):
        sim.stroke("poke", spatula)
    assert agent_of("human") == "human"


def test_the_documented_ladle_takes_and_gives():
    Path("ladle.toml").write_text(LADLE)
    ladle = read_agent("ladle.toml")
    box = sim.flat_bed(size=(0.32, 0.3), cell=0.005)
    dug, filled = (
        sim.apply_action(jax.random.key(0), box, "flour", (name, ladle), (0.0, 0.0))
        for name in ("dig", "fill")
    )
    assert 10e-6 < float(dug.stock) < 60e-6
    assert float(filled.stock) == pytest.approx(-30e-6, rel=1e-4)
    x, _ = (np.asarray(axis) for axis in box.axes())
    heaped = np.asarray(filled.height - box.height).max(0) > 1e-3
    assert np.ptp(x[heaped]) > 0.08  # 60 mm of stream, and the foot of its heap


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name = 'x'", "has no repose_deg; give all ten numbers, or like = 'flour'"),
        ("like = 'flour'\npile = 1", "unknown 'pile'; allowed: .*did you mean pile_mm"),
        ("like = 'flour'\npile_mm = 0.012", "pile_mm is 0.012; expected a number from 1 to 100"),
        ("like = 'flour'\nelastic = true", "elastic is True; expected a number from 0 to 0.99"),
        ("like = 'mud'", "like is 'mud'; allowed: flour, sand, dough"),
        ("name = ''\nlike = 'flour'", "name is ''; expected a line of text"),
        ("like = ", "is not TOML"),
    ],
)
def test_a_wrong_material_is_refused_in_one_line(text, said):
    Path("bad.toml").write_text(text)
    with pytest.raises(BadFile, match=f"^bad.toml: .*{said}|^bad.toml: {said}") as found:
        read_material("bad.toml")
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[actions.scrape]", "[other]", "unknown 'other'"),
        ("radius_mm = 6", "radius_mm = 0.006", "finger 1: radius_mm is 0.006; expected"),
        (
            "[-20, 20, 12]]",
            "[-20, 20]]",
            "path_mm is .*; expected 3 x 2 x 3 numbers from -140",
        ),
        ("times = [0, 0.4, 1]", "times = [0, 1, 0.4]", "times are .*three rising from 0 to 1"),
        ("reach_mm = [25, 25]", "reach_mm = [0, 25]", "reach_mm is"),
        ("yaw_deg = 2", "yaw = 2", "spread: unknown 'yaw'"),
    ],
)
def test_a_wrong_hand_is_refused_in_one_line(old, new, said):
    Path("bad.toml").write_text(SPATULA.replace(old, new))
    with pytest.raises(BadFile, match=said) as found:
        read_agent("bad.toml")
    assert "\n" not in str(found.value)


@pytest.mark.full
def test_commands_take_files_where_they_take_names(capsys):
    command = ["dataset", "simulate", "pairs", "--pairs", "1", "--frames", "1"]
    files = ["--material", "clay.toml", "--agents", "spatula.toml", "--actions", "scrape"]
    assert main([*command, *files]) == 0
    rows = Path("pairs/pairs.csv").read_text().splitlines()
    assert ",scrape,spatula,clay," in rows[1]
    capsys.readouterr()
    for words in (
        [*command[:2], "other", "--material", "mud.toml"],
        ["demo", "--out", "demo", "--material", "mud.toml"],
        ["mold", "goal.png", "--out", "run", "--yes", "--arm", "sim", "--material", "mud.toml"],
        ["goal", "bed.png", "--text", "A", "--out", "goal", "--material", "mud.toml"],
    ):
        assert main(words) == 2, words
        assert "mud.toml: no such file" in capsys.readouterr().err.splitlines()[-1], words
    assert main([*command[:2], "other", "--material", "floor"]) == 2
    assert "allowed: flour, sand, dough, FILE.toml, FILE.json; did you mean flour" in (
        capsys.readouterr().err
    )
