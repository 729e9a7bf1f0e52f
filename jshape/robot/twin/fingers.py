"""The hand as numbers: a wrist, a palm, four fingers and a thumb, and the postures they take.

In the flange's frame, metres: z along the hand, the fingers side by side along y, the palm looks
towards -x.  Sizes are those of a large human hand, with fingertips as wide as the strokes of
`sim.tools`.
"""

from typing import Any

import numpy as np

from jshape.errors import UnknownName
from jshape.robot.twin.engine import mujoco
from jshape.robot.twin.iiwa import ARM, HAND, SCENE

FINGERS = {"index": -0.030, "middle": -0.010, "ring": 0.010, "little": 0.030}
"""Where the knuckles are along y."""
TURN, BEND, PALM, KNUCKLES = 0.030, 0.055, 0.060, 0.150
"""Along z: the two joints of the wrist, the upper edge of the palm, the knuckles."""
LENGTHS = (0.045, 0.027, 0.022)
"""Of the three bones of a finger."""
RADIUS = 0.009
"""Of a finger."""
THUMB = (-0.018, -0.032, 0.125)
"""Where the thumb begins."""
THUMB_LENGTHS = (0.050, 0.040, 0.030)
"""Of its bones."""
COUPLED = 0.7
"""The last joint of a finger turns with the one before it, by this share, as a person's does."""

SOFT = {"tip": (-240.0, -5.0), "bone": (-14.0, -0.3)}
"""Springs (MuJoCo's solref) at each of the tens of points where a bone meets the height field: how
the material gives way before the bed changes.  A fingertip then meets 3 N per millimetre, a fist 4
to 5, a claw 10 (docs/twin.md)."""
IMPEDANCE = 0.002
"""MuJoCo's solimp.  It must be small: soft springs of high impedance act like added mass, which for
the 400 points of a fist grew to hundreds of kilograms at 0.3."""

_FIST = (0, 90, 100)
_THUMB_IN = (-35, 88, -95)
POSTURES: dict[str, tuple[float, ...]] = {
    "flat": (0, 0, *(0, 0, 0) * 4, 0, 20, 0),
    "claw": (
        *(0, 0, -2.9, -42.9, 61.4, -1.9, -52.3, 59, 1.9, -52.3, 59, 2.9, -42.9, 61.4),
        *(-29.8, 54.5, 26.5),
    ),
    "closed": (
        *(0, 0, 3.7, -30.3, 60.1, 1.2, -30.4, 60.3, -1.2, -30.4, 60.3, -3.7, -30.3, 60.1),
        *(-39, 58, 39.2),
    ),
    "fist": (90, 0, *_FIST * 4, *_THUMB_IN),
    "side": (180, 90, *_FIST * 4, *_THUMB_IN),
    "point": (0, 0, 0, 0, 0, *_FIST * 3, *_THUMB_IN),
    "pinch_open": (0, 0, -14.8, -11.4, 28.6, 14.8, -15.5, 30.1, *_FIST * 2, *_THUMB_IN),
    "pinch_closed": (0, 0, -2.1, -14.6, 32.5, 2.1, -16.6, 33.1, *_FIST * 2, *_THUMB_IN),
}
"""Angles in degrees: wrist turn and bend; spread, knuckle and middle joint of the four fingers;
turn, swing and bend of the thumb.  Solved for the fingertips of `sim.tools`, see docs/twin.md."""

ORDER = (
    ("wrist_turn", "wrist_bend"),
    *((f"{name}_spread", f"{name}_knuckle", f"{name}_middle") for name in FINGERS),
    ("thumb_turn", "thumb_swing", "thumb_bend"),
)
"""The joints that a posture gives, in order."""
DRIVEN = tuple(name for group in ORDER for name in group)
"""The same in one line."""
FOLLOWERS = {f"{name}_tip": f"{name}_middle" for name in FINGERS} | {"thumb_tip": "thumb_bend"}
"""Joints that follow another."""
JOINTS = DRIVEN + tuple(FOLLOWERS)
"""All of them."""


def angles(posture: str) -> dict[str, float]:
    """Of all the hand's joints in a posture, radians.

    Raises:
      UnknownName: no such posture.
    """
    if posture not in POSTURES:
        raise UnknownName("posture", posture, POSTURES)
    driven = dict(zip(DRIVEN, np.radians(POSTURES[posture]).tolist(), strict=True))
    return driven | {tip: COUPLED * driven[middle] for tip, middle in FOLLOWERS.items()}


