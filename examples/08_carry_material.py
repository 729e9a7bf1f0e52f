"""Build a mound out of the material beside it: carries in the closed loop, with a film.

Run it with `python examples/08_carry_material.py`; the film is written to `mound.gif`.
"""

from pathlib import Path

import jax
import numpy as np
from PIL import Image

import jshape
from jshape import sim
from jshape.robot.loop import Molding, mold
from jshape.robot.simulated import SimulatedWorld


def main(
    bank: jshape.Bank | str = "moving-flour-robot", film: str | Path = "mound.gif", steps: int = 16
) -> Molding:
    """A heap lies on one side of the bed and is wanted on the other."""
    bank = jshape.load_bank(bank) if isinstance(bank, str) else bank
    flat = sim.flat_bed()
    x, y = (np.asarray(axis) for axis in flat.axes())
    left, right = (
        0.015 * np.exp(-(((x[None] - at) / 0.05) ** 2) - (y[:, None] / 0.05) ** 2)
        for at in (-0.1, 0.1)
    )
    level = np.asarray(flat.height)
    now, wanted = (sim.loose_bed((level + heap).astype(np.float32)) for heap in (left, right))
    depth = sim.render(wanted, bank.camera)
    goal = np.asarray(jshape.weigh(bank.camera.luminance(depth, quantize=False), bank.camera))

    world = SimulatedWorld(jax.random.key(0), now, material="flour", camera=bank.camera)
    # Carries alone; sweeps would spread the heap, and presses pack it.
    others = {name: 0 for name in bank.actions if name not in ("scoop", "pour")}
    margin = None if bank.errors_mm is None else 0.0
    how = jshape.options(max_steps=steps, error_margin=margin, max_uses=others)
    run = mold(world, goal, bank, **how)
    for step in run.steps:
        print(
            f"{step.action} at {step.position}: predicted {step.predicted_mm:.3f} mm, "
            f"obtained {step.obtained_mm:.3f} mm"
        )
    print(f"stopped: {run.stop}")

    # 30 mm from black to white.
    heights = [np.clip((np.median(z) - z) / 0.03 + 0.4, 0, 1) for z in run.depths]
    frames = [Image.fromarray((255 * h).astype(np.uint8)) for h in heights]
    frames[0].save(film, save_all=True, append_images=frames[1:], duration=600, loop=0)
    return run


if __name__ == "__main__":
    main()
