"""What surrounds the code stays true: workflows, citation, type marker, and what objects say."""

import re
import tomllib

import pytest
import yaml

import jshape
from tests.conftest import ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_call_commands_that_exist(path):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    jobs = yaml.safe_load(path.read_text())["jobs"].values()
    said = " ".join(step.get("run", "") for job in jobs for step in job["steps"])
    called = set(re.findall(r"\bmake ([a-z-]+)", said))
    assert called and called <= targets


def test_every_version_of_python_that_is_promised_is_tested():
    test = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())
    tested = test["jobs"]["test"]["strategy"]["matrix"]["python-version"]
    said = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert tested == said and PROJECT["requires-python"] == f">={tested[0]}"


def test_hooks_and_constraints_have_one_version_of_ruff():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    (ruff,) = (repo["rev"] for repo in hooks if "ruff" in repo["repo"])
    assert f"ruff=={ruff.removeprefix('v')}" in (ROOT / "constraints.txt").read_text().splitlines()


def test_the_citation_is_the_papers():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    paper = cited["preferred-citation"]
    names = [author["family-names"] for author in paper["authors"]]
    assert names == ["Gursoy", "Tarbouriech", "Cherubini"]
    assert paper["title"].replace(" ", "") in "".join(
        (ROOT / "docs" / "index.md").read_text().split()
    )
    assert cited["license"] == PROJECT["license"]


def test_types_travel_with_the_package():
    assert (ROOT / "jshape" / "py.typed").is_file()


def test_dir_shows_public_names_only():
    assert {name for name in dir(jshape) if not name.startswith("__")} == set(jshape.__all__)


def test_a_bank_says_in_one_line_what_it_is(bank):
    said = "Bank(D: knock 100x80, poke 40x45; camera 480x395)"
    assert repr(bank) == said
    for name in jshape.list_banks():
        text = repr(jshape.load_bank(name))
        assert "fitted to" in text and "\n" not in text and len(text) <= 400
