"""Results of experiments: numbers that agree, pages that stand alone, folders that are safe."""

import csv
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

import jshape
from benchmarks.experiments import EXPERIMENTS, LeftOut, pages, report, samples
from benchmarks.experiments.__main__ import main
from benchmarks.experiments.pages import Picture, Result, Table
from benchmarks.experiments.planning_tables import gains_figure
from jshape.errors import BadFile, JShapeError, UnknownName
from jshape.io import files

EVIL = "<script>alert(\"1\")</script> & 'so on'"


def figure():
    made = Figure(figsize=(2, 1))
    made.subplots().plot([0, 1], [0, 1])
    return made


def result(**more):
    given = {
        "title": EVIL,
        "paragraphs": [EVIL, "Second."],
        "rows": [
            {"name": EVIL, "mm": np.float32(1.5), "count": 3, "ok": True, "floor": None},
            {"name": "a,b\n'c'", "mm": 0.1, "count": np.int64(4), "late": float("nan")},
        ],
        "tables": [Table(EVIL, ("head<", "b"), [(EVIL, "1")])],
        "pictures": [Picture("one.png", figure, EVIL)],
        "settings": {"kinds": ["D", "P"], EVIL: {"width": 4}, "data": None},
        "notes": [EVIL],
    }
    return Result(**(given | more))


