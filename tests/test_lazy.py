"""What is heavy loads only when it is used: importing and planning need none of it."""

import subprocess
import sys
import tomllib

import pytest

from jshape.cli.doctor import EXTRAS
from tests.conftest import ROOT

PROGRAM = """
import sys

import jax.numpy as jnp
import numpy as np

import jshape
from jshape.models.difference import Difference

camera = jshape.Camera(24, 20, 30.0, 30.0, 12.0, 10.0, 0.42, 0.47)
bank = jshape.Bank(camera, (Difference(jnp.full((8, 8), -0.2)),), ("poke",))
now = np.full((20, 24), 0.5, np.float32)
goal = now.copy()
goal[8:16, 8:16] -= 0.2
plan = jshape.plan(now, goal, bank=bank)
assert plan.distances[-1] < plan.distances[0]
assert jshape.fit and jshape.load_bank and jshape.load_pairs
print(*{"matplotlib", "cv2", "orbax", "cyclopts", "rich", "PIL", "trimesh"} & set(sys.modules))
"""
BLOCKED = """
import sys

sys.modules |= dict.fromkeys(("cyclopts", "matplotlib", "PIL", "rich"))
"""
WITHOUT = """
from jshape.goals import relief_of_text
from jshape.io.formats import encode_png, read_png

counts = np.arange(6, dtype=np.uint16).reshape(2, 3)
assert (read_png(encode_png(counts), "a.png") == counts).all()
assert jshape.load_bank("flour-robot").predict("knock", jnp.full((104, 112), 0.5)) is not None
assert plan._repr_html_() is None
for draw in (plan.show, lambda: relief_of_text("J", 0.01)):
    try:
        draw()
        raise SystemExit("it was drawn")
    except jshape.JShapeError as problem:
        assert "needs matplotlib" in str(problem), problem
        assert "pip install 'jshape[cli]'" in str(problem), problem
"""


@pytest.mark.full
def test_a_plan_loads_no_pictures_no_opencv_and_no_orbax():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_what_the_wheel_requires_is_little_and_extras_are_known():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert set(extras) - {"dev", "docs", "bench"} == {extra.name for extra in EXTRAS}
    assert len(project["dependencies"]) <= 8 and set(extras["cli"]) <= set(extras["dev"])


def without_the_command_line(*program):
    """A fresh process in which what the extra `cli` brings cannot be imported."""
    return subprocess.run(
        [sys.executable, "-c", *program], cwd=ROOT, capture_output=True, text=True, timeout=300
    )


@pytest.mark.full
def test_planning_needs_nothing_of_the_command_line():
    done = without_the_command_line(BLOCKED + PROGRAM + WITHOUT)
    assert done.returncode == 0, done.stderr


def test_the_console_command_names_its_extra():
    run = "from jshape.cli.main import main; sys.exit(main())"
    done = without_the_command_line(BLOCKED + run, "plan", "--help")
    assert done.returncode == 2 and done.stdout == ""
    said = "jshape: error: the command line needs cyclopts: pip install 'jshape[cli]'\n"
    assert done.stderr == said
