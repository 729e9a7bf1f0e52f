"""Imports point one way, and the numerical core touches no disk, clock, device or OpenCV."""

import ast
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGE = ROOT / "jshape"
FILES = sorted(PACKAGE.rglob("*.py"))

# What each part may import of jshape (besides itself and _typing, closing, errors: open to all).
ALLOWED = {
    "camera": set(),
    "metric": {"camera"},
    "clouds": set(),
    "actions": {"camera", "metric"},
    "nn": set(),
    "predict": {"camera", "metric", "actions", "nn"},
    "planners": {"camera", "metric", "actions", "predict"},
    "sim": {"camera", "metric", "actions"},
    "data": {"camera", "metric", "actions", "predict", "sim"},
    "learn": {"camera", "metric", "actions", "nn", "predict", "data"},
    "store": {
        *("camera", "metric", "actions", "nn", "predict", "planners", "data", "learn"),
        *("planned", "planning", "robot"),
    },
    "places": {"camera", "actions", "predict"},
    "planned": {"camera", "metric", "actions", "planners", "data", "store"},
    "tasks": {"actions", "predict", "planners", "planned"},
    "rollouts": {"camera", "metric", "actions", "predict", "planners", "planned", "tasks"},
    "planning": {
        *("camera", "metric", "actions", "predict", "planners", "data", "store"),
        *("places", "planned", "tasks", "rollouts"),
    },
    "goals": {"camera", "metric", "predict", "sim", "data", "store"},
    "devices": {"predict"},
    "engines": {"devices"},
    "robot": {
        *("camera", "metric", "actions", "predict", "planners", "planned", "planning", "sim"),
        *("data", "store"),
    },
    "viz": {
        *("camera", "metric", "actions", "predict", "planners", "planned", "planning", "learn"),
        "goals",
    },
    "view": {
        *("camera", "metric", "predict", "planners", "planned", "planning", "data", "store"),
        *("robot", "viz"),
    },
}
TOP = {"__init__", "__main__", "cli", "commands", "experiments", "studio"}
"""May import anything, and nothing imports them but each other."""
FREE = {"_typing", "closing", "compiling", "errors", "listening"}
"""Anything may import them."""

PURE = {"camera", "metric", "nn", "predict", "planners", "sim"}
FORBIDDEN = {"os", "io", "pathlib", "time", "datetime", "cv2", "shutil", "tempfile", "random"}


def part_of(path: Path) -> str:
    inside = path.relative_to(PACKAGE).parts
    return inside[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Full names of the modules that a file imports, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_inwards(path):
    part = part_of(path)
    if part in TOP | FREE:
        return
    parts = {name.split(".")[1] for name in imported(path) if name.startswith("jshape.")}
    assert parts <= ALLOWED[part] | {part} | FREE


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_numerical_core_has_no_side_doors(path):
    if part_of(path) not in PURE:
        return
    assert not {name.split(".")[0] for name in imported(path)} & FORBIDDEN
    calls = {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not calls & {"open", "print", "eval", "exec", "input"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_pickle_anywhere(path):
    assert not {name.split(".")[0] for name in imported(path)} & {"pickle", "marshal", "shelve"}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            assert isinstance(node.value, ast.Constant) and node.value.value is False


def test_files_are_one_noun_long():
    long = {str(p): n for p in FILES if (n := len(p.read_text().splitlines())) > 400}
    assert not long
