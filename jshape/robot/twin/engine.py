"""MuJoCo and mink, imported where they are needed and not before (the extra `sim`)."""

import ctypes.util
import importlib
import os
import sys
import warnings
from typing import Any

from jshape.errors import JShapeError, one_line

LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
"""Ways to draw without a screen, and the library that each needs."""


class NoPicture(JShapeError):
    """Nothing that MuJoCo could draw with."""


def mujoco() -> Any:
    """The module `mujoco`; JShapeError: it is not installed."""
    # MuJoCo reads the variable once, when it is imported, and takes GLFW, which needs a screen.
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ and "DISPLAY" not in os.environ:
        for name, library in LIBRARIES.items():
            if ctypes.util.find_library(library):
                os.environ["MUJOCO_GL"] = name
                break
    return _module("mujoco")


def mink() -> Any:
    """The module `mink`; JShapeError: it is not installed."""
    mujoco()
    return _module("mink")


def renderer(model: Any, width: int, height: int) -> Any:
    """A `mujoco.Renderer`; whoever asks for it closes it.

    Raises:
      NoPicture: neither EGL nor OSMesa works here.
    """
    try:
        with warnings.catch_warnings():  # GLFW warns of a missing screen, four times
            warnings.simplefilter("ignore")
            return mujoco().Renderer(model, height=height, width=width)
    except Exception as problem:  # each way to draw fails in its own fashion
        raise NoPicture(
            f"MuJoCo cannot draw with MUJOCO_GL={os.environ.get('MUJOCO_GL', '(unset)')} "
            f"({one_line(problem, 120) or type(problem).__name__}); "
            "on Debian install libosmesa6 and set MUJOCO_GL=osmesa, or "
            "libegl1 libegl-mesa0 libgl1-mesa-dri and MUJOCO_GL=egl"
        ) from None


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except (ImportError, AttributeError, OSError, RuntimeError) as problem:
        # Beside a missing package: a value of MUJOCO_GL that MuJoCo refuses or cannot load.
        raise JShapeError(
            f"the twin needs {name}, which does not import ({problem}): pip install 'jshape[sim]'"
        ) from None