class Reader(HTMLParser):
    """What a browser would make of a page: tags, what they refer to, and the text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.text, self.open = [], [], "", []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("href", "src")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_escapes_and_stands_alone(tmp_path):
    pages.write(result(), tmp_path / "out")
    text = (tmp_path / "out" / "page.html").read_text()
    read = Reader(text)
    assert "script" not in read.tags and not read.open
    assert read.text.count(EVIL) == 8  # title twice, text, caption, table twice, note, setting
    assert set(read.links) == {"one.png", "results.csv", "results.json"}
    assert all((tmp_path / "out" / name).is_file() for name in read.links)
    assert not re.search(r"https?:|//|@import|url\(", text)


def test_csv_and_json_hold_the_same_numbers(tmp_path):
    told = pages.write(result(), tmp_path / "out")
    stored = json.loads((tmp_path / "out" / "results.json").read_text())
    assert stored == json.loads(json.dumps(told))
    with (tmp_path / "out" / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(stored["rows"]) == 2
    for line, row in zip(lines, stored["rows"], strict=True):
        assert set(row) <= set(line)
        for name, text in line.items():
            value = row.get(name)
            assert text == ("" if value is None else str(value))
    assert stored["rows"][1]["late"] is None


def test_a_result_is_whole_or_not_there(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(BadFile):
        pages.write(result(settings={"bad": object()}), out)
    assert not list(tmp_path.iterdir())
    pages.write(result(), out)
    with pytest.raises(BadFile, match="not empty"):
        pages.check(out, False, ["one.png"])
    pages.write(result(title="new"), out, overwrite=True)
    assert "<h1>new</h1>" in (out / "page.html").read_text()
    (out / "my notes.txt").write_text("mine")
    with pytest.raises(BadFile, match="my notes"):
        pages.check(out, True, ["one.png"])


@pytest.fixture
def two(monkeypatch):
    """Two experiments, of which the second fails."""

    def run_one(name, out, *, data=None, **options):
        if name == "viewpoint":
            raise JShapeError(EVIL)
        return pages.write(result(), out, overwrite=options["overwrite"])

    monkeypatch.setattr(report, "run_one", run_one)
    return ("metric", "viewpoint")


def test_the_report_goes_on_after_a_failure_and_says_so(tmp_path, two):
    out, said = tmp_path / "out", []
    with pytest.raises(JShapeError, match="viewpoint"):
        report.run_all(out, names=two, quick=True, say=said.append)
    read = Reader((out / "index.html").read_text())
    assert read.links == ["metric/one.png", "metric/page.html"]
    assert all((out / name).is_file() for name in read.links)
    assert f"Failed: {EVIL}" in read.text and "script" not in read.tags
    rows = json.loads((out / "index.json").read_text())["experiments"]
    assert [(row["name"], row["failed"]) for row in rows] == [("metric", None), ("viewpoint", EVIL)]
    with pytest.raises(BadFile):
        report.run_all(out, names=two)
    assert report.run_all(out, names=two[:1], overwrite=True)["experiments"][0]["failed"] is None


def test_what_this_machine_cannot_do_is_noted_and_is_no_failure(tmp_path, monkeypatch):
    def run_one(name, out, **options):
        if name == "twin":
            raise LeftOut(f"no engine {EVIL}")
        return pages.write(result(), out)

    monkeypatch.setattr(report, "run_one", run_one)
    told = report.run_all(tmp_path / "out", names=("twin", "metric"))
    first, second = told["experiments"]
    assert (first["failed"], first["left_out"]) == (None, f"no engine {EVIL}")
    assert second["left_out"] is None
    read = Reader((tmp_path / "out" / "index.html").read_text())
    assert f"Left out: no engine {EVIL}" in read.text and "script" not in read.tags
    assert "metric/page.html" in read.links and "twin/page.html" not in read.links


def test_a_report_lets_go_of_its_pairs(tmp_path, monkeypatch):
    def run_one(name, out, **options):
        samples._supply(0, "robot", "poke", (1.0, 1.0))
        return pages.write(result(), out)

    monkeypatch.setattr(report, "run_one", run_one)
    report.run_all(tmp_path / "out", names=("metric",))
    assert samples._supply.cache_info().currsize == 0


def test_a_page_is_added_beside_what_is_there(tmp_path):
    (tmp_path / "steps.jsonl").write_text("mine")
    told = pages.add(result(), tmp_path)
    assert json.loads((tmp_path / pages.JSON).read_text()) == json.loads(json.dumps(told))
    assert (tmp_path / "steps.jsonl").read_text() == "mine"
    assert all((tmp_path / name).is_file() for name in pages.contents(["one.png"]))


def test_a_picture_that_cannot_be_drawn_is_left_out(tmp_path, capsys):
    def broken():
        raise RuntimeError("no font")

    found = [Picture("one.png", broken, "bad"), Picture("two.png", figure, "good")]
    content = pages.write(result(pictures=found), tmp_path / "out")
    assert [one["name"] for one in content["figures"]] == ["two.png"]
    assert files.read_json(tmp_path / "out" / "results.json")["figures"] == content["figures"]
    assert "one.png" not in (tmp_path / "out" / "page.html").read_text("utf-8")
    assert (tmp_path / "out" / "two.png").is_file() and "no font" in capsys.readouterr().err


def test_a_page_says_how_it_was_made(tmp_path):
    given = {"quick": True, "seed": 3, "actions": ["knock", "poke"], "overwrite": True}
    words = report.command_of("ablation", tmp_path / "my out", given | {"data": None})
    with pages.made_by(words):
        told = pages.write(result(), tmp_path / "out")["made"]
    assert told["command"] == (
        "python -m benchmarks.experiments ablation --out 'my out' --quick --seed 3 "
        "--actions knock poke"
    )
    assert told["quick"] and told["jshape"] == jshape.__version__
    text = Reader((tmp_path / "out" / "page.html").read_text()).text
    assert "Quick (--quick)" in text and told["command"] in text
    assert f"with jshape {told['jshape']} on {told['date']}" in text
    assert "--only robot" in " ".join(report.command_of("robot", tmp_path, {}))

    with pages.made_by(["program", "--out", "a<b"]):
        pages.write(result(), tmp_path / "own")
    text = Reader((tmp_path / "own" / "page.html").read_text()).text
    assert "Not --quick" in text and "program --out 'a<b'" in text
    assert pages.made()["command"] == "" and pages.made()["quick"] is None


def test_too_few_pairs_are_refused_by_name(tmp_path, capsys):
    code = main(["ablation", "--out", str(tmp_path / "o"), "--pairs", "3"])
    assert code == 2 and "--pairs 3: must be at least 4" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_no_gain_is_cut_off_and_only_a_line_that_is_there_is_explained():
    rng = np.random.default_rng(0)
    both = [*rng.normal(0, 0.1, (60, 2)).tolist(), [0.1, -3.0], [-2.0, 0.2], [4.0, 0.1], [0.2, 5.0]]
    steps = [{"action": "poke", "predicted_gain_mm": p, "gain_mm": g} for p, g in both]
    runs = [{"method": "greedy", "loop": "closed", "steps": steps}]
    made = gains_figure(runs, {})
    for limits, values in zip(
        (made.axes[0].get_xlim(), made.axes[0].get_ylim()), zip(*both, strict=True), strict=True
    ):
        assert limits[0] < min(values) and max(values) < limits[1]
    assert "dotted" not in made.get_supxlabel()
    with_line = gains_figure(runs, {"greedy": {"poke": 0.3}})
    assert "dotted: usual error" in with_line.get_supxlabel()


def test_unknown_experiments_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(UnknownName, match="metric"):
        report.run_all(tmp_path / "out", names=["metrik"])
    with pytest.raises(UnknownName):
        report.run_one("metrik", tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [*EXPERIMENTS, "all"])
def test_every_experiment_has_a_parser(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(option in text for option in ("--out", "--quick", "--seed", "--overwrite"))


def test_simulated_sizes_and_a_data_set_exclude_each_other(tmp_path, capsys):
    code = main(["prediction", "--out", str(tmp_path / "o"), "--data", "d",
                 "--pairs", "3"])  # fmt: skip
    assert code == 2 and "--pairs" in capsys.readouterr().err
