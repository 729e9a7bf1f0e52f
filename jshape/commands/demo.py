"""`jshape demo`."""

import argparse
from typing import Any


def demo(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape demo`: the main job in simulation, closed loop."""
    from jshape.experiments.demo import run_demo

    return run_demo(
        options.out,
        bank_name=options.bank,
        seed=options.seed,
        actions=options.actions,
        max_steps=options.max_steps,
        material=options.material,
        agent=options.agent,
        replan=not options.open_loop,
        overwrite=options.overwrite,
        say=(lambda line: None) if options.json else lambda line: print(line, flush=True),
    )
