"""`jshape doctor`: it finds what is there, says what is not, and fails where the core does."""

import json
import re
import shutil
import subprocess
import sys
import tomllib

import pytest

from jshape.cli import doctor
from jshape.cli.main import main
from jshape.io import banks
from tests.conftest import ROOT


@pytest.fixture
def quick(monkeypatch):
    """Without extras, and with only the quick part of the self-test."""
    monkeypatch.setattr(doctor, "EXTRAS", ())
    monkeypatch.setattr(doctor, "SELFTEST", {"distance": doctor.SELFTEST["distance of two images"]})


def asked(capsys):
    code = main(["doctor", "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.full
def test_everything_works_here(capsys):
    code, found = asked(capsys)
    assert code == 0 and found["good"] is True and found["problems"] == []
    assert {row["package"]: row["version"] for row in found["core"]}["jax"].count(".") == 2
    assert found["devices"]["cores"] >= 1 and found["devices"]["found"]
    assert {row["name"] for row in found["banks"]["found"]} == set(banks.list_banks())
    seconds = {row["test"]: row["seconds"] for row in found["selftest"]}
    assert set(seconds) == set(doctor.SELFTEST) and max(seconds.values()) > 0.1
    assert re.match(r"knock at \(\d+, \d+\), 0\.\d+ -> 0\.\d+ mm", found["selftest"][1]["found"])
    for row in found["extras"]:
        assert row["installed"] or row["pip"] == f"pip install 'jshape[{row['extra']}]'"


def test_people_read_it(quick, capsys):
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    for words in ("jshape ", "Python ", "cores: ", "numpy", "flour-robot", "as NumPy finds",
                  "all that the core needs works"):  # fmt: skip
        assert words in text


def test_a_damaged_bank_is_found(quick, capsys, tmp_path, monkeypatch):
    shutil.copytree(ROOT / "weights" / "flour-robot", tmp_path / "w" / "flour-robot")
    path = tmp_path / "w" / "flour-robot" / "effects.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    monkeypatch.setattr(banks, "_bundled_roots", lambda: (tmp_path / "w",))
    code, found = asked(capsys)
    assert code == 1 and found["good"] is False
    assert len(found["problems"]) == 1 and "checksum differs" in found["problems"][0]
    assert main(["doctor"]) == 1
    text = capsys.readouterr().out
    assert "BAD bank flour-robot: " in text and "all that the core needs" not in text
    monkeypatch.setattr(banks, "_bundled_roots", lambda: ())
    assert "none is bundled" in asked(capsys)[1]["problems"][0]


def test_a_missing_package_of_the_core_is_found(quick, capsys, monkeypatch):
    monkeypatch.setitem(doctor.CORE, "ghost", "no_such_module_of_jshape")
    code, found = asked(capsys)
    assert code == 1
    assert found["problems"] == ["ghost: No module named 'no_such_module_of_jshape'"]


def test_wrong_numbers_are_found(quick, capsys, monkeypatch):
    monkeypatch.setattr("jshape.distance", lambda a, b: 0.25, raising=False)
    code, found = asked(capsys)
    assert code == 1 and re.search(r"0\.2500000; NumPy finds 0\.33", found["problems"][0])


@pytest.mark.full
def test_a_plan_that_misses_is_found(monkeypatch):
    monkeypatch.setattr(doctor, "PLACE", (91, 92))
    monkeypatch.setattr(doctor, "NEAR", 1)
    with pytest.raises(ValueError, match=r"a knock at \(\d+, \d+\); \(91, 92\) within 1 pixels"):
        doctor._plan()


def test_it_speaks_where_jax_does_not_import(tmp_path):
    """In a new process whose JAX is broken: the doctor is for exactly that."""
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax" / "__init__.py").write_text("raise ImportError('a broken JAX')\n")
    code = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]\n"
        "from jshape.cli import doctor\ndoctor.EXTRAS = ()\n"
        "from jshape.cli.main import main\nsys.exit(main(['doctor', '--json']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    problems = json.loads(done.stdout)["problems"]
    assert "jax: a broken JAX" in problems and any(p.startswith("devices: ") for p in problems)


def test_extras_are_loaded_for_real():
    good = doctor.look(doctor.Extra("x", "", ("json",)))
    assert good["installed"] and good["problem"] == ""
    gone = doctor.look(doctor.Extra("ghost", "", ("no_such_module_of_jshape",), "libghost1"))
    assert not gone["installed"] and gone["pip"] == "pip install 'jshape[ghost]'"
    assert doctor._extra(gone) == (
        "not installed: pip install 'jshape[ghost]'; Debian: apt install libghost1"
    )
    program = "raise OSError('libghost.so.1: cannot open shared object file')"
    broken = doctor.look(doctor.Extra("x", "", ("json",), "libghost1", program))
    assert broken["installed"] and "libghost.so.1: cannot open" in broken["problem"]
    assert doctor._extra(broken).startswith("BAD: OSError: libghost")
    crashed = doctor.look(doctor.Extra("x", "", ("json",), "", "import os; os.abort()"))
    assert "ended with code -6" in crashed["problem"]


def test_extras_and_core_are_those_of_the_project():
    """Each extra that people would want is looked at, and each package of the core."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    offered = set(project["optional-dependencies"]) - {"dev", "bench", "docs"}
    assert {extra.name for extra in doctor.EXTRAS} == offered
    needed = {re.split(r"[<>=\[]", line)[0] for line in project["dependencies"]}
    assert needed == set(doctor.CORE) - {"jaxlib"}  # which JAX brings
