"""The wheel alone, in an empty environment, can plan."""

import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT

PLAN = """
import numpy as np, jshape
from jshape.planning.candidates import placed_positions
bank = jshape.load_bank("flour-robot")
assert "flour-robot" in jshape.list_banks()
now = np.full(bank.camera.shape, 0.5, np.float32)
goal = now.copy()
w, h = bank.roi("knock")
u, v = placed_positions(bank, "paper")["knock"][7]
window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
goal[window] = bank.predict("knock", goal[window])
plan = jshape.plan(now, goal, **jshape.PAPER | {"bank": bank})
assert plan.actions == ("knock",) and plan.positions.tolist() == [[u, v]], plan
print("planned with", jshape.__file__)
"""


def run(*command, **options):
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(command, capture_output=True, text=True, env=clean, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.full
def test_the_wheel_installs_elsewhere_and_plans(tmp_path):
    """Builds the wheel, installs it with its dependencies into a new environment, plans there."""
    pip = ["-m", "pip", "--disable-pip-version-check", "--quiet"]
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", tmp_path, ROOT)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.stat().st_size < 5e6
    run(sys.executable, "-m", "venv", tmp_path / "empty")
    python = tmp_path / "empty" / "bin" / "python"
    run(python, *pip, "install", "-c", ROOT / "constraints.txt", wheel)
    said = run(python, "-c", PLAN, cwd=tmp_path)
    assert str(tmp_path / "empty") in said
    jshape = tmp_path / "empty" / "bin" / "jshape"
    bare = subprocess.run([jshape, "plan"], capture_output=True, text=True, cwd=tmp_path)
    assert bare.returncode == 2 and "pip install 'jshape[cli]'" in bare.stderr
    run(python, *pip, "install", "-c", ROOT / "constraints.txt", f"{wheel}[cli]")
    help_ = run(jshape, "plan", "--help", cwd=tmp_path)
    assert "Usage: jshape plan" in help_
