"""Several devices, and several processes: the same trainings and plans as one device makes.

Processes talk through gloo on 127.0.0.1.  A sum over a batch that is made in another order differs
by float32's rounding: after 12 steps of 1e-3 the parameters, at most 1 in size, differed by 4e-8
and the losses by 1e-7 of their size.  1e-6 is allowed, since Adam divides slopes by their size:
where a slope is hardly more than rounding it makes a larger difference of it.
"""

import json
import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from tempfile import TemporaryFile

import jax.numpy as jnp
import numpy as np
import pytest

from jshape.cli.main import main
from jshape.data.pairs import Examples
from jshape.errors import BadFile
from jshape.io.checkpoints import check_folder, discard
from jshape.io.shared_checkpoints import SharedCheckpoints
from jshape.learn.settings import Training
from jshape.learn.training import Hooks, roi_loss, train
from jshape.models.difference import Difference

PROGRAM = """
import json, sys
from jshape.planning.devices import join, mesh_of, over_devices

devices, coordinator, process = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
if coordinator:
    assert join(coordinator, 2, process) == process
mesh = mesh_of(devices, "batch")
how = over_devices(devices)

import jax, jax.numpy as jnp, numpy as np
from jshape import PAPER_BOX, plan
from jshape.data.pairs import Examples
from jshape.learn import training
from jshape.learn.settings import Training
from jshape.learn.shared import shared_over
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
with shared_over(mesh):
    found = training.train(training.roi_loss, start, examples, settings)
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
made = plan(now, goal, bank=bank, positions="9x7", max_steps=4, how=how)
answer["plan"] = [made.actions, made.positions.tolist(), made.distances.tolist()]

if mesh and not coordinator:  # what devices tell each other in a step: sums, no images
    shared = training.Devices(mesh)
    step, _ = training._compiled(training.roi_loss, 1e-3, shared)
    moved = shared.everywhere((start, training._adam(1e-3).init(start)))
    batch = next(training._batches(examples, np.arange(4), 4, shared))
    text = step.lower(*moved, *batch).compile().as_text()
    answer["said"] = [name for name in ("all-reduce", "all-gather", "all-to-all",
                                        "collective-permute") if f" {name}" in text]
print(json.dumps(answer))
"""


def answers(*runs):
    """What processes print that run at once, given their (devices, coordinator, process)."""
    environment = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_PLATFORMS")}
    with ExitStack() as stack:
        # Files, not pipes: one that waits for its reader would keep the others waiting for it.
        files = [stack.enter_context(TemporaryFile("w+")) for _ in range(2 * len(runs))]
        processes = [
            subprocess.Popen(
                [sys.executable, "-c", PROGRAM, *map(str, run)],
                stdout=out, stderr=error, env=environment,
            )
            for run, out, error in zip(runs, files[::2], files[1::2], strict=True)
        ]  # fmt: skip
        try:
            codes = [process.wait(timeout=240) for process in processes]
        finally:
            for process in processes:
                process.kill()
                process.wait()
        for file in files:
            file.seek(0)
        assert codes == [0] * len(runs), [file.read() for file in files[1::2]]
        return [json.loads(file.read().splitlines()[-1]) for file in files[::2]]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def alone():
    return answers((1, "", 0))[0]


def same(shared, alone):
    assert alone["losses"][-1][0] < 0.99 * alone["losses"][0][0]  # it fell by 2 %
    np.testing.assert_allclose(shared["params"], alone["params"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(shared["losses"], alone["losses"], rtol=1e-6)
    assert shared["plan"][:2] == alone["plan"][:2] and len(alone["plan"][0]) == 2
    np.testing.assert_allclose(shared["plan"][2], alone["plan"][2], atol=1e-6)
    assert set(shared["left"]) == {1}  # what was trained is an ordinary pytree again


def test_host_devices_share_batches_and_places(alone):
    assert (alone["devices"], alone["local"]) == (1, 1)
    found = answers((3, "", 0))[0]  # which divides no batch: they are filled up
    assert (found["devices"], found["local"]) == (3, 3)
    assert found["said"] == ["all-reduce"]
    same(found, alone)


def test_two_processes_share_batches_and_places(alone):
    where = f"127.0.0.1:{free_port()}"
    first, second = answers((1, where, 0), (1, where, 1))
    assert (first["devices"], first["local"]) == (2, 1)
    same(first, alone)
    assert first == second  # to the last bit


def test_what_cannot_be_shared_is_refused(tmp_path, capsys):
    call = ["train", str(tmp_path), "--out", str(tmp_path / "bank"), "--kind"]
    for options, why in (
        (["CR", "--process", "1"], "--process goes with --coordinator HOST:PORT"),
        (["D", "--devices", "2"], "--devices: kind D trains no network and does not use it"),
        (["CR", "--coordinator", "127.0.0.1:1", "--processes", "2", "--process", "5"],
         "the processes cannot be joined: "),
    ):  # fmt: skip
        assert main([*call, *options]) == 2
        error = capsys.readouterr().err
        assert why in error and error.count("\n") == 1


def test_the_checkpoint_that_processes_share(tmp_path):
    """Killed after the second epoch that is kept, a training ends where it would have ended."""
    rng = np.random.default_rng(0)
    prior = rng.random((6, 3, 4)).astype(np.float32)
    examples = Examples(prior, prior - np.float32(0.2), np.zeros((6, 2), np.int32))
    settings = Training(epochs=6, batch=4, learning_rate=0.01, patience=0, save_every=2)
    start = Difference(jnp.zeros((3, 4)))
    whole = train(roi_loss, start, examples, settings)
    keep = SharedCheckpoints(tmp_path / "bank.training", "a b")
    assert keep.load() is None

    def dying(progress):
        if len(progress.curve) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(roi_loss, start, examples, settings, Hooks("a b", dying, keep))
    kept = keep.load()
    assert kept is not None and len(kept[0]["curve"]) == 4
    rest = train(roi_loss, start, examples, settings, Hooks("a b", keep=keep))
    np.testing.assert_array_equal(rest.params.delta, whole.params.delta)
    assert [row[:3] for row in rest.curve] == [row[:3] for row in whole.curve]
    assert check_folder(tmp_path / "bank.training")
    data = bytearray(keep.path.read_bytes())
    data[len(data) // 2] ^= 1
    keep.path.write_bytes(data)
    with pytest.raises(BadFile, match="shared.npz: not a readable NPZ"):
        keep.load()
    discard(tmp_path / "bank.training")
    assert not (tmp_path / "bank.training").exists()
