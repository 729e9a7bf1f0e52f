"""Plan from two arrays: the bed now, and the bed wanted.

Run it with `python examples/01_plan.py`.
"""

import numpy as np

import jshape


def main(bank: jshape.Bank | str = "pressed-flour-robot") -> jshape.Plan:
    """Ask for a bowl in a level bed."""
    bank = jshape.load_bank(bank) if isinstance(bank, str) else bank
    print(bank)
    camera = bank.camera

    # Depth images in metres, arrays [v, u].  The camera looks straight down from 0.45 m.
    level = np.full(camera.shape, 0.45)
    v, u = np.indices(camera.shape)
    x, y = 0.45 * (u - camera.u0) / camera.fx, 0.45 * (v - camera.v0) / camera.fy  # metres
    bowl = level + 0.016 * np.exp(-(x**2 + y**2) / (2 * 0.04**2))

    # Planning compares weighed images I: luminance times the length of each pixel's ray.
    now, wanted = (
        jshape.weigh(camera.luminance(depth, quantize=False), camera) for depth in (level, bowl)
    )
    plan = jshape.plan(now, wanted, bank=bank)

    print(plan)
    for action, (u, v), mm in zip(plan.actions, plan.positions, plan.distances_mm[1:], strict=True):
        print(f"{action} at ({u}, {v}): {mm:.3f} mm left")
    return plan


if __name__ == "__main__":
    main().show()
