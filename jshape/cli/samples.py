"""`jshape samples OUT`: the files that the documentation's commands name, from the simulator."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from jshape.camera import PAPER_BOX
from jshape.cli.options import Writes
from jshape.data.simulate import DEPTH_UNIT, look
from jshape.io import cameras, files, folders, images
from jshape.robot.simulated import SimulatedWorld, bed_of

CONTENTS = ("camera.json", "now.png", "wanted.png", "poses.json")
SEED = 3
"""Of the bed: the one below `--arm sim:3`, so that `mold wanted.png --arm sim:3` begins on it."""
APPLIED = (
    ("grasp", (330, 120)),
    ("knock", (130, 110)),
    ("knock", (150, 290)),
    ("poke", (320, 300)),
)
"""What makes the wanted bed of it, and where: (u, v) pixels."""
POSES = 14
NOISE_MM, NOISE_DEG = 0.4, 0.1
"""Of what the camera sees of a target, per axis."""


def samples(out: Path, /, options: Writes = Writes()) -> dict[str, Any]:
    """Write them; returns where.

    Args:
      out: Folder to make.
    """
    with folders.atomic_folder(out, options.overwrite, contents=CONTENTS) as folder:
        cameras.write_camera(folder / "camera.json", PAPER_BOX, DEPTH_UNIT)
        for name, depth in zip(("now", "wanted"), _beds(), strict=True):
            images.write_depth_png(folder / f"{name}.png", depth, DEPTH_UNIT)
        files.write_atomic(folder / "poses.json", _poses(np.random.default_rng(SEED)))
    print(f"{', '.join(CONTENTS)}: {out}")
    return {"out": str(out), "files": list(CONTENTS)}


def _beds() -> tuple[np.ndarray, np.ndarray]:
    """Depths (H, W), metres, of a bed and of what another hand than the arm's made of it."""
    bed, _, key = bed_of(SEED)
    for_hand, for_now = jax.random.split(key)
    world = SimulatedWorld(for_hand, bed)
    now = look(for_now, bed, PAPER_BOX, frames=5)
    for action, place in APPLIED:
        world.act(action, place)
    return now, world.look()


def _poses(rng: np.random.Generator) -> str:
    """Pose pairs as JSON: a target in the gripper, turned below a fixed camera that looks down."""

    def pose(angles_deg: Any, xyz: Any) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
        matrix[:3, 3] = xyz
        return matrix

    camera = pose((180, 1.5, -1), (0.55, 0.02, 0.61))
    target = pose((5, 170, 30), (0.03, -0.02, 0.08))
    pairs = []
    for _ in range(POSES):
        turned = rng.uniform((145, -35, -60), (215, 35, 60))
        gripper = pose(turned, rng.uniform((0.43, -0.10, 0.23), (0.67, 0.14, 0.36)))
        wrong = pose(NOISE_DEG * rng.normal(size=3), NOISE_MM / 1e3 * rng.normal(size=3))
        seen = np.linalg.inv(camera) @ gripper @ target @ wrong
        both = {"base_gripper": gripper, "camera_target": seen}
        pairs.append({name: matrix.round(6).tolist() for name, matrix in both.items()})
    return json.dumps(pairs) + "\n"
