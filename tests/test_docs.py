"""The documentation: it builds without a warning, leads nowhere wrong, and has every name."""

import importlib
import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from urllib.parse import urlsplit

import pytest

import jshape
from notebooks.execute import NOTEBOOKS
from tests.conftest import ROOT
from tests.documentation import DOCS, PAGES, anchors, blocks, commands, links

NEEDED = ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers", "griffe")
LISTED = ("jshape", "jshape.goals", "jshape.sim")
"""All that is in their `__all__` is on the API page."""
WHOLE = (
    "jshape.learn.evaluate",
    "jshape.robot.arms.base",
    "jshape.robot.cameras.base",
    "jshape.robot.calibration",
    "jshape.robot.waypoints",
    "jshape.robot.pose_file",
    "jshape.planning.devices",
    "jshape.errors",
)
"""All that these modules define is."""
SINGLE = (
    "jshape.robot.loop.mold",
    "jshape.robot.loop.World",
    "jshape.robot.loop.Molding",
    "jshape.robot.robot.Robot",
    "jshape.robot.simulated.SimulatedWorld",
    "jshape.robot.cameras.played.Played",
    "jshape.data.intrinsics.pinhole",
)


def _text(path):
    """A page; of a notebook, what it says."""
    if path.suffix != ".ipynb":
        return path.read_text(encoding="utf-8")
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as `make docs` does."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        pytest.skip(f"{missing[0]} is not installed (extra docs)")
    folder = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
        timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.full
def test_the_site_builds_without_a_warning_and_needs_no_other(site):
    for page in DOCS:
        home = site if page.stem == "index" else site / page.stem
        text = (home / "index.html").read_text(encoding="utf-8")
        assert not re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"?https?:", text)
    programs = [path for path in site.rglob("*.py") if path.is_file()]
    assert not programs, "the site's own programs are no pages"
    assert (site / "repository" / "notebooks" / NOTEBOOKS[0].name / "index.html").is_file()


@pytest.mark.full
def test_every_public_name_is_documented(site):
    import griffe

    package = griffe.load("jshape", search_paths=[ROOT], resolve_aliases=True)
    page = (site / "api" / "index.html").read_text(encoding="utf-8")
    there = set(re.findall(r'id="(jshape\.[\w.]+)"', page))
    for name in _public():
        found = package[name.removeprefix("jshape.")]
        there_as = {name, found.canonical_path} & there
        assert there_as, f"{name} is not on docs/api.md"
        assert found.has_docstring, f"{name} has no docstring"


def _public():
    """Every name that people may use."""
    yield from SINGLE
    for module in LISTED:
        yield from (f"{module}.{name}" for name in importlib.import_module(module).__all__)
    for module in WHOLE:
        names = vars(importlib.import_module(module)).items()
        for name, value in names:
            if not name.startswith("_") and getattr(value, "__module__", None) == module:
                yield f"{module}.{name}"


def test_names_of_the_api_page_are_there():
    for line in re.findall(r"^::: (\S+)", _text(ROOT / "docs/api.md"), re.MULTILINE):
        module, _, name = line.rpartition(".")
        try:
            importlib.import_module(line)
        except ModuleNotFoundError:
            assert hasattr(importlib.import_module(module), name), line
    assert set(jshape.__all__) <= set(dir(jshape))


@pytest.mark.parametrize("path", [*PAGES, *NOTEBOOKS], ids=lambda path: path.name)
def test_no_link_is_dead(path):
    text = _text(path)
    for link in links(text):
        where = urlsplit(link)
        if where.scheme:  # elsewhere: only its form, tests must run without a network
            assert where.scheme in ("https", "mailto") and "." in where.netloc + where.path, link
            continue
        there = path if not where.path else (path.parent / where.path).resolve()
        assert there.exists(), f"{path.name}: {link} is not there"
        assert there.is_relative_to(ROOT), f"{path.name}: {link} leaves the repository"
        if where.fragment and there.suffix == ".md":
            assert where.fragment in anchors(_text(there)), f"{path.name}: {link}: no such heading"


def test_every_picture_of_the_documentation_is_shown():
    shown = {
        (path.parent / link).resolve()
        for path in [*PAGES, *NOTEBOOKS]
        for link in links(_text(path))
        if not urlsplit(link).scheme
    }
    kept = {path for path in (ROOT / "docs/images").iterdir()}
    assert not kept - shown, "pictures that no page shows"


def test_the_checker_sees_what_is_wrong():
    text = """# A `b` and [c](d.md): e!

see [x](y.md#z), ![p](images/p.png) and `[no](link)`, [u](https://a.org)

## Twice
## Twice

```console
$ jshape plan a b \\
  --out c   # said
1 action
```

```console
make docs      # a comment
jshape goal flat --actions 'knock 2,3; press 4,5'
# only this
```

````python
[no](code.md)
````
"""
    assert links(text) == ["d.md", "y.md#z", "images/p.png", "https://a.org"]
    assert anchors(text) == {"a-b-and-c-e", "twice", "twice-1"}
    assert list(commands(text)) == [
        "jshape plan a b --out c", "make docs", "jshape goal flat --actions 'knock 2,3; press 4,5'",
    ]  # fmt: skip
    assert [block.language for block in blocks(text)] == ["console", "console", "python"]
