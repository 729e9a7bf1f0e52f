"""The material simulator: what each stage takes, beds per second, compiling and memory."""

import time
from pathlib import Path

import jax
import jax.numpy as jnp

from benchmarks.report import Report
from benchmarks.timing import in_turns
from jshape import PAPER_BOX, sim

BATCHES = (1, 4, 16, 64)
HILLS = 0.008
"""Standard deviation of the beds' heights, metres."""


def run(report: Report, out: Path) -> None:
    """The stages of one pair of frames, then one knock on each of many beds in one call."""
    key, middle = jax.random.key(0), jnp.zeros(2)
    bed = sim.irregular_bed(key, HILLS)
    depth = sim.render(bed, PAPER_BOX)

    def acted(action: str) -> jax.Array:
        return sim.apply_action(key, bed, sim.FLOUR, (action, "robot"), middle).height

    stages = {
        "make a bed with hills": lambda: sim.irregular_bed(key, HILLS).height,
        "simulate one poke": lambda: acted("poke"),
        "simulate one grasp": lambda: acted("grasp"),
        "render 480x395": lambda: sim.render(bed, PAPER_BOX),
        "camera noise, 480x395": lambda: sim.sensor(key, depth),
    }
    for name, each in in_turns(stages).items():
        report.add(name, 1e3 * each, "ms")
    size = sum(leaf.nbytes for leaf in (bed.height, bed.mass))
    report.add("memory of a bed", size / 1e3, "kB", tolerance=1)

    stroke = sim.stroke("knock", "robot")

    def knocked(key: jax.Array, height: jax.Array) -> jax.Array:
        bed = sim.loose_bed(height)
        return sim.apply_action(key, bed, sim.FLOUR, stroke, middle).height

    calls, working = {}, {}
    for count in BATCHES:
        keys = jax.random.split(key, count)
        heights = jax.vmap(lambda k: sim.irregular_bed(k, HILLS).height)(keys)
        start = time.perf_counter()
        act = jax.jit(jax.vmap(knocked)).lower(keys, heights).compile()
        if count == 1:
            report.add("compile an action", time.perf_counter() - start, "s")
        working[count] = act.memory_analysis().temp_size_in_bytes / count
        calls[str(count)] = lambda act=act, keys=keys, heights=heights: act(keys, heights)
    for count, each in in_turns(calls, least=1.5, rounds=3).items():
        report.add(f"beds per second, {count} at a time", int(count) / each, "1/s")
    most = BATCHES[-1]
    report.add(f"working memory per bed, {most} at a time", working[most] / 1e6, "MB",
               tolerance=1.2)  # fmt: skip
    print("the material-point method: not measured, no solver of it is here to run")
