"""What computations run on, chosen in this one place: devices, and where compiled code is kept."""

import hashlib
import os
import platform
from pathlib import Path

import jax
import numpy as np
from jax.sharding import Mesh

from jshape.planning.evaluate import ONE_BY_ONE, Execution

MOST = 8
"""Devices made unless more are asked for: small sweeps gain nothing from more."""


def over_devices(count: int | None = None) -> Execution:
    """How to share candidates over devices: cores of the CPU, each a device, unless JAX has a GPU.

    Call it before anything is computed: JAX makes its devices then.  Afterwards it is too late for
    more, and those that are there are used.  It changes no result.

    Args:
      count: at most so many; None is as many as this process has cores, at most `MOST`.
    """
    mesh = mesh_of(min(cores(), MOST) if count is None else count, "places")
    return ONE_BY_ONE if mesh is None else Execution(mesh=mesh)


def mesh_of(count: int, axis: str) -> Mesh | None:
    """At most `count` devices, as a mesh with one axis; None if that is only one.

    As for `over_devices`, devices of the CPU are made if it is not too late.
    """
    try:
        jax.config.update("jax_num_cpu_devices", count)
    except RuntimeError:  # too late
        pass
    devices = jax.local_devices()[:count]
    return Mesh(np.array(devices), (axis,)) if len(devices) > 1 else None


CACHE_BYTES = 2**30
"""Most that compiled code takes on disk; what was used longest ago goes first.  All commands of the
documentation take about 60 MB."""


def remember_compiled(folder: str | os.PathLike | None = None) -> Path | None:
    """Keep compiled code on disk, so that the next process does not compile it again.

    A first plan then starts in a third of the time.  It changes no result.

    Args:
      folder: where; None is $JSHAPE_CACHE, else `jshape` in the user's cache folder.  "off" keeps
        nothing, and JAX's own variable JAX_COMPILATION_CACHE_DIR wins.

    Returns:
      The folder; None where nothing is kept.
    """
    from platformdirs import user_cache_path

    folder = folder or os.environ.get("JSHAPE_CACHE")
    if str(folder) == "off" or os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return None
    # Code for one processor may not run on another that shares the folder.
    name = f"compiled-{hashlib.sha256(_processor().encode()).hexdigest()[:12]}"
    try:
        path = (Path(folder) if folder else user_cache_path("jshape")) / name
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # nowhere to keep it, or no home: compile each time
        return None
    if not os.access(path, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    # With a bound JAX locks the folder: of two commands neither reads the other's half file.
    jax.config.update("jax_compilation_cache_max_size", CACHE_BYTES)
    # A process that was killed while it wrote leaves code without the time of its last use, at
    # which every later bounded write would fail.
    kept = set(os.listdir(path))
    for code in kept:
        if code.endswith("-cache") and code.removesuffix("-cache") + "-atime" not in kept:
            (path / code).unlink(missing_ok=True)
    return path


def _processor() -> str:
    """What code is compiled for: the processor's features, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = [line for line in lines if line.startswith(("flags", "Features", "model name"))]
    return "\n".join([platform.machine(), platform.processor(), *dict.fromkeys(features)])


def cores() -> int:
    """Cores that this process may use; a container may have fewer than the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
