"""One accelerator beside the CPU: sweeps, plans, training and simulation.  Needs no data.

    python -m benchmarks.gpu [--quick]

Under 8 minutes.  Each column is of a process of its own, the CPU's in a child; what there is no
time for is "-".  Seconds are of a call after the one that compiles.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jshape
from jshape import sim
from jshape.camera import PAPER_BOX
from jshape.cli.tables import print_table
from jshape.data.pairs import Examples
from jshape.learn.settings import Training
from jshape.learn.training import roi_loss, train
from jshape.models import unet
from jshape.models.network import Network
from jshape.planning.api import problem_of
from jshape.planning.evaluate import sweep

SECONDS = 210.0
"""Each column begins nothing new after so long: two of them, and what each began last, take less
than 8 minutes."""
REPEATS = 3
"""Timed calls, of which the least counts; one where it takes over 5 s."""
HEAD = ("what", "size", "CPU, s", "accelerator, s", "ratio")


class Work(NamedTuple):
    """A row: what is measured."""

    what: str
    size: str
    call: Callable[[], Any]


def works(quick: bool) -> Iterator[Work]:
    """The rows, each made when it is its turn."""
    camera, rng = PAPER_BOX, np.random.default_rng(0)
    bed = np.full(camera.shape, 0.5, np.float32)
    v, u = np.mgrid[: camera.height, : camera.width]

    def dug() -> np.ndarray:
        """A goal: three round hollows."""
        goal = bed.copy()
        for _ in range(3):
            at = rng.uniform(0.2, 0.8, 2) * camera.shape
            apart = (v - at[0]) ** 2 + (u - at[1]) ** 2
            goal -= (rng.uniform(0.1, 0.3) * np.exp(-apart / rng.uniform(800, 5000))).astype("f4")
        return np.clip(goal, 0, 1)

    goals = [dug() for _ in range(4 if quick else 64)]
    searches = {"flour-robot": {"stride": 40 if quick else 4, "yaws": 1, "strengths": (1.0,)}}
    if not quick:
        searches["pressed-flour-robot"] = {"stride": 12}
    for name, how in searches.items():
        bank, options = jshape.load_bank(name), {"min_gain_mm": 0.0, **how}
        records = jshape.options(constraints=jshape.Constraints(), budget=jshape.SearchBudget())
        records |= jshape.options(**options)
        problem, _ = problem_of(bank, bed, goals[0], None, "greedy", **records)
        given = problem.state, problem.candidates
        yield Work("sweep", f"{bank.kind}, {len(given[1])} candidates", lambda g=given: sweep(*g))
        kind = f"{bank.kind}, every {how['stride']} px"
        how, some = records | {"bank": bank}, goals[:16]
        yield Work("a plan", kind, lambda h=how: jshape.plan(bed, goals[0], **h))
        yield Work(
            "plans at once", f"{kind}, {len(some)} goals",
            lambda h=how, g=some: jshape.plan_batch(bed, np.stack(g), **h),
        )  # fmt: skip
    yield Work(
        "plans at once", f"the paper's search, {len(goals)} goals",
        lambda: jshape.plan_batch(bed, np.stack(goals), **jshape.PAPER),
    )  # fmt: skip

    count, side, width = (4, 32, 2) if quick else (56, 183, 32)
    prior = rng.random((count, side, side), np.float32)
    examples = Examples(prior, 0.9 * prior, np.zeros((count, 2), np.int32))
    network = Network(unet.init(jax.random.key(0), width), (side, side))
    settings = Training(epochs=1, validation=0.0, width=width)
    yield Work(
        "training", f"U-Net, an epoch of {count} pairs {side}x{side}",
        lambda: train(roi_loss, network, examples, settings).params,
    )  # fmt: skip

    count = 2 if quick else 256

    def keys() -> jax.Array:
        return jax.random.split(jax.random.key(0), count)

    beds = jax.vmap(lambda key: sim.irregular_bed(key, 0.006))(keys())
    places = jnp.asarray(rng.uniform(-0.1, 0.1, (count, 2)), jnp.float32)
    hand = sim.stroke("knock")
    act = jax.jit(jax.vmap(lambda k, b, xy: sim.apply_action(k, b, sim.FLOUR, hand, xy)))
    render = jax.jit(jax.vmap(lambda b: sim.render(b, camera)))
    yield Work("simulation", f"an action, {count} beds", lambda: act(keys(), beds, places))
    yield Work("simulation", f"a look, {count} beds", lambda: render(beds))


def measured(quick: bool) -> dict[str, float]:
    """Seconds of what there is time for, by what and size."""
    began, found = time.monotonic(), {}
    for work in works(quick):
        name = f"{work.what}: {work.size}"
        if time.monotonic() - began > SECONDS:
            found[name] = float("nan")
            continue
        jax.block_until_ready(work.call())
        taken: list[float] = []
        while len(taken) < (1 if quick or sum(taken) > 5 else REPEATS):
            start = time.perf_counter()
            jax.block_until_ready(work.call())
            taken.append(time.perf_counter() - start)
        found[name] = min(taken)
        print(f"{jax.default_backend()}: {name}: {found[name]:.3g} s", file=sys.stderr, flush=True)
    return found


def rows(cpu: dict[str, float], other: dict[str, float] | None) -> list[tuple[str, ...]]:
    """The table's."""

    def told(value: float) -> str:
        return f"{value:.3g}" if value == value else "-"

    found = []
    for name, seconds in cpu.items():
        fast = float("nan") if other is None else other.get(name, float("nan"))
        found.append((*name.split(": "), told(seconds), told(fast), told(seconds / fast)))
    return found


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="One accelerator beside the CPU.")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: does it run?")
    parser.add_argument("--json", action="store_true", help="one column, of this process, as JSON")
    options = parser.parse_args(words)
    if options.json:
        print(json.dumps(measured(options.quick)))
        return
    backend, other = jax.default_backend(), None
    if backend == "cpu":
        cpu = measured(options.quick)
    else:
        other = measured(options.quick)
        command = [sys.executable, "-m", "benchmarks.gpu", "--json", *["--quick"] * options.quick]
        here = os.environ | {"JAX_PLATFORMS": "cpu"}
        cpu = json.loads(subprocess.check_output(command, env=here))
    print_table(HEAD, rows(cpu, other))
    print("no accelerator here: the CPU alone" if other is None else jax.devices()[0].device_kind)


if __name__ == "__main__":
    main()
