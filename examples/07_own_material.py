"""Your own material: ten numbers that the simulator takes as an object.

Run it with `python examples/07_own_material.py`.
"""

import math
from dataclasses import replace

import jax
import numpy as np

import jshape
from jshape import sim


def main(camera: jshape.Camera = jshape.PAPER_BOX) -> dict[str, float]:
    """The same knock in three materials: how deep, how high a rim."""
    clay = replace(sim.DOUGH, name="clay", repose=math.radians(45), elastic=0.05, packing_max=1.05)
    depths = {}
    for material in (sim.FLOUR, sim.DOUGH, clay):
        bed = sim.flat_bed()
        after = sim.apply_action(jax.random.key(0), bed, material, ("knock", "robot"), (0.0, 0.0))
        change = 1e3 * np.asarray(after.height - bed.height)
        depths[material.name] = float(-change.min())
        print(f"{material.name}: {-change.min():.1f} mm deep, rim {change.max():.1f} mm high")
        image = sim.render(after, camera)  # (H, W) metres, as a camera above it would see it
    print(
        f"image of the last: {image.shape}, {float(image.min()):.3f} to {float(image.max()):.3f} m"
    )
    return depths


if __name__ == "__main__":
    main()
