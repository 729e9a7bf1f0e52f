"""Plan from raw depth frames of your camera: 16-bit counts, with pixels without a reading.

Run it with `python examples/02_depth_frames.py`.
"""

import numpy as np

import jshape


def main(
    bank: jshape.Bank | str = "pressed-flour-robot", camera: jshape.Camera = jshape.D435_BAZAR
) -> jshape.Plan:
    """Whole frames of a D435, 0.45 m above the bed; the bank was trained on a window of them.

    Of another camera write `camera=jshape.Camera(width, height, fx, fy, u0, v0, z_min, z_max)`;
    docs/cameras.md says how its frames become those of the bank's camera.
    """
    # Your frames would come from a file or a driver; here: a level bed, and a bowl in it.
    v, u = np.indices(camera.shape)
    x, y = 0.45 * (u - camera.u0) / camera.fx, 0.45 * (v - camera.v0) / camera.fy
    metres = np.full(camera.shape, 0.45), 0.45 + 0.016 * np.exp(-(x**2 + y**2) / (2 * 0.04**2))
    now, wanted = (np.rint(depth / 0.0001).astype(np.uint16) for depth in metres)
    now[np.random.default_rng(0).random(now.shape) < 0.01] = 0  # no reading

    plan = jshape.plan_depth(now, wanted, camera=camera, depth_unit=0.0001, bank=bank)

    print(plan)
    for action, (u, v) in zip(plan.actions, plan.camera_positions, strict=True):
        print(f"{action} at pixel ({u}, {v}) of your camera")
    return plan


if __name__ == "__main__":
    main()
