"""Several devices: the same trainings and plans as one device makes.

A sum over a batch that is made in another order differs
by float32's rounding: after 12 steps of 1e-3 the parameters, at most 1 in size, differed by 4e-8
and the losses by 1e-7 of their size.  1e-6 is allowed, since Adam divides slopes by their size:
where a slope is hardly more than rounding it makes a larger difference of it.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from jshape.cli.main import main

PROGRAM = """
import json, sys
from jshape.planning.devices import mesh_of, over_devices

devices = int(sys.argv[1])
mesh = mesh_of(devices, "batch")
how = over_devices(devices)

import jax, jax.numpy as jnp, numpy as np
from jshape import PAPER, PAPER_BOX, options, plan
from jshape.data.pairs import Examples
from jshape.learn import training
from jshape.learn.data_parallel import DataParallel
from jshape.learn.settings import Training
from jshape.models import unet
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.models.network import Network

rng = np.random.default_rng(3)
v, u = np.mgrid[:18, :20]
pit = -0.3 * np.exp(-(((u - 9) / 4) ** 2) - ((v - 8) / 4) ** 2)
prior = (0.5 + 0.1 * rng.random((11, 18, 20))).astype("f4")
deep = rng.uniform(0.7, 1.3, (11, 1, 1))
examples = Examples(prior, (prior + deep * pit).astype("f4"), np.zeros((11, 2), "i4"))
start = Network(unet.init(jax.random.key(0), 2), (20, 18))
settings = Training(epochs=4, batch=4, learning_rate=1e-3, patience=0, width=2)
hooks = training.Hooks(mesh=mesh)
found = training.train(training.roi_loss, start, examples, settings, hooks)
leaves = jax.tree.leaves(found.params)
answer = {
    "devices": mesh.size if mesh else 1,
    "local": jax.local_device_count(),
    "losses": [row[1:3] for row in found.curve],
    "params": np.concatenate([np.asarray(leaf).ravel() for leaf in leaves]).tolist(),
    "left": [len(leaf.devices()) for leaf in leaves],
}

def crater(w, h, depth):
    x, y = (np.linspace(-2, 2, n) for n in (w, h))
    return Difference(jnp.asarray(-depth * np.exp(-(x**2) - y[:, None] ** 2), "f4"))

bank = Bank(PAPER_BOX, (crater(100, 80, 0.2), crater(40, 45, 0.3)), ("knock", "poke"))
now = np.full(PAPER_BOX.shape, 0.5, "f4")
goal = now.copy()
goal[100:180, 100:200] -= 0.1
made = plan(now, goal, execution=how, **options(PAPER, bank=bank, positions="9x7", max_steps=4))
answer["plan"] = [made.actions, made.positions.tolist(), made.distances.tolist()]

if mesh:  # what devices tell each other in a step: sums, no images
    shared = DataParallel(mesh)
    step, _ = training._compiled(training.roi_loss, 1e-3, shared)
    moved = shared.replicate((start, training._adam(1e-3).init(start)))
    batch = next(training._batches(examples, np.arange(4), 4, shared))
    text = step.lower(*moved, *batch).compile().as_text()
    answer["said"] = [name for name in ("all-reduce", "all-gather", "all-to-all",
                                        "collective-permute") if f" {name}" in text]
print(json.dumps(answer))
"""


def answer(devices):
    """What the program prints in a process with so many devices."""
    environment = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_PLATFORMS")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(devices)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.full
def test_host_devices_share_batches_and_candidates():
    alone, found = answer(1), answer(3)  # 3 divides no batch: they are filled up
    assert (alone["devices"], alone["local"]) == (1, 1)
    assert (found["devices"], found["local"]) == (3, 3)
    assert found["said"] == ["all-reduce"]
    assert alone["losses"][-1][0] < 0.99 * alone["losses"][0][0]  # it fell by 2 %
    np.testing.assert_allclose(found["params"], alone["params"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["losses"], alone["losses"], rtol=1e-6)
    assert found["plan"][:2] == alone["plan"][:2] and len(alone["plan"][0]) == 2
    np.testing.assert_allclose(found["plan"][2], alone["plan"][2], atol=1e-6)
    assert set(found["left"]) == {1}  # what was trained is an ordinary pytree again


def test_what_trains_no_network_shares_nothing(tmp_path, capsys):
    call = ["train", str(tmp_path), "--out", str(tmp_path / "bank"), "--kind", "D"]
    assert main([*call, "--devices", "2"]) == 2
    assert "--devices: kind D trains no network" in capsys.readouterr().err
