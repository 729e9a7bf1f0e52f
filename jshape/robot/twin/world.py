"""The twin's state: the physics, the bed that it stands for, and the clock of both."""

from typing import Any

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Float, Key
from jshape.camera import Camera
from jshape.robot.rigid import Pose
from jshape.robot.twin import fingers
from jshape.robot.twin.engine import mujoco
from jshape.robot.twin.ik import Reach
from jshape.robot.twin.model import Obstacle, base_camera, build, field_of

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
"""Of the arm, from the base."""
LAG = 0.02
"""Damping over stiffness of the arm's drives in `iiwa.xml`, seconds."""
FILTER = 0.015
"""Time constant of the low pass that efforts go through, seconds."""
REST = np.radians([0.0, 27.0, 0.0, -86.0, 0.0, 92.0, -90.0])
"""Joint angles that the arm likes: elbow up; the hand can turn by 90 to the left, 250 to the right,
degrees."""


class Twin:
    """A robot, a box and a bed.  `step` moves time; everything else looks or commands."""

    def __init__(
        self,
        key: Key[Array, ""],
        bed: sim.Bed,
        material: sim.Material,
        camera: Camera,
        obstacle: Obstacle | None,
        spread: float,
        stock_cm3: float,
    ):
        """A twin at home over a bed: see `make_twin`, which makes it."""
        self._engine = mujoco()
        self.model: Any = build(bed, camera, obstacle)
        self.data: Any = self._engine.MjData(self.model)
        self.base_camera, self.camera = base_camera(), camera
        self.material, self.spread = material, spread
        self.beside = 1e-6 * stock_cm3
        """Loose material in a stock beside the bed at first, m³."""
        self.reach = Reach(REST)
        camera_flange = np.linalg.inv(self.eye()) @ self.flange()
        self.home = self.reach.solve(self.base_camera @ camera_flange, REST)
        self._key = key
        model, drives = self.model, (JOINTS, fingers.JOINTS)
        # Places of joints in qpos; all are hinges, so those in qvel are the same.
        self._arm, self._hand = ([model.joint(n).qposadr[0] for n in names] for names in drives)
        self._drives = [[model.actuator(n).id for n in names] for names in drives]
        soft = ("bed", "obstacle") if obstacle else ("bed",)
        self._meant = [model.geom(name).id for name in soft]
        self.shown = 0
        """Counts the changes of the height field, so that pictures know when they are stale."""
        self.collisions: set[tuple[str, str]] = set()
        """Names of shapes that have met since the start; what is in the box does not count."""
        self.put(bed)
        self.target = self.home.copy()
        """Joint angles that the arm holds, radians."""
        self.grip = fingers.angles("fist")
        """Joint angles that the hand holds, radians."""
        self.data.qpos[self._arm], self.data.qpos[self._hand] = self.target, self.grip
        self._felt = np.zeros(7)
        self._engine.mj_forward(self.model, self.data)

    def next_key(self) -> Key[Array, ""]:
        """A fresh key."""
        self._key, key = jax.random.split(self._key)
        return key

    def put(self, bed: sim.Bed) -> None:
        """Take another bed of the same size, as it is at first."""
        self.bed = self.first = bed
        self.show(np.asarray(bed.height))

    def show(self, height: Float[np.ndarray, "Y X"]) -> None:
        """Let the physics have this surface, metres above the floor."""
        self.model.hfield_data[:] = field_of(sim.loose_bed(height, self.bed.cell))
        self.shown += 1

    def step(self, speed: Float[np.ndarray, "7"] | None = None) -> float:
        """Move time by one step of the physics towards `target` and `grip`; the contact effort, Nm.

        With the `speed` of `target`, radians per second, the arm does not lag behind it.
        """
        ahead = self.target if speed is None else self.target + LAG * speed
        self.data.ctrl[self._drives[0]] = ahead
        self.data.ctrl[self._drives[1]] = self.grip
        self._engine.mj_step(self.model, self.data)
        # What the drives give beyond gravity, centrifugal and Coriolis forces.
        data, arm = self.data, self._arm
        torque = data.qfrc_actuator[arm] + data.qfrc_gravcomp[arm] - data.qfrc_bias[arm]
        self._felt += (torque - self._felt) * (self.model.opt.timestep / FILTER)
        if data.ncon:
            self._note()
        return self.effort()

    def effort(self) -> float:
        """The greatest contact effort over the seven joints, Nm."""
        return float(np.abs(self._felt).max())

    def joints(self) -> Float[np.ndarray, "7"]:
        """Angles of the arm now, radians."""
        return self.data.qpos[self._arm].copy()

    def flange(self) -> Pose:
        """Pose of the flange in the base frame, from the physics."""
        # After a step MuJoCo's poses are those before it.
        self._engine.mj_kinematics(self.model, self.data)
        return _pose(self.data.site("flange"))

    def eye(self) -> Pose:
        """Pose of the depth camera in the base frame, from the physics."""
        self._engine.mj_kinematics(self.model, self.data)
        return _pose(self.data.body("camera"))

    def halt(self) -> None:
        """Hold everything where it is."""
        self.target = self.joints()
        self.grip = self.data.qpos[self._hand].copy()

    def _note(self) -> None:
        for pair in self.data.contact.geom[~np.isin(self.data.contact.geom, self._meant).any(1)]:
            one, other = (self.model.geom(shape).name for shape in pair)
            self.collisions.add((one, other))


def _pose(thing: Any) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.asarray(thing.xmat).reshape(3, 3)
    pose[:3, 3] = thing.xpos
    return pose
