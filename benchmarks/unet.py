"""The paper's U-Net beside PyTorch and ONNX Runtime: same weights, same machine, same run."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from benchmarks import unet_peers
from benchmarks.report import Report, cores
from jshape.actions import PAPER_ROIS
from jshape.data.pairs import Examples
from jshape.data.simulate import ROIS
from jshape.learn import training
from jshape.learn.settings import Training
from jshape.models import unet
from jshape.models.network import Network
from jshape.viz.style import png

Shape = tuple[int, int, int]
"""(B, h, w) of images."""
WIDTH = 32
GOAL = 1.2
"""Most of PyTorch's time that a forward pass takes."""
AGREE = 1e-4
"""Most that the images of two networks differ."""
AGREE_SLOPES = 2e-3
"""The same of gradients, as a share of each array's largest number.  They jump where the loss,
ReLU or pooling has a tie: jshape's own in float32 and float64 are 4.7e-4 apart for 183x183."""
TRAINED: tuple[Shape, ...] = tuple((b, h, w) for w, h in PAPER_ROIS.values() for b in (1, 8))
FORWARD: tuple[Shape, ...] = (*TRAINED, *((b, *ROIS["knock"][::-1]) for b in (1, 8)))
"""The paper's grasp, knock and poke, and the knock that the simulator's material needs."""
PAIRS = 56
"""Pairs of an epoch: 75 % of 75."""
PRODUCT = 3072
"""Sides of the matrices whose product is the machine's peak."""
PEERS = {"PyTorch": ("torch",), "ONNX Runtime": ("onnx", "onnxruntime")}
"""What each needs installed."""


@dataclass(frozen=True)
class Measured:
    """One size."""

    shape: Shape
    seconds: dict[str, float]
    """Of each library."""
    flops: float
    """Multiplications and additions of jshape's program."""
    drawn: float
    """Those of the network as it is drawn, which the peers make."""
    compiling: float
    """Seconds that jshape's first call takes more than the next."""
    gap: float
    """Largest difference from a peer, see `AGREE`; 0 without peers."""

    @property
    def name(self) -> str:
        """Batch, height and width."""
        return "{}x {}x{}".format(*self.shape)


def run(report: Report, out: Path) -> None:
    """Forward passes and training steps, what they count and differ by, and a figure."""
    peers = [name for name, needs in PEERS.items() if all(map(find_spec, needs))]
    for name in (name for name in PEERS if name not in peers):
        print(f"{name}: left out, {' and '.join(PEERS[name])} must be installed")
    params = unet.init(jax.random.key(0), WIDTH)
    report.add("parameters", sum(x.size for x in jax.tree.leaves(params)), "", tolerance=1)
    peak = _peak(peers)
    report.add(f"peak: a matrix product, {PRODUCT}x{PRODUCT}", peak / 1e9, "GFLOP/s")

    forward, step = [], []
    for shape in FORWARD:
        forward.append(_forward(params, shape, peers))
        _rows(report, "forward", forward[-1], GOAL)
    _table(report, "forward", forward, peak)
    for shape in TRAINED:
        step.append(_training(params, shape, peers))
        _rows(report, "training step", step[-1])
    _table(report, "training step", step, peak)
    for action, (w, h) in PAPER_ROIS.items():
        (each,) = (m.seconds["jshape"] for m in step if m.shape == (8, h, w))
        report.add(f"training, {action} {w}x{h}: epoch of {PAIRS} pairs", each * PAIRS / 8, "s")
    (out / "unet.png").write_bytes(
        png(partial(_figure, {"forward pass": forward, "training step": step}), dpi=110)
    )


