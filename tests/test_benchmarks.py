"""The benchmarks' report: goals, the baseline, and the page that is renewed."""

import numpy as np
import pytest

from benchmarks import gpu, page, real_effects
from benchmarks.report import Report
from benchmarks.run import PARTS
from tests.conftest import ROOT


def measured(count=10.0, ratio=2.0):
    report = Report(part="unet")
    report.add("multiplications", count, "", tolerance=1)
    report.add("copy bandwidth", ratio, "times", more=True, tolerance=1.5)
    report.add("time", 1.0, "s")
    return report


def test_real_effects_are_centred(shared_data):
    lower, pitch = real_effects.maps_of(shared_data / "real" / "craters", "compacted", 1, 99)
    assert lower.shape == (12, 101, 101) and pitch == pytest.approx(2.8025e-3)
    middle = np.s_[:, 45:56, 45:56]
    assert (lower[middle].mean((1, 2)) < -0.003).all()  # a mound lies in the middle of each cut
    assert np.abs(lower[:, :10]).mean() < 5e-4


def test_a_goal_is_the_most_or_the_least():
    report = Report(part="unet")
    report.add("a", 1.0, "s", goal=1)
    report.add("b", 1.1, "s", goal=1)
    report.add("c", 1.1, "times", goal=1, more=True)
    report.add("d", 1.0, "s")
    assert [row.met for row in report.rows] == [True, False, True, None]


def test_the_baseline_holds_what_does_not_depend_on_the_machine():
    baseline = measured().accepted({"planning: kept": {"value": 1}})
    assert set(baseline) == {"planning: kept", "unet: multiplications", "unet: copy bandwidth"}
    assert measured().worse(baseline) == []
    assert measured(9, 1.34).worse(baseline) == []  # better; and worse by less than 1.5 times
    found = measured(11, 1.33).worse(baseline)
    assert len(found) == 2
    assert "11" in found[0] and "was 10" in found[0] and "allowed <= 10" in found[0]
    assert "allowed >= 1.333" in found[1]


def test_rows_that_come_and_go_are_named():
    baseline = measured().accepted({})
    report = Report(part="unet")
    report.add("multiplications", 10, "", tolerance=1)
    report.add("new", 1, "", tolerance=1)
    found = report.worse(baseline)
    assert any("new: not in the baseline" in line for line in found)
    assert any("copy bandwidth: in the baseline" in line for line in found)
    assert Report(part="unet").worse(baseline) == []  # the part was not run


def test_nothing_is_measured_twice():
    with pytest.raises(ValueError, match="twice"):
        measured().add("time", 1.0, "s")


def test_the_page_is_renewed_where_its_places_are(tmp_path):
    text = "words\n<!-- bench: machine -->\nold\n<!-- end -->\n<!-- bench: unet -->\n<!-- end -->\n"
    path = tmp_path / "page.md"
    path.write_text(text)
    (tmp_path / "images").mkdir()
    out = tmp_path / "out"
    out.mkdir()
    (out / "curve.png").write_bytes(b"figure")
    report = measured()
    report.table("Sizes", ("size", "ms"), [("240x198", "1.0")])
    page.renew(path, report, out)
    renewed = path.read_text()
    assert renewed.startswith("words\n") and "old" not in renewed and "jax " in renewed
    assert "| 240x198 | 1.0 |" in renewed and "| multiplications | 10  |  |" in renewed
    assert (tmp_path / "images" / "bench_curve.png").read_bytes() == b"figure"
    page.renew(path, report, out)
    assert path.read_text() == renewed
    more = text + "<!-- bench: start -->\n<!-- end -->\n"  # a part that was not run
    path.write_text(more)
    page.renew(path, report, out)
    assert "old" in path.read_text() and "| 240x198 | 1.0 |" in path.read_text()
    path.write_text(renewed)
    report.part = "simulator"
    report.add("beds", 80, "1/s")
    with pytest.raises(ValueError, match="no place for simulator"):
        page.renew(path, report, out)


def test_every_part_has_its_place_on_the_page():
    places = [name for _, name, _ in page.PLACE.findall((ROOT / "docs/benchmarks.md").read_text())]
    assert places == ["machine", *PARTS]


@pytest.mark.slow
def test_the_accelerators_table_runs_where_there_is_none(capsys):
    gpu.main(["--quick"])
    head, *rows, last = capsys.readouterr().out.splitlines()
    assert head.split("  ")[0] == "what" and last == "no accelerator here: the CPU alone"
    assert len(rows) >= 7 and all(row.split()[-2:] == ["-", "-"] for row in rows)


def test_the_accelerators_table_has_ratios_where_both_were_measured():
    cpu, other = {"sweep: D": 3.0, "training: U": 9.0}, {"sweep: D": 0.5, "training: U": np.nan}
    assert gpu.rows(cpu, other) == [
        ("sweep", "D", "3", "0.5", "6"), ("training", "U", "9", "-", "-"),
    ]  # fmt: skip
    assert gpu.rows(cpu, None)[0] == ("sweep", "D", "3", "-", "-")
