"""The scene of the twin as a MuJoCo model: arm, hand, wrist camera, box, bed, buried things.

The base frame is the world's.  The box stands in front of the arm; the camera at home looks at its
middle, with image columns u along -y and image rows v along -x: the arm reaches in from below.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jshape import sim
from jshape._typing import Float
from jshape.camera import D435_BAZAR, Camera
from jshape.robot.twin.engine import mujoco
from jshape.robot.twin.fingers import add_hand
from jshape.robot.twin.iiwa import ARM, HAND, SCENE, add_arm

CAMERA_HEIGHT = sim.Z_FLOOR
"""Of the camera at home above the floor of the box, metres: 450 mm above 60 mm of material."""
REACH = 0.592
"""From the arm's axis to the middle of the box, metres."""
FLOOR = -0.10
"""Height of the box's floor in the base frame, metres: the arm stands on a block beside it."""
TILT = np.radians(25.0)
"""The camera looks so far away from the hand: at home the hand is out of its view."""
CAMERA_AT = (0.0, -0.10, 0.01)
"""The camera in the flange's frame, metres."""
WALL = 0.012
"""Thickness of the box's walls, metres."""
RIM = 0.075
"""Height of the walls above the floor, metres: 15 mm above the material of a default bed."""
TOP = 0.14
"""Highest place that the height field can have, metres above the floor."""
TIMESTEP = 0.002
"""Of the physics, seconds."""
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


class Scene(NamedTuple):
    """A compiled model and what belongs to it."""

    model: Any
    """MjModel."""
    base_camera: Float[np.ndarray, "4 4"]
    """Pose of the camera in the base frame when the arm is at home."""


def base_camera() -> Float[np.ndarray, "4 4"]:
    """Pose of the camera in the base frame when the arm is at home."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    pose[:3, 3] = REACH, 0.0, FLOOR + CAMERA_HEIGHT
    return pose


def flange_camera() -> Float[np.ndarray, "4 4"]:
    """Pose of the camera in the flange's frame; the axes of both x are parallel."""
    cos, sin = np.cos(TILT), np.sin(TILT)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    pose[:3, 3] = CAMERA_AT
    return pose


def build(bed: sim.Bed, camera: Camera = D435_BAZAR, obstacle: Obstacle | None = None) -> Scene:
    """The scene around a bed.

    Args:
      bed: its size is the box's.
      camera: size and intrinsics of the depth camera.
      obstacle: something rigid in the bed.
    """
    engine = mujoco()
    spec = engine.MjSpec()
    spec.modelname = "jshape twin"
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP
    spec.option.integrator = engine.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = engine.mjtCone.mjCONE_ELLIPTIC
    _looks(engine, spec, camera)
    flange = add_arm(spec)
    add_hand(spec, flange)
    _camera(engine, flange, camera)
    _box(engine, spec, bed, obstacle)
    model = spec.compile()
    _principal_point(model, camera)
    model.hfield_data[:] = field_of(bed)
    return Scene(model, base_camera())


def field_of(bed: sim.Bed) -> Float[np.ndarray, "N"]:
    """What MuJoCo stores for a bed: heights as shares of `TOP`, a cell wider to every side.

    Its rows go along the base's x, the bed's rows against it; and its outermost points stand where
    the bed's outermost cells have their middles, so one more of them reaches into the walls.
    """
    height = np.pad(np.asarray(bed.height)[::-1], 1, mode="edge")
    return np.clip(height / TOP, 0.0, 1.0).astype(np.float32).ravel()


def _camera(engine: Any, flange: Any, camera: Camera) -> None:
    pose = flange_camera()
    mount = flange.add_body(name="camera", pos=pose[:3, 3], gravcomp=1.0)
    rotation = pose[:3, :3]
    mount.alt.type = engine.mjtOrientation.mjORIENTATION_XYAXES
    mount.alt.xyaxes = (*rotation[:, 0], *rotation[:, 1])
    # A D435 is 90 x 25 x 25 mm and weighs 72 g; its lens looks out of the front, at the origin.
    look = dict(contype=ARM, conaffinity=SCENE, rgba=(0.6, 0.62, 0.65, 1))
    box, tube = engine.mjtGeom.mjGEOM_BOX, engine.mjtGeom.mjGEOM_CYLINDER
    mount.add_geom(
        name="camera", type=box, pos=(0, 0, -0.0135), size=(0.045, 0.0125, 0.0125), mass=0.072,
        **look,
    )  # fmt: skip
    flange.add_geom(
        name="bracket", type=tube, fromto=(0, -0.03, 0.002, 0, -0.10, 0.0), size=(0.006, 0, 0),
        mass=0.05, **look,
    )  # fmt: skip
    # MuJoCo's cameras look along -z with y up.
    eye = mount.add_camera(name="depth", quat=(0, 1, 0, 0))
    eye.resolution = (camera.width, camera.height)
    eye.focal_pixel = (float(camera.fx), float(camera.fy))
    eye.sensor_size = (camera.width * PIXEL, camera.height * PIXEL)


