"""Postures of the hand in `hand.xml`: a wrist, four fingers and a thumb."""

import numpy as np

from jshape.errors import UnknownName

FINGERS = ("index", "middle", "ring", "little")
COUPLED = 0.7
"""The last joint of a finger turns with the one before it, by this share, as a person's does."""

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
    "cup": (180, 0, *(0, 20, 25) * 4, *_THUMB_IN),
    "open": (180, 0, *(0, 0, 0) * 4, *_THUMB_IN),
    "pinch_open": (0, 0, -14.8, -11.4, 28.6, 14.8, -15.5, 30.1, *_FIST * 2, *_THUMB_IN),
    "pinch_closed": (0, 0, -2.1, -14.6, 32.5, 2.1, -16.6, 33.1, *_FIST * 2, *_THUMB_IN),
}
"""Angles of `_DRIVEN` in degrees.  Solved for the fingertips of `sim.hands`, see docs/twin.md."""

_BENDING = tuple(f"{name}_{joint}" for name in FINGERS for joint in ("spread", "knuckle", "middle"))
_DRIVEN = ("wrist_turn", "wrist_bend", *_BENDING, "thumb_turn", "thumb_swing", "thumb_bend")
_FOLLOWED = (*(f"{name}_middle" for name in FINGERS), "thumb_bend")
JOINTS = tuple(f"hand/{name}" for name in (*_DRIVEN, *(f"{f}_tip" for f in (*FINGERS, "thumb"))))
"""Names in the model, in the order of `angles`."""


def angles(posture: str) -> np.ndarray:
    """Of `JOINTS` in a posture, radians.

    Raises:
      UnknownName: no such posture.
    """
    if posture not in POSTURES:
        raise UnknownName("posture", posture, POSTURES)
    driven = np.radians(POSTURES[posture])
    return np.append(driven, COUPLED * driven[[_DRIVEN.index(name) for name in _FOLLOWED]])