def add_hand(spec: Any, flange: Any) -> None:
    """Hang the hand on the flange."""
    engine = mujoco()
    tube, box = engine.mjtGeom.mjGEOM_CYLINDER, engine.mjtGeom.mjGEOM_BOX
    flange.gravcomp = 1.0
    _geom(flange, "socket", tube, (0, 0, 0, 0, 0, TURN), (0.040, 0, 0), 0.25, "dark")
    turn = _body(flange, "hand_turn", (0, 0, TURN))
    _joint(engine, spec, turn, "wrist_turn", (0, 0, 1), (-181, 181), 600.0, 60.0, 0.02)
    _geom(turn, "wrist", tube, (0, 0, 0, 0, 0, BEND - TURN), (0.032, 0, 0), 0.15, "dark")
    palm = _body(turn, "palm", (0, 0, BEND - TURN))
    _joint(engine, spec, palm, "wrist_bend", (1, 0, 0), (-10, 95), 600.0, 60.0, 0.02)
    half = (KNUCKLES - PALM) / 2
    geom = _geom(palm, "palm", box, None, (0.012, 0.039, half), 0.40, "skin")
    geom.pos = (0, 0, PALM - BEND + half)
    for name, y in FINGERS.items():
        _finger(engine, spec, palm, name, (0, y, KNUCKLES - BEND))
    _thumb(engine, spec, palm)


def _finger(engine: Any, spec: Any, palm: Any, name: str, position: tuple) -> None:
    """Spread and knuckle at the palm, then the middle and the last joint."""
    body = _body(palm, f"{name}_1", position)
    _joint(engine, spec, body, f"{name}_spread", (-1, 0, 0), (-25, 25), 25.0, 8.0, 0.004)
    flex = (0, -1, 0)
    _joint(engine, spec, body, f"{name}_knuckle", flex, (-60, 95), 25.0, 8.0, 0.004)
    for k, length in enumerate(LENGTHS):
        if k:
            body = _body(body, f"{name}_{k + 1}", (0, 0, LENGTHS[k - 1]))
            joint, most = (f"{name}_middle", 110) if k == 1 else (f"{name}_tip", 80)
            _joint(engine, spec, body, joint, flex, (-5, most), 20.0, 6.0, 0.003)
        _bone(engine, body, f"{name}_{k + 1}", length, RADIUS)


def _thumb(engine: Any, spec: Any, palm: Any) -> None:
    """Turn and swing away from the palm, then two joints that bend back."""
    x, y, z = THUMB
    body = _body(palm, "thumb_1", (x, y, z - BEND))
    _joint(engine, spec, body, "thumb_turn", (0, 0, 1), (-100, 100), 25.0, 8.0, 0.004)
    _joint(engine, spec, body, "thumb_swing", (0, -1, 0), (-20, 100), 25.0, 8.0, 0.004)
    for k, length in enumerate(THUMB_LENGTHS):
        if k:
            body = _body(body, f"thumb_{k + 1}", (0, 0, THUMB_LENGTHS[k - 1]))
            joint, most = ("thumb_bend", 110) if k == 1 else ("thumb_tip", 80)
            _joint(engine, spec, body, joint, (0, 1, 0), (-95, most), 20.0, 6.0, 0.003)
        _bone(engine, body, f"thumb_{k + 1}", length, RADIUS)


def _body(parent: Any, name: str, position: tuple) -> Any:
    return parent.add_body(name=name, pos=position, gravcomp=1.0)


def _joint(
    engine: Any, spec: Any, body: Any, name: str, axis: tuple, limits: tuple, stiffness: float,
    force: float, armature: float,
) -> None:  # fmt: skip
    """A hinge and its drive; stiffness in Nm/rad, force in Nm, limits in degrees."""
    body.add_joint(
        name=name, type=engine.mjtJoint.mjJNT_HINGE, axis=axis, range=np.radians(limits),
        limited=engine.mjtLimited.mjLIMITED_TRUE, armature=armature,
    )  # fmt: skip
    drive = spec.add_actuator(
        name=name, target=name, trntype=engine.mjtTrn.mjTRN_JOINT, forcelimited=1,
        forcerange=(-force, force),
    )  # fmt: skip
    drive.set_to_position(kp=stiffness, kv=0.03 * stiffness)


def _bone(engine: Any, body: Any, name: str, length: float, radius: float) -> None:
    capsule = engine.mjtGeom.mjGEOM_CAPSULE
    mass = 1100.0 * np.pi * radius**2 * length  # as dense as a person
    _geom(body, name, capsule, (0, 0, 0, 0, 0, length), (radius, 0, 0), mass, "skin")


_COLORS = {"skin": (0.80, 0.62, 0.50, 1), "dark": (0.25, 0.26, 0.28, 1)}


def _geom(
    body: Any, name: str, kind: Any, fromto: tuple | None, size: tuple, mass: float, color: str
) -> Any:
    geom = body.add_geom(
        name=name, type=kind, size=size, mass=mass, contype=HAND, conaffinity=ARM | SCENE,
        rgba=_COLORS[color], friction=(0.3, 0.005, 0.0001), priority=1,
        solref=SOFT["tip" if name.endswith("_3") else "bone"],
        solimp=(IMPEDANCE, IMPEDANCE, 0.01, 0.5, 2.0),
    )  # fmt: skip
    if fromto is not None:
        geom.fromto = fromto
    return geom
