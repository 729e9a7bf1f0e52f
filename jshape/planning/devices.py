"""What computations run on, chosen in this one place: devices, and where compiled code is kept."""

import hashlib
import os
import platform
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from jax.sharding import Mesh

NODES = 2**24
"""Nodes of windows that an accelerator evaluates together, at most: some times what it has threads
for."""
NODE_BYTES = 2048
"""Memory that each of them may take: 512 numbers, the features of a U-Net."""
GOALS = 256
"""Searches that an accelerator makes together, at most."""


@dataclass(frozen=True)
class Execution:
    """How candidates are evaluated (static).  Changes no result, only memory and time."""

    chunk: int | None = None
    """Nodes of windows that are evaluated together, by `vmap` over places and strengths; 0: one
    place after the other; None: 0 on a CPU, else as much as the device's memory holds."""
    mesh: Mesh | None = None
    """Devices that share the places; None is one."""

    @property
    def nodes(self) -> int:
        """The chunk, chosen where it is not given."""
        if self.chunk is not None:
            return self.chunk
        memory = accelerator_memory()
        return 0 if memory is None else min(memory // NODE_BYTES, NODES)


def accelerator_memory() -> int | None:
    """Bytes of memory of the accelerator that JAX uses, 8 GiB if it does not say; None: a CPU."""
    if jax.default_backend() == "cpu":
        return None
    return (jax.local_devices()[0].memory_stats() or {}).get("bytes_limit", 2**33)


def goals_together(search_bytes: int, count: int) -> int:
    """How many searches of so many bytes each are made in one vmapped call: 1 on a CPU.

    Else a power of two, up to what holds all `count` of them, so that few sizes are compiled.
    """
    memory = accelerator_memory()
    if memory is None:
        return 1
    fit = max(min(memory // 4 // search_bytes, GOALS), 1)
    return min(2 ** (fit.bit_length() - 1), 2 ** (count - 1).bit_length())


def over_devices(count: int | None = None) -> Execution:
    """How to share candidates over devices: accelerators, or devices that are made of the CPU.

    Call it before anything is computed: JAX makes its devices then.  Afterwards it is too late for
    more, and those that are there are used.  It changes no result.

    Args:
      count: at most so many; None is every accelerator, or the CPU as one device, all cores of
        which a search uses by itself: more devices are as fast, and all is compiled twice.
    """
    if count is None:
        count = 1 if jax.default_backend() == "cpu" else jax.local_device_count()
    return Execution(mesh=mesh_of(count, "places"))


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
