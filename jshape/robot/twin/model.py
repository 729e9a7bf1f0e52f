"""The scene of the twin as a MuJoCo model: `scene.xml` with hand, camera, box, bed, buried things.

The base frame is the world's.  The box stands in front of the arm; the camera at home looks at its
middle, with image columns u along -y and image rows v along -x: the arm reaches in from below.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jshape import sim
from jshape._typing import Float
from jshape.camera import Camera
from jshape.robot.rigid import Pose
from jshape.robot.twin.engine import mujoco

FOLDER = Path(__file__).parent
"""Of the XML files, which MuJoCo's own viewer opens too."""
REACH = 0.592
"""From the arm's axis to the middle of the box, metres."""
FLOOR = -0.10
"""Height of the box's floor in the base frame, metres: the arm stands on a block beside it."""
WALL = 0.012
"""Thickness of the box's walls, metres."""
RIM = 0.075
"""Height of the walls above the floor, metres: 15 mm above the material of a default bed."""
TOP = 0.14
"""Highest place that the height field can have, metres above the floor."""
PIXEL = 1e-5
"""Side of a pixel of the imagined sensor, metres; any number does."""


@dataclass(frozen=True)
class Obstacle:
    """A rigid block in the material."""

    xy: tuple[float, float]
    """Of its middle in the bed's frame, metres."""
    top: float
    """Height of its upper side above the floor of the box, metres."""
    size: tuple[float, float] = (0.08, 0.08)
    """Sides, metres."""


def base_camera() -> Pose:
    """Pose of the camera in the base frame at home: 450 mm above 60 mm of material."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    pose[:3, 3] = REACH, 0.0, FLOOR + sim.Z_FLOOR
    return pose


def build(bed: sim.Bed, camera: Camera, obstacle: Obstacle | None) -> Any:
    """The MjModel of the scene around a bed: see `jshape.robot.arms.mujoco.make_twin`."""
    MjSpec = mujoco().MjSpec
    spec = MjSpec.from_file(str(FOLDER / "scene.xml"))
    spec.visual.global_.offwidth = max(camera.width, 960)
    spec.visual.global_.offheight = max(camera.height, 720)
    hand = MjSpec.from_file(str(FOLDER / "hand.xml"))
    spec.attach(hand, frame=spec.body("flange").add_frame(), prefix="hand/")
    eye = spec.camera("depth")
    eye.resolution = (camera.width, camera.height)
    eye.focal_pixel = (float(camera.fx), float(camera.fy))
    eye.sensor_size = (camera.width * PIXEL, camera.height * PIXEL)
    _add_box(spec, bed, obstacle)
    model = spec.compile()
    # Both signs turn round against the image's, and pixel (u, v) has its centre at u + 0.5.
    model.cam_intrinsic[model.camera("depth").id, 2:] = (
        -(float(camera.u0) + 0.5 - camera.width / 2) * PIXEL,
        -(float(camera.v0) + 0.5 - camera.height / 2) * PIXEL,
    )
    model.hfield_data[:] = field_of(bed)
    return model


def field_of(bed: sim.Bed) -> Float[np.ndarray, "N"]:
    """What MuJoCo stores for a bed: heights as shares of `TOP`, a cell wider to every side.

    Its rows go along the base's x, the bed's rows against it; and its outermost points stand where
    the bed's outermost cells have their middles, so one more of them reaches into the walls.
    """
    height = np.pad(np.asarray(bed.height)[::-1], 1, mode="edge")
    return np.clip(height / TOP, 0.0, 1.0).astype(np.float32).ravel()


def _add_box(spec: Any, bed: sim.Bed, obstacle: Obstacle | None) -> None:
    """Walls, floor, bed and what is buried, in a body with the height field's axes."""
    engine = mujoco()
    rows, columns = bed.height.shape
    half_x, half_y = columns * bed.cell / 2, rows * bed.cell / 2
    # Frame of the height field: x along image columns, y against image rows, z up.
    box = spec.worldbody.add_body(name="box", pos=(REACH, 0, FLOOR))
    box.alt.type = engine.mjtOrientation.mjORIENTATION_XYAXES
    box.alt.xyaxes = (0, -1, 0, 1, 0, 0)

    def cuboid(name: str, at: Any, size: Any, rgba: tuple = (0.62, 0.44, 0.26, 1)) -> None:
        # What is rigid overrules how softly the hand meets material (skin.xml).
        box.add_geom(
            **dict(name=name, pos=at, size=size, rgba=rgba, contype=4, conaffinity=3, priority=2),
            type=engine.mjtGeom.mjGEOM_BOX,
        )

    across, along = (WALL / 2, half_y + WALL, RIM / 2), (half_x + WALL, WALL / 2, RIM / 2)
    for sign, names in ((-1, ("left", "near")), (1, ("right", "far"))):
        cuboid(f"wall_{names[0]}", (sign * (half_x + WALL / 2), 0, RIM / 2), across)
        cuboid(f"wall_{names[1]}", (0, sign * (half_y + WALL / 2), RIM / 2), along)
    cuboid("floor", (0, 0, -0.01), (half_x + WALL, half_y + WALL, 0.01))
    nrow, ncol = rows + 2, columns + 2
    reach = ((ncol - 1) * bed.cell / 2, (nrow - 1) * bed.cell / 2)
    # MuJoCo stretches what it is given to 0..1 when it compiles: write the heights after that.
    empty = np.zeros(nrow * ncol, np.float32)
    spec.add_hfield(name="bed", nrow=nrow, ncol=ncol, size=(*reach, TOP, 0.005), userdata=empty)
    box.add_geom(
        **dict(name="bed", hfieldname="bed", contype=4, conaffinity=3, rgba=(0.93, 0.89, 0.80, 1)),
        type=engine.mjtGeom.mjGEOM_HFIELD,
    )
    if obstacle is not None:
        (x, y), half = obstacle.xy, obstacle.top / 2
        half_size = (obstacle.size[0] / 2, obstacle.size[1] / 2, half)
        cuboid("obstacle", (x, -y, half), half_size, (0.35, 0.36, 0.40, 1))
