"""The twin's check as a page, from numbers that no physics made, and what is said without it."""

from importlib.util import find_spec

import pytest

from benchmarks.experiments import LeftOut, pages, twin, twin_page
from jshape.errors import JShapeError
from jshape.robot.twin import engine

EFFORT = {"above": 1.0, "contact": 3.0, "act": 41.5, "up": 20.0}


def trial(action, place, error):
    return {
        "action": action, "place": place, "operations": 6, "place_error_mm": error,
        "touched_below_surface_mm": 0.2, "ended_by_contact": ["contact"], "effort_nm": EFFORT,
        "joint_margin_degrees": 10.0, "collisions": [["fist", "wall"]], "deepest_change_mm": 12.0,
    }  # fmt: skip


@pytest.fixture(scope="module")
def content():
    trials = [trial("grasp", [91, 197], 0.1), trial("grasp", [388, 197], 0.3),
              trial("poke", [91, 197], 0.2)]  # fmt: skip
    return {
        "actions": [twin.summary(name, trials) for name in ("grasp", "poke")],
        "obstacle": {"on it": trials[0], "beside it": trials[2]},
        "trials": trials,
    }


def test_the_page_has_the_numbers_of_the_report(tmp_path, content):
    told = pages.add(twin_page.page_of(content), tmp_path)
    assert "3 of 3 actions were completed, with 3 collisions" in told["paragraphs"][1]
    assert "0.20 mm on average and 0.30 mm at most" in told["paragraphs"][1]
    assert [row["place_error_mm"] for row in told["rows"]] == [0.1, 0.3, 0.2]
    assert (
        told["rows"][0]["effort_act_nm"] == 41.5 and told["rows"][0]["collisions"] == "fist - wall"
    )
    page = (tmp_path / pages.PAGE).read_text()
    report = twin_page.report(content)
    for cells in twin_page.table(content)[1]:
        assert all(f"<td>{cell}</td>" in page for cell in cells)
        assert f"| {' | '.join(cells)} |" in report
    assert "- on it: effort 42 Nm" in report


def test_without_physics_it_is_left_out(tmp_path, monkeypatch):
    def missing():
        raise JShapeError("the twin needs mink")

    monkeypatch.setattr(engine, "mink", missing)
    with pytest.raises(LeftOut, match="mink"):
        twin.run(tmp_path / "twin")
    assert not (tmp_path / "twin").exists()


def test_with_nothing_to_draw_with_it_is_left_out(tmp_path, monkeypatch):
    def blind(*_):
        raise engine.NoPicture("no way to draw")

    if find_spec("mink") is None:  # to import it here would choose how MuJoCo draws
        pytest.skip("the extra sim is not installed")
    monkeypatch.setattr(engine, "renderer", blind)
    with pytest.raises(LeftOut, match="draw"):
        twin.run(tmp_path / "twin")
    assert not (tmp_path / "twin").exists()
