"""Your own camera: anything that yields depth frames.

Run it with `python examples/06_own_camera.py`.
"""

from collections.abc import Iterator

import numpy as np

from jshape.data.intrinsics import pinhole
from jshape.robot.cameras.base import CameraLost, look
from jshape.robot.cameras.played import Played


class Driver:
    """Stands for a vendor's SDK: counts of 0.1 mm, 0 where there is no reading."""

    def __init__(self, seed: int = 0):
        self.rng, self.open = np.random.default_rng(seed), True

    def read(self) -> np.ndarray | None:
        """A noisy frame of a level bed; None after a timeout."""
        counts = self.rng.normal(4500, 4.5, (120, 160)).round().astype(np.uint16)
        counts[self.rng.random(counts.shape) < 0.01] = 0
        return counts if self.open else None

    def stop(self) -> None:
        """Release the device."""
        self.open = False


def my_camera(driver: Driver) -> Played:
    """The driver as a camera that `look` and the loop can use."""

    def frames() -> Iterator[np.ndarray]:
        while True:
            counts = driver.read()
            if counts is None:
                raise CameraLost("my camera: sends nothing; is it unplugged?")
            yield counts

    camera = pinhole("my camera", (160, 120), (140.0, 140.0), (80.0, 60.0), [0.0] * 5)
    return Played("my camera", camera, 0.0001, frames(), live=True, close=driver.stop)


def main() -> np.ndarray:
    """One look: of each pixel the median over some frames, metres."""
    with my_camera(Driver()) as camera:
        depth = look(camera, frames=15)
    seen = depth[depth > 0]
    print(
        f"{seen.size} of {depth.size} pixels, {seen.mean():.4f} m, noise {1e3 * seen.std():.2f} mm"
    )
    return depth


if __name__ == "__main__":
    main()
