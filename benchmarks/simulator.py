"""The material simulator: actions and frames per second."""

from pathlib import Path

import jax
import jax.numpy as jnp

from benchmarks.report import Report
from benchmarks.timing import seconds
from jshape import PAPER_BOX, sim


def run(report: Report, out: Path) -> None:
    key = jax.random.key(0)
    bed = sim.irregular_bed(key, 0.008)
    xy = jnp.zeros(2)
    for action in ("poke", "grasp"):
        time = seconds(
            lambda a=action: sim.apply_action(key, bed, sim.FLOUR, (a, "robot"), xy).height
        )
        report.add(f"simulate one {action}", 1e3 * time, "ms")
    report.add("render 480x395", 1e3 * seconds(lambda: sim.render(bed, PAPER_BOX)), "ms")
    stroke = sim.stroke("knock", "robot")
    keys = jax.random.split(key, 16)
    beds = jax.vmap(lambda k: sim.irregular_bed(k, 0.008))(keys)
    act = jax.jit(jax.vmap(lambda k, b: sim.apply_action(k, b, sim.FLOUR, stroke, xy)))
    time = seconds(lambda: act(keys, beds).height, repeats=3)
    report.add("beds per second, 16 at a time", 16 / time, "1/s")
