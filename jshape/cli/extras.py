"""What can be installed beside the core, and whether it works: by loading it, in its own process.

A library that crashes, or prints, then does neither to us.
"""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

LIMIT = 120
"""Seconds after which loading has failed; the slowest takes 3 on an idle machine."""


class Extra(NamedTuple):
    """What `pip install 'jshape[name]'` adds."""

    name: str
    what: str
    """What one can do with it."""
    modules: tuple[str, ...]
    """What must be importable."""
    debian: str = ""
    """Packages of Debian that it needs."""
    program: str = ""
    """What must run; "" imports the modules."""


DRAW = """
from jshape.robot.twin import engine
engine.mink()
model = engine.mujoco().MjModel.from_xml_string("<mujoco/>")
engine.renderer(model, 8, 8).close()
"""

EXTRAS = (
    Extra("cli", "the commands, pictures, TIFF", ("cyclopts", "matplotlib", "PIL", "rich")),
    Extra("mesh", "goals from PLY and OBJ files", ("trimesh",)),
    Extra("robot", "hands and waypoints as YAML files", ("yaml",)),
    Extra("networks", "interrupted trainings of networks that resume", ("orbax.checkpoint",)),
    Extra("sim", "the physics twin: --arm mujoco", ("mujoco", "mink"),
          "libosmesa6, or libegl1 libegl-mesa0 libgl1-mesa-dri", DRAW),
    Extra("realsense", "RealSense cameras", ("pyrealsense2",), "libusb-1.0-0",
          "import pyrealsense2; pyrealsense2.context()"),
    Extra("ros", "ROS bags, MCAP", ("rosbags",)),
    Extra("studio", "the studio and the viewer in a browser", ("nicegui",)),
    Extra("rerun", "runs in the Rerun viewer", ("rerun",)),
    Extra("grid", "`python -m benchmarks.grid` on several machines", ("ray",)),
    Extra("notebooks", "the lessons", ("ipykernel", "nbclient", "nbformat", "PIL")),
)  # fmt: skip
"""In the order in which they are told; those for developing jshape are left out."""


def look(extra: Extra) -> dict[str, Any]:
    """Whether an extra is installed, and what is wrong with it."""
    missing = [name for name in extra.modules if find_spec(name) is None]
    row = {
        "extra": extra.name,
        "what": extra.what,
        "installed": not missing,
        "problem": "",
        "pip": f"pip install 'jshape[{extra.name}]'",
        "debian": extra.debian,
    }
    return row if missing else row | {"problem": _run(extra)}


def first_line(problem: object) -> str:
    """An error as one line for people; its type, if it says nothing."""
    return " ".join(str(problem).split())[:200] or type(problem).__name__


def _run(extra: Extra) -> str:
    """What went wrong; "" if nothing."""
    program = extra.program or f"import {', '.join(extra.modules)}"
    # -P: files of the working folder are not what is asked about.  jshape itself may lie there.
    home = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(part for part in (os.environ.get("PYTHONPATH"), home) if part)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", program],
            env=os.environ | {"PYTHONPATH": path},
            capture_output=True,
            text=True,
            errors="replace",
            timeout=LIMIT,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.SubprocessError) as problem:
        return first_line(problem)
    if done.returncode == 0:
        return ""
    said = [line for line in done.stderr.splitlines() if line.strip()]
    return first_line(said[-1] if said else f"ended with code {done.returncode}")
