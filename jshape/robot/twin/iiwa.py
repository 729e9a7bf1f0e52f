"""The arm as numbers: KUKA LBR iiwa 14 R820, with shapes simple enough to collide properly.

All frames are parallel to the base's when every joint is at 0 and the arm stands upright.
"""

from typing import Any

import numpy as np

from jshape.robot.twin.engine import mujoco

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
"""Names, from the base."""
HEIGHTS = (0.1575, 0.2025, 0.2045, 0.2155, 0.1845, 0.2155, 0.081)
"""From each joint to the next along the upright arm, metres: 360, 420, 400 and, with the flange,
126 mm between base, shoulder, elbow, wrist and flange (KUKA's data sheet of the LBR iiwa 14 R820;
the joints inside the links as in the public ROS description iiwa_stack)."""
FLANGE = 0.045
"""From the last joint to the flange, metres."""
AXES = ((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1))
"""Of the joints."""
RANGES = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
"""The joints turn so far to either side, radians (data sheet)."""
TORQUES = (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0)
"""Largest torques, Nm (data sheet)."""
MASSES = (5.0, 5.76, 6.35, 3.5, 3.5, 3.5, 1.8, 1.2)
"""Of the base and the links, kg (iiwa_stack); 30.6 kg in all, the data sheet says 29.9."""
RADII = (0.085, 0.075, 0.075, 0.070, 0.070, 0.065, 0.062, 0.045)
"""Of the capsules that the links are, metres."""
STIFFNESS = (20000.0, 20000.0, 15000.0, 15000.0, 8000.0, 5000.0, 3000.0)
"""Of the position control, Nm/rad; chosen: a tool at 0.6 m gives way by about 0.02 mm/N."""
LAG = 0.02
"""Damping over stiffness of the position control, seconds: it is damped close to critically."""
ARMATURE = (0.4, 0.4, 0.2, 0.2, 0.1, 0.1, 0.05)
"""Inertia of the drives at the joints, kg m²; chosen."""

ARM = 1
"""Bit of the arm's shapes in MuJoCo's contact masks."""
HAND = 2
"""Bit of the hand's shapes: they do not touch each other, so fingers may lie on the palm."""
SCENE = 4
"""Bit of the box, the bed and what is buried in it."""


def add_arm(spec: Any) -> Any:
    """Put the arm at the world's origin of an MjSpec; returns the body that the hand hangs on."""
    engine = mujoco()
    body = spec.worldbody.add_body(name="base")
    _shape(engine, body, "base", 0)
    for k, name in enumerate(JOINTS):
        link = body.add_body(name=f"link{k + 1}", pos=(0, 0, HEIGHTS[k]), gravcomp=1.0)
        link.add_joint(
            name=name,
            type=engine.mjtJoint.mjJNT_HINGE,
            axis=AXES[k],
            range=(-RANGES[k], RANGES[k]),
            limited=engine.mjtLimited.mjLIMITED_TRUE,
            armature=ARMATURE[k],
        )
        _shape(engine, link, f"link{k + 1}", k + 1)
        drive = spec.add_actuator(
            name=name, target=name, trntype=engine.mjtTrn.mjTRN_JOINT, forcelimited=1,
            forcerange=(-TORQUES[k], TORQUES[k]),
        )  # fmt: skip
        drive.set_to_position(kp=STIFFNESS[k], kv=LAG * STIFFNESS[k])
        # Neighbours overlap at the joint between them, and the wrist is short.
        for other in ("base", *(f"link{n}" for n in range(1, 8)))[max(k - 1, 0) : k + 1]:
            spec.add_exclude(bodyname1=other, bodyname2=link.name)
        body = link
    flange = body.add_body(name="flange", pos=(0, 0, FLANGE))
    flange.add_site(name="flange", size=(0.005, 0.005, 0.005), group=4)
    return flange


def _shape(engine: Any, body: Any, name: str, k: int) -> None:
    """A capsule from this joint to the next."""
    up = (*HEIGHTS, FLANGE)[k]
    grey = (0.86, 0.86, 0.84, 1.0) if k % 2 else (0.95, 0.55, 0.15, 1.0)
    if k == 0:
        low, high, kind = (0, 0, 0.0), (0, 0, up - 0.02), engine.mjtGeom.mjGEOM_CYLINDER
    elif k == 7:
        low, high, kind = (0, 0, -0.01), (0, 0, up), engine.mjtGeom.mjGEOM_CYLINDER
    else:
        low, high, kind = (0, 0, 0.0), (0, 0, up * 0.9), engine.mjtGeom.mjGEOM_CAPSULE
    body.add_geom(
        name=name, type=kind, fromto=(*low, *high), size=(RADII[k], 0, 0), mass=MASSES[k],
        contype=ARM, conaffinity=ARM | SCENE, rgba=grey,
    )  # fmt: skip
