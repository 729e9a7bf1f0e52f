"""A bed whose heights are known, and what cameras that stand anywhere would see of it."""

from dataclasses import replace

import numpy as np

from jshape import Camera, HeightMap, sim
from jshape.height_map import as_frame, looking_down, map_of
from jshape.reproject import reproject
from jshape.robot.simulated import bed_of

SMALL = Camera(160, 120, 140.0, 140.0, 79.5, 59.5, 0.3, 0.7, bits=16)
"""It sees 510 x 380 mm from 0.45 m: the bed and no surroundings."""


def heights(x, y):
    """Metres: a mound of 20 mm at (40, -20) mm and a hollow of 10 mm, on a plane."""
    mound = 0.02 * np.exp(-((x - 0.04) ** 2 + (y + 0.02) ** 2) / (2 * 0.025**2))
    return mound - 0.01 * np.exp(-((x + 0.06) ** 2 + (y - 0.03) ** 2) / (2 * 0.02**2))


def hollow(depth, u=0.0, v=0.0):
    """Heights of a bed with a round hollow of some depth at (u, v), metres."""
    return lambda x, y: (
        heights(x, y) - depth * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 0.012**2))
    )


def bed(pitch=0.002, half=(0.16, 0.12), of=heights) -> HeightMap:
    """A map of it."""
    x, y = (np.arange(-h, h + pitch / 2, pitch) for h in half)
    return HeightMap(of(x, y[:, None]).astype(np.float32), pitch, (x[0], y[0]))


def standing(tilt_deg, distance=0.45, turn_deg=0.0, camera=SMALL) -> Camera:
    """A camera that looks at the bed's middle, tilted, and turned about the bed's normal."""
    t, turn = np.radians([tilt_deg, turn_deg])
    pose = np.eye(4)
    axis = np.array([0.0, np.sin(t), -np.cos(t)])
    pose[:3, :3] = np.stack([[1, 0, 0], np.cross(axis, [1, 0, 0]), axis], 1)
    pose[:3, 3] = -distance * axis
    around = np.eye(4)
    around[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    fields = {**vars(camera), "pose": as_frame(around @ pose)}
    return Camera(**fields)


def seen_by(camera: Camera, of: HeightMap | None = None) -> np.ndarray:
    """Depths (H, W) in metres that a camera sees of the bed, 0 where there is none."""
    whole = bed() if of is None else of
    above = whole.camera()
    span = np.array([0.15, 1.2], np.float32)
    depth = reproject(whole.depth(above), above, camera, span)
    return np.nan_to_num(np.asarray(depth))


STRAIGHT = looking_down(sim.SURFACE)
"""From a map's frame on the level of the simulated bed to the bed's own, which looks down."""


def above_simulated(tilt_deg) -> Camera:
    """A camera that looks at the middle of the simulated bed, posed in its frame."""
    wide = replace(SMALL, width=240, height=180, fx=210.0, fy=210.0, u0=119.5, v0=89.5)
    camera = standing(tilt_deg, 0.5, camera=wide)
    return replace(camera, pose=as_frame(STRAIGHT @ np.array(camera.pose)))


def dug_simulated(seed=3) -> HeightMap:
    """The bed of `sim:SEED`, 6 mm of it dug in the middle, in the frame of `above_simulated`."""
    target = bed(0.003, (0.14, 0.1)).camera()
    target = replace(target, pose=as_frame(STRAIGHT @ np.array(target.pose)))
    depth = np.asarray(sim.render(bed_of(seed)[0], target)).copy()
    depth[26:45, 26:53] += 0.006
    return map_of(depth, target)
