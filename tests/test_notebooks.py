"""The lessons in `notebooks/`: each runs without a warning, and is kept as it was last run."""

import pytest

pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

from notebooks.execute import NOTEBOOKS, errors_of, execute, read, tidy  # noqa: E402

LARGEST = 400_000
"""Bytes of a notebook with its pictures."""
ONE_EACH = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem[:2])


def test_the_lessons_are_numbered():
    assert [path.name[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06"]


@pytest.mark.full
@ONE_EACH
def test_notebook_runs_without_warnings(path):
    assert errors_of(execute(read(path))) == []  # its own asserts say whether the lesson holds


@ONE_EACH
def test_notebook_is_kept_with_outputs_and_without_traces(path):
    text, notebook = path.read_text(encoding="utf-8"), read(path)
    assert len(text) < LARGEST
    assert not [word for word in ("/tmp", "/root", "/home", "/work", "/Users") if word in text]
    assert errors_of(notebook) == []
    assert [c.get("outputs") for c in notebook.cells] == [
        c.get("outputs") for c in tidy(read(path)).cells
    ]
    assert notebook.metadata == tidy(read(path)).metadata
    assert any(
        "image/png" in output.get("data", {})
        for cell in notebook.cells
        for output in cell.get("outputs", [])
    )


@ONE_EACH
def test_notebook_is_a_lesson(path):
    words = [cell.source for cell in read(path).cells if cell.cell_type == "markdown"]
    code = [cell.source for cell in read(path).cells if cell.cell_type == "code"]
    assert words[0].startswith(f"# {int(path.name[:2])}. ")
    assert "## What to change for your own case" in words[-1]
    lines = [line.strip() for cell in code for line in cell.splitlines()]
    assert sum(line.startswith("assert ") for line in lines) >= 4
