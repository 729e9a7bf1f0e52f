"""Your own arm: one class.  This one only remembers where it was sent.

Run it with `python examples/05_own_arm.py`.
"""

import jax
import numpy as np

from jshape.robot.arms.base import Moved
from jshape.robot.cameras.simulated import levelled_world, simulated_camera
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot


class MyArm:
    """Replace each body with a call of your driver; `jshape.robot.arms.base.Arm` documents them."""

    name = "my arm"

    def __init__(self):
        self.poses = [np.eye(4)]

    def limit(self, *, effort, speed): ...  # what no motion may exceed
    def check(self, poses, postures, tool): ...  # raise PoseRefused where it cannot go
    def begin(self, doing, tool): ...  # told before each operation
    def stop(self): ...  # at once, from another thread
    def close(self): ...

    def move(self, pose, *, speed, threshold):  # raise ArmError where it did not
        self.poses.append(np.array(pose))  # of the tool in the base frame, metres
        # The effort is the greatest |joint torque - what gravity needs| on the way, Nm.
        return Moved(contact=False, effort=0.0, pose=self.pose())

    def posture(self, name, *, seconds, threshold):
        return Moved(contact=False, effort=0.0, pose=self.pose())

    def home(self):
        return self.move(np.eye(4), speed=0.1, threshold=50.0)

    def pose(self):
        return self.poses[-1].copy()


def main() -> MyArm:
    """Poke a place that a simulated camera sees."""
    world, arm = levelled_world(), MyArm()
    eye = simulated_camera(world, jax.random.key(0))
    with Robot(eye, arm, load_hand(), world.camera) as robot:
        robot.look()
        robot.act("poke", (240, 197))
    deepest = max(pose[2, 3] for pose in arm.poses)
    print(f"{len(arm.poses)} poses, the deepest {1000 * deepest:.0f} mm below the camera")
    return arm


if __name__ == "__main__":
    main()
