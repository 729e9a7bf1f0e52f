"""The paper's U-Net against the same network in PyTorch: same weights, same machine, same run."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from benchmarks.report import Report, cores
from jshape.data.pairs import Examples
from jshape.learn.training import roi_loss
from jshape.nn import unet
from jshape.predict.network import Network

GOAL = 1.2
SIZES = ((1, 104, 112), (1, 183, 183), (8, 104, 112))
"""Batch, height and width of the images: the simulator's knock, the paper's grasp, a batch."""
ROIS = {"grasp": (183, 183), "knock": (112, 60), "poke": (40, 45)}
"""ROI sizes (w, h) of the paper's section V."""
PAIRS, BATCH = 56, 8


def run(report: Report, out: Path, rounds: int = 15) -> None:
    """Forward passes beside PyTorch's, and what an epoch of the paper takes."""
    params = unet.init(jax.random.key(0), 32)
    try:
        import torch
    except ImportError:
        print("U-Net against PyTorch: not measured, torch is not installed")
    else:
        torch.set_num_threads(cores())
        with torch.inference_mode():
            _forward(report, params, torch, rounds)
    for name, roi in ROIS.items():
        _epoch(report, name, Network(params, roi))


def _forward(report: Report, params: dict[str, Any], torch: Any, rounds: int) -> None:
    forward = jax.jit(unet.apply)
    for shape in SIZES:
        image = np.random.default_rng(0).random(shape, np.float32)
        h, w = shape[1:]
        padded = np.pad(image, ((0, 0), (0, -h % 16), (0, -w % 16)), mode="edge")
        theirs = torch.from_numpy(padded)[:, None].contiguous(memory_format=torch.channels_last)
        peer = _peer(params, torch)
        ours = jnp.asarray(image)
        gap = np.abs(np.asarray(forward(params, ours)) - peer(theirs)[:, 0, :h, :w].numpy()).max()
        if not gap < 1e-4:
            raise AssertionError(f"the two networks differ by {gap}")
        mine, other = _in_turns(
            lambda image=ours: forward(params, image), lambda peer=peer, x=theirs: peer(x), rounds
        )
        name = "U-Net, width 32, {}x {}x{}".format(*shape)
        report.add(f"{name}: PyTorch", 1e3 * other, "ms")
        report.add(f"{name}: jshape", 1e3 * mine, "ms")
        report.add(f"{name}: ratio", mine / other, "times", goal=GOAL)


def _in_turns(ours: Callable, theirs: Callable, rounds: int) -> tuple[float, float]:
    """Least seconds of each call, in blocks that take turns.

    Blocks, since PyTorch's threads need several calls to get going after another library's have
    spun (call by call it took 20 times as long); the least, since other work on the machine
    disturbs PyTorch's barriers more than Eigen's queue.
    """
    best = [float("inf"), float("inf")]
    for _ in range(3):
        for which, call in enumerate((ours, theirs)):
            time.sleep(0.3)
            for _ in range(rounds):
                start = time.perf_counter()
                jax.block_until_ready(call())
                best[which] = min(best[which], time.perf_counter() - start)
    return best[0], best[1]


def _peer(params: dict[str, Any], torch: Any) -> Callable:
    """The same network in PyTorch, channels last, which is its faster layout here."""
    nn = torch.nn.functional

    def weights(layer: dict[str, Any]) -> tuple:
        kernel = torch.from_numpy(np.array(layer["kernel"]).transpose(3, 2, 0, 1).copy())
        kernel = kernel.contiguous(memory_format=torch.channels_last)
        return kernel, torch.from_numpy(np.array(layer["bias"]))

    tree = jax.tree.map(weights, params, is_leaf=lambda x: isinstance(x, dict) and "kernel" in x)

    def block(layers: dict, x: Any) -> Any:
        for layer in ("first", "second"):
            x = torch.relu_(nn.conv2d(x, *layers[layer], padding=1))
        return x

    def apply(x: Any) -> Any:
        skips = []
        for level in range(4):
            x = block(tree["down"][level], x)
            skips.append(x)
            x = nn.max_pool2d(x, 2)
        x = block(tree["bottom"], x)
        for level in range(4):
            x = nn.interpolate(x, scale_factor=2, mode="nearest")
            x = block(tree["up"][level], torch.cat([skips.pop(), x], 1))
        return torch.tanh(nn.conv2d(x, *tree["output"]))

    return apply


def _epoch(report: Report, name: str, network: Network, steps: int = 3) -> None:
    """Seconds of an epoch, from a few steps: 56 pairs, as 75 % of 75 are, in batches of 8."""
    w, h = network.roi
    image = jnp.full((BATCH, h, w), 0.5)
    batch = Examples(image, image + 0.01, jnp.zeros((BATCH, 2), int))  # pyright: ignore
    adam = optax.adam(2e-4, b1=0.5)

    @jax.jit
    def step(network: Network, state: Any) -> tuple[Network, Any]:
        slope = jax.grad(lambda n: roi_loss(n, batch).mean())(network)
        updates, state = adam.update(slope, state)
        return optax.apply_updates(network, updates), state

    state = step(network, adam.init(network))
    times = []
    for _ in range(steps):
        start = time.perf_counter()
        state = jax.block_until_ready(step(*state))
        times.append(time.perf_counter() - start)
    each = float(np.median(times))
    report.add(f"U-Net training, {name} {w}x{h}: epoch of {PAIRS} pairs", each * PAIRS / BATCH, "s")


if __name__ == "__main__":
    run(Report(), Path("."))
