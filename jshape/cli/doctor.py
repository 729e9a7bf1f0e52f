"""`jshape doctor`: what is installed and works.  It needs nothing that might be broken itself."""

import importlib
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from jshape import __version__
from jshape.cli.options import Common
from jshape.cli.tables import coloured, print_table

CORE = {name: name for name in ("jax", "jaxlib", "flax", "optax", "numpy", "scipy")} | {
    "opencv-python-headless": "cv2",
    "filelock": "filelock",
    "platformdirs": "platformdirs",
}
"""What jshape cannot do without: packages, and the module that each brings."""
LIMIT = 120
"""Seconds after which loading an extra has failed; the slowest takes 3 on an idle machine."""
BANK = "flour-robot"
"""What the self-test plans with: the bundled bank that compiles quickest."""
PLACE, NEAR = (230, 200), 25
"""Where the self-test knocks, and how far from it a plan on a 9x7 grid may find that, pixels."""


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


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(Common):
    """Of `jshape doctor`."""

    computes = False  # it does, but must speak where JAX does not even import

    def exit_code(self, result: Mapping[str, Any]) -> int:
        """1 where something is bad."""
        return int(not result["good"])


def doctor(*, options: DoctorOptions = DoctorOptions()) -> dict[str, Any]:
    """`jshape doctor`: load everything, check banks, compute something that is known."""
    with ThreadPoolExecutor(2) as pool:  # each is a process of its own
        looked = [pool.submit(look, extra) for extra in EXTRAS]
        core = [
            _tried({"package": package, "version": ""}, partial(_load, package, module))
            for package, module in CORE.items()
        ]
        parts = {"devices": _devices, "cache": _cache, "banks": _banks}
        result: dict[str, Any] = {
            "jshape": __version__,
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "core": core,
            "memory": _memory(),
            **{name: _tried({}, make) for name, make in parts.items()},
            "selftest": [
                _tried({"test": name, "found": ""}, test) for name, test in SELFTEST.items()
            ],
            "extras": [future.result() for future in looked],
        }
    said = {row["package"]: row for row in core} | {name: result[name] for name in parts}
    said |= {f"bank {row['name']}": row for row in result["banks"].get("found", ())}
    said |= {row["test"]: row for row in result["selftest"]}
    bad = [f"{name}: {row['problem']}" for name, row in said.items() if row["problem"]]
    result |= {"good": not bad, "problems": bad}
    _print(result)
    return result


def look(extra: Extra) -> dict[str, Any]:
    """Whether an extra is installed, and what is wrong with it."""
    installed = all(find_spec(name) is not None for name in extra.modules)
    row = {"extra": extra.name, "what": extra.what, "installed": installed, "debian": extra.debian}
    row["pip"] = f"pip install 'jshape[{extra.name}]'"
    return _tried(row, partial(_run, extra) if installed else dict)


def _run(extra: Extra) -> dict[str, Any]:
    """Load it in a process of its own: a library that crashes, or prints, does neither to us."""
    program = extra.program or f"import {', '.join(extra.modules)}"
    # -P: files of the working folder are not what is asked about.  jshape itself may lie there.
    home = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(part for part in (os.environ.get("PYTHONPATH"), home) if part)
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        errors="replace",
        timeout=LIMIT,
        stdin=subprocess.DEVNULL,
    )
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise ChildProcessError(said[-1] if said else f"ended with code {done.returncode}")
    return {}


