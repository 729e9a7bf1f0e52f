"""The examples run, and do what they say."""

import runpy

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera, sim, weigh
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from tests.conftest import ROOT

WHOLE = Camera(100, 80, 72.0, 72.0, 50.0, 40.0, 0.42, 0.47)
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def small_bank(*names):
    """A bank for a camera of 80x60 pixels that knows what simulated actions do."""
    camera = WHOLE.crop(10, 10, 80, 60)
    bed = sim.flat_bed()

    def image(bed):
        return weigh(camera.luminance(sim.render(bed, camera), quantize=False), camera)

    def effect(name):
        after = sim.apply_action(jax.random.key(1), bed, sim.FLOUR, (name, "robot"), (0.0, 0.0))
        return jnp.asarray(image(after) - image(bed), jnp.float32)[20:40, 30:50]

    return Bank(camera, tuple(Difference(effect(name)) for name in names), names, "D")


@pytest.fixture(scope="module")
def small():
    """What a knock does."""
    return small_bank("knock")


RUNS = {
    "01_plan": lambda small, tmp_path: {"bank": small},
    "02_depth_frames": lambda small, tmp_path: {"bank": small, "camera": WHOLE},
    "03_fit_a_bank": lambda small, tmp_path: {"folder": tmp_path / "bank", "count": 4, "kind": "D"},
    "04_closed_loop": lambda small, tmp_path: {"bank": small},
    "05_own_arm": lambda small, tmp_path: {},
    "06_own_camera": lambda small, tmp_path: {},
    "07_own_material": lambda small, tmp_path: {"camera": PAPER_BOX.crop(200, 160, 80, 60)},
    "08_carry_material": lambda small, tmp_path: {
        "bank": small_bank("scoop", "pour"),
        "film": tmp_path / "mound.gif",
        "steps": 4,
    },  # fmt: skip
}
SHOWS = {
    "01_plan": lambda plan: plan.actions and plan.distances[-1] < plan.distances[0],
    "02_depth_frames": lambda plan: plan.actions and plan.filled[0] > 0 and plan.view is not None,
    "03_fit_a_bank": lambda bank: bank.actions == ("poke",) and "4 pairs" in bank.fitted_to,
    "04_closed_loop": lambda run: run.steps and run.steps[0].obtained_mm < run.steps[0].before_mm,
    "05_own_arm": lambda arm: 0.44 < max(pose[2, 3] for pose in arm.poses) < 0.5,
    "06_own_camera": lambda depth: abs(np.median(depth) - 0.45) < 1e-3,
    "07_own_material": lambda depths: depths["flour"] > depths["dough"] > 1,
    "08_carry_material": lambda run: (
        [step.action for step in run.steps[:2]] == ["scoop", "pour"]
        and run.distances_mm[2] < run.distances_mm[0]
    ),
}


@pytest.mark.full
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, small, tmp_path, capsys):
    result = runpy.run_path(str(path))["main"](**RUNS[path.stem](small, tmp_path))
    assert SHOWS[path.stem](result)
    assert capsys.readouterr().out
    assert len(path.read_text().splitlines()) <= 60