def _principal_point(model: Any, camera: Camera) -> None:
    # Both signs turn round against the image's, and pixel (u, v) has its centre at u + 0.5.
    eye = model.camera("depth").id
    model.cam_intrinsic[eye, 2] = -(float(camera.u0) + 0.5 - camera.width / 2) * PIXEL
    model.cam_intrinsic[eye, 3] = -(float(camera.v0) + 0.5 - camera.height / 2) * PIXEL


def _box(engine: Any, spec: Any, bed: sim.Bed, obstacle: Obstacle | None) -> None:
    """Walls, floor, bed and what is buried, in a body with the bed's x and y reversed."""
    rows, columns = bed.height.shape
    half_x, half_y = columns * bed.cell / 2, rows * bed.cell / 2
    middle = base_camera()
    # Frame of the height field: x along image columns, y against image rows, z up.
    box = spec.worldbody.add_body(name="box", pos=(middle[0, 3], middle[1, 3], FLOOR))
    box.alt.type = engine.mjtOrientation.mjORIENTATION_XYAXES
    box.alt.xyaxes = (0, -1, 0, 1, 0, 0)
    cuboid = engine.mjtGeom.mjGEOM_BOX
    # What is rigid overrules how softly the hand meets material (`fingers.SOFT`).
    wood = dict(
        type=cuboid, priority=2, contype=SCENE, conaffinity=ARM | HAND, rgba=(0.62, 0.44, 0.26, 1)
    )
    for name, sign, along in (("left", -1, 0), ("right", 1, 0), ("near", -1, 1), ("far", 1, 1)):
        at, size = [0.0, 0.0, RIM / 2], [half_x + WALL, half_y + WALL, RIM / 2]
        at[along] = sign * ((half_x, half_y)[along] + WALL / 2)
        size[along] = WALL / 2
        box.add_geom(name=f"wall_{name}", pos=at, size=size, **wood)
    box.add_geom(
        name="floor", pos=(0, 0, -0.01), size=(half_x + WALL, half_y + WALL, 0.01), **wood
    )  # fmt: skip
    nrow, ncol = rows + 2, columns + 2
    reach = ((ncol - 1) * bed.cell / 2, (nrow - 1) * bed.cell / 2)
    # MuJoCo stretches what it is given to 0..1 when it compiles: write the heights after that.
    empty = np.zeros(nrow * ncol, np.float32)
    spec.add_hfield(name="bed", nrow=nrow, ncol=ncol, size=(*reach, TOP, 0.005), userdata=empty)
    box.add_geom(
        name="bed", type=engine.mjtGeom.mjGEOM_HFIELD, hfieldname="bed", contype=SCENE,
        conaffinity=HAND | ARM, rgba=(0.93, 0.89, 0.80, 1),
    )  # fmt: skip
    if obstacle is not None:
        (x, y), top = obstacle.xy, obstacle.top
        block = dict(wood, rgba=(0.35, 0.36, 0.40, 1))
        box.add_geom(
            name="obstacle", pos=(x, -y, top / 2), size=(*(s / 2 for s in obstacle.size), top / 2),
            **block,
        )  # fmt: skip


def _looks(engine: Any, spec: Any, camera: Camera) -> None:
    spec.visual.global_.offwidth = max(camera.width, 960)
    spec.visual.global_.offheight = max(camera.height, 720)
    spec.visual.map.znear = 0.02
    spec.visual.map.zfar = 5.0
    spec.visual.headlight.ambient = (0.30, 0.30, 0.30)
    spec.visual.headlight.diffuse = (0.15, 0.15, 0.15)
    spec.visual.quality.shadowsize = 4096
    spec.stat.extent = 1.0
    spec.stat.center = (0.4, 0.0, 0.2)
    sky = spec.add_texture(name="sky", type=engine.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=64)
    sky.builtin = engine.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = (0.96, 0.97, 0.98), (0.80, 0.84, 0.88)
    spec.worldbody.add_light(
        pos=(1.5, 1.0, 1.1), dir=(-0.95, -0.9, -0.9), castshadow=True, diffuse=(0.7, 0.7, 0.7)
    )
    spec.worldbody.add_geom(
        name="ground", type=engine.mjtGeom.mjGEOM_BOX, pos=(0.5, 0, FLOOR - 0.07),
        size=(1.2, 1.0, 0.05), rgba=(0.55, 0.58, 0.60, 1), contype=SCENE, conaffinity=ARM | HAND,
        priority=2,
    )  # fmt: skip
    spec.worldbody.add_geom(
        name="block", type=engine.mjtGeom.mjGEOM_BOX, pos=(0, 0, (FLOOR - 0.02) / 2),
        size=(0.12, 0.12, -(FLOOR - 0.02) / 2), rgba=(0.3, 0.32, 0.35, 1), contype=SCENE,
        conaffinity=0,
    )  # fmt: skip
