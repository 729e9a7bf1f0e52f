"""Imports point one way, and the numerical core touches no disk, clock, device or OpenCV."""

import ast
from pathlib import Path

from tests.conftest import ROOT

PACKAGE = ROOT / "jshape"
FILES = sorted(PACKAGE.rglob("*.py"))

FLOORS = (
    {"_typing", "errors", "compiling"},
    {"camera"},
    {"reproject", "height_map", "metric", "actions", "sim"},
    {"models", "data", "viz"},
    {"io", "learn"},
    {"planning", "goals"},
    {"robot", "__init__"},
    {"app"},
    {"cli"},
)
"""Parts of the package, lowest first; a part imports only itself and what lies below."""

PURE = ("camera", "reproject", "height_map", "metric", "actions", "models", "sim",
        "planning/search", "planning/evaluate", "planning/state", "planning/apply",
        "planning/candidates")  # fmt: skip
FORBIDDEN = {"os", "io", "pathlib", "time", "datetime", "cv2", "shutil", "tempfile", "random"}
CALLS = {"open", "print", "eval", "exec", "input"}


def inside(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix().removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Full names of what a file imports, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def files_of(name: str) -> Path | None:
    """The file of the package that an imported name lies in; None: it is not ours."""
    parts = name.split(".")
    if parts[0] != "jshape":
        return None
    for count in range(len(parts), 0, -1):
        base = PACKAGE.joinpath(*parts[1:count])
        for path in (base.with_suffix(".py") if count > 1 else base, base / "__init__.py"):
            if path.is_file():
                return path
    raise AssertionError(name)


def part_of(path: Path) -> str:
    """A directory or file of the package; `python -m jshape` is the command line."""
    name = inside(path).split("/")[0]
    return "cli" if name == "__main__" else name


def test_every_part_has_a_floor_and_imports_point_down():
    level = {part: k for k, parts in enumerate(FLOORS) for part in parts}
    assert {part_of(path) for path in FILES} == set(level)
    up = []
    for path in FILES:
        part = part_of(path)
        for name in imported(path):
            found = files_of(name)
            other = part if found is None else part_of(found)
            if other != part and level[other] >= level[part]:
                up.append(f"{inside(path)} -> {name}")
    assert not up


def test_no_files_import_each_other_in_a_circle():
    arrows = {path: {f for n in imported(path) if (f := files_of(n))} - {path} for path in FILES}
    free: set[Path] = set()
    while more := {path for path in FILES if path not in free and arrows[path] <= free}:
        free |= more
    assert not sorted(map(inside, set(FILES) - free))


def test_the_numerical_core_has_no_side_doors():
    doors = []
    for path in FILES:
        if not inside(path).startswith(PURE):
            continue
        doors += [f"{inside(path)}: {n}" for n in imported(path) if n.split(".")[0] in FORBIDDEN]
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                doors += [f"{inside(path)}: {node.func.id}"] * (node.func.id in CALLS)
    assert not doors


def test_a_class_name_means_one_thing():
    """No two public classes of one name, wherever they lie."""
    places: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(inside(path))
    assert len(places) > 100  # the package was read
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_no_pickle_anywhere():
    for path in FILES:
        modules = {name.split(".")[0] for name in imported(path)}
        assert not modules & {"pickle", "marshal", "shelve"}, path
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant) and node.value.value is False, path


def test_files_are_one_noun_long():
    long = {inside(path): n for path in FILES if (n := len(path.read_text().splitlines())) > 400}
    assert not long