def _tried(row: dict[str, Any], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The row with what is found, or with what is wrong, in one line."""
    started, made, problem = time.perf_counter(), {}, ""
    try:
        made = make()
    except Exception as error:  # what is broken fails in its own fashion
        problem = " ".join(str(error).split())[:200] or type(error).__name__
    return row | made | {"problem": problem, "seconds": time.perf_counter() - started}


def _load(package: str, module: str) -> dict[str, str]:
    loaded = importlib.import_module(module)
    with suppress(metadata.PackageNotFoundError):  # it works, and does not say who it is
        return {"version": str(getattr(loaded, "__version__", "")) or metadata.version(package)}
    return {}


def _devices() -> dict[str, Any]:
    from jshape.planning.devices import cores, over_devices

    over_devices()
    import jax

    names = [f"{device.platform}: {device.device_kind}" for device in jax.devices()]
    return {"cores": cores(), "found": names}


def _memory() -> dict[str, float | None]:
    """GiB of the machine, or of its share for this process; None where nobody says."""
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        total, free = (os.sysconf(f"SC_{name}PHYS_PAGES") * page for name in ("", "AV"))
    except (AttributeError, OSError, ValueError):  # not on Windows
        return {"total_gib": None, "free_gib": None}
    try:
        limit = int(Path("/sys/fs/cgroup/memory.max").read_text())
    except (OSError, ValueError):
        limit = total
    return {"total_gib": min(total, limit) / 2**30, "free_gib": min(free, limit) / 2**30}


def _cache() -> dict[str, Any]:
    from jshape.planning.devices import remember_compiled

    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR") or remember_compiled()
    files = [] if folder is None else [p for p in Path(folder).rglob("*") if p.is_file()]
    size = sum(path.stat().st_size for path in files)
    return {"folder": folder and str(folder), "files": len(files), "bytes": size}


def _banks() -> dict[str, Any]:
    from jshape.io.banks import bank_manifest, list_banks

    def read(name: str) -> dict[str, Any]:  # every file, and compares its checksum
        manifest = bank_manifest(name)
        return {"kind": manifest["kind"], "actions": manifest["actions"]}

    rows = [
        _tried({"name": name, "kind": "", "actions": []}, partial(read, name))
        for name in list_banks()
    ]
    if not rows:
        raise FileNotFoundError("none is bundled")
    return {"found": rows}


def _distance() -> dict[str, str]:
    import numpy as np

    from jshape import PAPER_BOX, distance

    rng = np.random.default_rng(0)
    first, second = rng.random((2, *PAPER_BOX.shape), np.float32)
    found = float(distance(first, second))
    expected = float(np.abs(first.astype(float) - second).mean())
    if not abs(found - expected) <= 1e-5 * expected:
        raise ValueError(f"{found:.7f}; NumPy finds {expected:.7f}")
    return {"found": f"{found:.6f}, as NumPy finds"}


def _plan() -> dict[str, str]:
    import jax
    import numpy as np

    from jshape import PAPER, load_bank, options, plan_depth
    from jshape.robot.simulated import SimulatedWorld, bed_of

    bank = load_bank(BANK)
    bed, key, _ = bed_of(0)
    world = SimulatedWorld(key, bed, camera=bank.camera)
    now = np.asarray(jax.block_until_ready(world.look()))
    world.act("knock", PLACE)
    search = options(PAPER, bank=bank, positions="9x7", max_steps=1)
    found = plan_depth(now, np.asarray(world.look()), **search)
    before, after = float(found.distances_mm[0]), float(found.distances_mm[-1])
    said = f"{', '.join(found.actions) or 'nothing'}, {before:.3f} -> {after:.3f} mm"
    if found.actions != ("knock",) or not after < 0.8 * before:
        raise ValueError(f"{said}; a knock at {PLACE} was expected, a fifth nearer at least")
    place = tuple(int(x) for x in found.positions[0])
    if np.hypot(*np.subtract(place, PLACE)) > NEAR:
        raise ValueError(f"a knock at {place}; {PLACE} within {NEAR} pixels was expected")
    return {"found": f"knock at {place}, {before:.3f} -> {after:.3f} mm"}


SELFTEST = {"distance of two images": _distance, "plan in the simulator": _plan}
"""What is computed, and compared with what must come out."""


def _print(result: dict[str, Any]) -> None:
    print(f"jshape {result['jshape']}, Python {result['python']}, {result['system']}")
    devices, memory, cache = result["devices"], result["memory"], result["cache"]
    if "found" in devices:
        print(f"devices: {', '.join(devices['found'])}; cores: {devices['cores']}")
    if memory["total_gib"] is not None:
        print(f"memory: {memory['total_gib']:.1f} GiB, {memory['free_gib']:.1f} free")
    if "folder" in cache:
        size = f"{cache['folder']}, {cache['files']} files, {cache['bytes'] / 2**20:.1f} MiB"
        print(f"compiled code: {size if cache['folder'] else 'not kept'}")
    banks = result["banks"].get("found", ())
    core = [(r["package"], r["version"], _state(r)) for r in result["core"]]
    extras = [(r["extra"], r["what"], _extra(r)) for r in result["extras"]]
    kept = [(r["name"], r["kind"], ", ".join(r["actions"]), _state(r)) for r in banks]
    made = result["selftest"]
    tests = [(r["test"], f"{r['seconds']:.1f}", r["found"] or _state(r)) for r in made]
    for head, rows in (
        (("package", "version", "state"), core),
        (("extra", "what for", "state"), extras),
        (("bank", "kind", "actions", "checksums"), kept),
        (("self-test", "seconds", "found"), tests),
    ):
        print()
        print_table(head, rows)
    print()
    for line in result["problems"]:
        print(f"{coloured('BAD', 'error')} {line}")
    if result["good"]:
        print(coloured("all that the core needs works", "good"))


def _state(row: dict[str, Any]) -> str:
    return f"BAD: {row['problem']}" if row["problem"] else "ok"


def _extra(row: dict[str, Any]) -> str:
    state = _state(row) if row["installed"] else f"not installed: {row['pip']}"
    debian = f"; Debian: apt install {row['debian']}" * bool(row["debian"])
    return state if state == "ok" else state + debian