def drawn_flops(shape: Shape, width: int = WIDTH, *, train: bool = False) -> float:
    """Multiplications and additions of the convolutions of the network as the paper draws it.

    A training step makes each product three times (the output, the gradients of the kernel and of
    the input), but the image itself needs no gradient.
    """
    b, h, w = shape
    unit = 2**unet.LEVELS
    pixels = b * -(-h // unit) * -(-w // unit) * unit**2
    sizes = [width * 2**level for level in range(unet.LEVELS + 1)]
    products = []
    for level, (before, size) in enumerate(zip([1, *sizes], sizes, strict=False)):
        products += [9 * pixels / 4**level * features * size for features in (before, size)]
    for level, size in enumerate(sizes[:-1]):
        products += [9 * pixels / 4**level * features * size for features in (3 * size, size)]
    products.append(pixels * width)
    return 2 * (3 * sum(products) - products[0] if train else sum(products))


def _peak(peers: Sequence[str]) -> float:
    """Floating-point operations per second of a large matrix product, of the best library."""
    a = np.random.default_rng(0).random((PRODUCT, PRODUCT), np.float32)
    on_device = jnp.asarray(a)
    calls: dict[str, Callable] = {"NumPy": lambda: a @ a, "JAX": lambda: on_device @ on_device}
    if "PyTorch" in peers:
        tensor = _torch().from_numpy(a)
        calls["PyTorch"] = lambda: tensor @ tensor
    return 2 * PRODUCT**3 / min(_in_turns(calls).values())


def _forward(params: dict[str, Any], shape: Shape, peers: Sequence[str]) -> Measured:
    """Forward passes, which must agree."""
    image = np.random.default_rng(0).random(shape, np.float32)
    mine, forward = jnp.asarray(image), jax.jit(unet.apply)
    flops = forward.lower(params, mine).cost_analysis()["flops"]
    calls: dict[str, Callable] = {"jshape": lambda: forward(params, mine)}
    if "PyTorch" in peers:
        torch = _torch()
        network, _ = unet_peers.torch_network(params, torch)
        tensor = torch.from_numpy(image)
        calls["PyTorch"] = torch.inference_mode()(lambda: network(tensor))
    if "ONNX Runtime" in peers:
        session = unet_peers.onnx_network(params, shape, cores())
        calls["ONNX Runtime"] = lambda: session(image)

    first = _time(calls["jshape"])
    after = np.asarray(calls["jshape"]())
    gaps = [float(np.abs(np.asarray(calls[peer]()) - after).max()) for peer in peers]
    times = _in_turns(calls)
    return _agreeing(shape, times, flops, drawn_flops(shape), first, gaps, AGREE)


def _training(params: dict[str, Any], shape: Shape, peers: Sequence[str]) -> Measured:
    """Steps of Adam on one batch, the paper's loss over the ROI; the first gradients must agree."""
    b, h, w = shape
    prior = np.random.default_rng(0).random(shape, np.float32)
    goal = 0.9 * prior
    batch = Examples(*map(jnp.asarray, (prior, goal, np.zeros((b, 2), int))))
    settings, counted = Training(), jnp.ones(b, bool)
    step, _ = training._compiled(training.roi_loss, settings.learning_rate)
    network = Network(jax.tree.map(jnp.copy, params), (w, h))  # a step consumes what it is given
    state = [network, training._adam(settings.learning_rate).init(network)]
    # Of one image: a loop over blocks of images would count as one of them.  Without Adam's part.
    slopes = jax.jit(jax.grad(lambda network, one: training.roi_loss(network, one).sum()))
    one = batch.select(np.arange(1))
    flops = b * slopes.lower(network, one).cost_analysis()["flops"]

    def ours() -> Any:
        *state[:], total = step(*state, batch, counted)
        return total

    calls: dict[str, Callable] = {"jshape": ours}
    first, gaps = _time(ours), []
    if "PyTorch" in peers:
        torch = _torch()
        theirs, leaves = unet_peers.torch_network(params, torch)
        adam = torch.optim.Adam(leaves, settings.learning_rate, (0.5, 0.999), 1e-8, fused=True)
        before, after = torch.from_numpy(prior), torch.from_numpy(goal)

        def peer() -> None:
            adam.zero_grad()
            (theirs(before) - after).abs().mean().backward()
            adam.step()

        calls["PyTorch"] = peer
        peer()
        # After one step Adam's first moments are half the gradients, here as there.
        moments = [adam.state[leaf]["exp_avg"].numpy() for leaf in leaves]
        gaps.append(_gradient_gap(jax.tree.leaves(state[1][0].mu), moments))
    times = _in_turns(calls, blocks=2)
    drawn = drawn_flops(shape, train=True)
    return _agreeing(shape, times, flops, drawn, first, gaps, AGREE_SLOPES)


def _gradient_gap(ours: Sequence[Any], theirs: Sequence[np.ndarray]) -> float:
    """The largest difference of any array, as a share of that array's largest number."""
    gaps = []
    for mine, other in zip(ours, theirs, strict=True):
        mine = unet_peers.channels_first(mine) if mine.ndim == 4 else np.asarray(mine)
        gaps.append(np.abs(mine - other).max() / np.abs(other).max())
    return float(max(gaps))


def _agreeing(
    shape: Shape,
    seconds: dict[str, float],
    flops: float,
    drawn: float,
    first: float,
    gaps: Sequence[float],
    most: float,
) -> Measured:
    gap = float(np.max(gaps, initial=0.0))  # NaN if any is
    if not gap < most:
        raise AssertionError(f"networks for {shape} differ by {gap:.2g}, more than {most:g}")
    return Measured(shape, seconds, flops, drawn, first - seconds["jshape"], gap)


def _time(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def _in_turns(
    calls: dict[str, Callable[[], Any]], blocks: int = 3, least: float = 0.25
) -> dict[str, float]:
    """Least seconds of each call, in blocks of at least `least` seconds that take turns.

    Not `timing.in_turns`.  PyTorch's threads need several calls to get going after another
    library's have spun (call by call it took 20 times as long), so each block begins when those
    sleep.  And the least, not the median, since other work on the machine disturbs PyTorch's
    barriers more than Eigen's queue.
    """
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(blocks):
        for name, call in calls.items():
            time.sleep(0.15)
            end = time.perf_counter() + least
            while True:
                best[name] = min(best[name], _time(call))
                if time.perf_counter() > end:
                    break
    return best


def _torch() -> Any:
    import torch

    torch.set_num_threads(cores())
    return torch


def _rows(report: Report, what: str, m: Measured, goal: float | None = None) -> None:
    """Ratios, and once per size what is counted."""
    for peer in list(m.seconds)[1:]:
        ratio = m.seconds["jshape"] / m.seconds[peer]
        aim = goal if peer == "PyTorch" else None
        report.add(f"{what} {m.name}: jshape / {peer}", ratio, "times", goal=aim)
    if m.shape[0] == 1:
        report.add(f"{what} {m.name}: counted", m.flops / 1e9, "GFLOP", tolerance=1.01)


def _table(report: Report, what: str, all_: Sequence[Measured], peak: float) -> None:
    """Times and shares of the peak, and the largest difference as a row."""
    if len(all_[0].seconds) > 1:
        gap = max(m.gap for m in all_)
        most = AGREE if what == "forward" else AGREE_SLOPES
        report.add(f"{what}: largest difference", gap, "", goal=most, tolerance=10)
    head = [what, *(f"{name}, ms (share of the peak)" for name in all_[0].seconds)]
    head += ["GFLOP jshape / as drawn", "first call, s"]
    rows = []
    for m in all_:
        made = dict.fromkeys(m.seconds, m.drawn) | {"jshape": m.flops}
        cells = (f"{_ms(s)} ({made[n] / s / peak:.0%})" for n, s in m.seconds.items())
        counts = f"{m.flops / 1e9:.3g} / {m.drawn / 1e9:.3g}"
        rows.append((m.name, *cells, counts, f"{m.compiling:.1f}"))
    report.table(f"U-Net of width {WIDTH}, {what}", head, rows)


def _ms(seconds: float) -> str:
    """Three digits, and never in powers of ten."""
    return f"{1e3 * seconds:.3g}" if seconds < 0.9995 else f"{1e3 * seconds:.0f}"


def _figure(panels: dict[str, Sequence[Measured]]) -> Figure:
    """Bars of each library's time as a share of jshape's, with milliseconds."""
    figure = Figure(figsize=(12, 6.6), layout="constrained")
    for ax, (title, all_) in zip(figure.subplots(len(panels), 1), panels.items(), strict=True):
        names = list(all_[0].seconds)
        for k, name in enumerate(names):
            at = np.arange(len(all_)) + (k - (len(names) - 1) / 2) * 0.28
            heights = [m.seconds[name] / m.seconds["jshape"] for m in all_]
            bars = ax.bar(at, heights, 0.26, label=name)
            labels = [_ms(m.seconds[name]) for m in all_]
            ax.bar_label(bars, labels, fontsize=8, padding=1)
        ax.set_xticks(range(len(all_)), [m.name for m in all_])
        ax.set_title(f"{title}: milliseconds above the bars", fontsize=10)
        ax.set_ylabel("time / jshape's")
        ax.margins(y=0.25)  # room for the legend
        ax.grid(axis="y", alpha=0.3)
        ax.set_axisbelow(True)
        ax.legend(ncols=len(names), fontsize=8)
    return figure


if __name__ == "__main__":
    run(Report(), Path("."))
