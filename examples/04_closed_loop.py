"""Look, plan, act, look again: a simulated hand molds a simulated bed.

Run it with `python examples/04_closed_loop.py`.
"""

import jax
import numpy as np

import jshape
from jshape import sim
from jshape.robot.loop import Molding, mold
from jshape.robot.simulated import SimulatedWorld


def main(bank: jshape.Bank | str = "pressed-flour-robot") -> Molding:
    """Copy what another hand did."""
    bank = jshape.load_bank(bank) if isinstance(bank, str) else bank
    for_goal, for_world = jax.random.split(jax.random.key(0))
    bed = sim.flat_bed()

    # The goal: a knock in the middle of the bed, seen by the bank's camera.
    pressed = sim.apply_action(for_goal, bed, sim.FLOUR, ("knock", "robot"), (0.0, 0.0))
    depth = sim.render(pressed, bank.camera)
    goal = np.asarray(jshape.weigh(bank.camera.luminance(depth, quantize=False), bank.camera))

    world = SimulatedWorld(for_world, bed, material="flour", camera=bank.camera)
    run = mold(world, goal, bank)

    for step in run.steps:
        print(
            f"{step.action} at {step.position}: predicted {step.predicted_mm:.3f} mm, "
            f"obtained {step.obtained_mm:.3f} mm"
        )
    print(f"stopped: {run.stop}")
    return run


if __name__ == "__main__":
    main()
