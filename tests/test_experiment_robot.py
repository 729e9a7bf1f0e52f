"""The paper's robot problems: what is asked, what is written, and that a robot solves one."""

import json

import numpy as np
import pytest

from benchmarks.experiments import LeftOut, pages, robot, robot_page
from benchmarks.experiments.samples import Asked
from jshape import PAPER_BOX, actions
from jshape.errors import UnknownName
from jshape.io import files


@pytest.mark.full
def test_problems_are_the_papers():
    """Grasp, knock and poke once each on the grid of 15, apart from one another."""
    grid = {tuple(place) for place in actions.grid(PAPER_BOX, 5, 3).tolist()}
    seen = set()
    for number, agent in enumerate(robot.AGENTS):
        bed, wanted, applied = robot.problem(0, number, agent)
        assert sorted(one.action for one in applied) == ["grasp", "knock", "poke"]
        assert {one.position for one in applied} <= grid
        u = sorted(one.position[0] for one in applied)
        assert min(np.diff(u)) > 100
        assert np.abs(wanted.height - bed.height).max() > 0.01
        seen.add(tuple((one.action, one.position) for one in applied))
    assert len(seen) == 6


@pytest.mark.full
def test_a_problem_is_solved_and_written_down(tmp_path, monkeypatch):
    monkeypatch.setattr(robot, "AGENTS", ("robot",))
    monkeypatch.setattr(robot, "TRIED", {"max_steps": 3})
    monkeypatch.setattr(robot, "QUICK", (0,))
    monkeypatch.setattr(robot, "TRIED_QUICK", {"max_steps": 3})
    lines = []
    content = robot.run_robot(
        tmp_path / "six", arm="sim", bank_name="flour-robot", say=lines.append
    )
    (row,) = content["rows"]
    assert row["retrieved"] == 1.0 and sorted(row["actions"]) == ["grasp", "knock", "poke"]
    assert (np.diff(row["obtained_mm"]) < 0).all()
    assert row["obtained_mm"][-1] < 0.5 * row["obtained_mm"][0]
    assert content == json.loads((tmp_path / "six" / "robot.json").read_text())
    assert "| 1 | robot |" in (tmp_path / "six" / "report.md").read_text()
    for name in ("robot.png", "curves.png"):
        assert (tmp_path / "six" / name).read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "six" / "page.html").read_text()
    assert (
        "the simulator&#x27;s hand" in page
        and " → ".join(f"{d:.2f}" for d in row["obtained_mm"]) in page
    )
    (flat,) = json.loads((tmp_path / "six" / "results.json").read_text())["rows"]
    assert flat["obtained_mm"] == " ".join(f"{d:.4f}" for d in row["obtained_mm"])


def test_without_the_twin_the_simulators_hand_stands_in(tmp_path, monkeypatch):
    asked = {}

    def no_engine():
        raise LeftOut("no mujoco")

    def run_robot(out, **options):
        asked.update(options)
        files.write_json(out / pages.JSON, {"title": "six"})

    (tmp_path / "six").mkdir()
    monkeypatch.setattr(robot, "check_engine", no_engine)
    monkeypatch.setattr(robot, "run_robot", run_robot)
    assert robot.run(tmp_path / "six") == {"title": "six"}
    assert asked["arm"] == "sim" and "no mujoco" in asked["notes"][0]
    monkeypatch.setattr(robot, "check_engine", lambda: None)
    robot.run(tmp_path / "six")
    assert asked["arm"] == "mujoco" and not asked["notes"]
    robot.run(tmp_path / "six", Asked(quick=True))
    assert asked["arm"] == "sim" and asked["quick"]


def test_an_arm_that_is_none_is_refused(tmp_path):
    with pytest.raises(UnknownName, match="mujoco, sim"):
        robot.run_robot(tmp_path / "six", arm="kuka")
    assert not (tmp_path / "six").exists()


def test_the_page_says_as_in_the_paper_only_when_every_distance_falls():
    def said(*obtained):
        rows = [{"obtained_mm": d, "retrieved": 1.0, "goal_by": "robot"} for d in obtained]
        return robot_page.words(rows, "an arm")[1]

    assert "In 2 of 2 problems" in (all_fall := said([2.0, 1.0], [3.0, 2.0, 1.0]))
    assert "falls at each step, as in the paper;" in all_fall
    some = said([2.0, 1.0], [2.0, 1.0, 1.5])
    assert "In 1 of 2 problems" in some and "as in the paper" not in some
    assert "In 0 of 1 problems" in said([2.0])  # no action was carried out
