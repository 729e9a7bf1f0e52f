"""What is heavy loads only when it is used: importing and planning need none of it."""

import subprocess
import sys
import tomllib

import pytest

from jshape.cli.extras import EXTRAS
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
print(*{"matplotlib", "cv2", "orbax", "tqdm", "trimesh"} & set(sys.modules))
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
    extras = set(project["optional-dependencies"]) - {"dev", "docs", "bench"}
    assert extras == {extra.name for extra in EXTRAS}
