"""The devices that candidates are shared over, chosen in this one place."""

import os

import jax
import numpy as np
from jax.sharding import Mesh

from jshape.predict.sweep import ONE_BY_ONE, How

MOST = 8
"""Devices made unless more are asked for: small sweeps gain nothing from more."""


def over_devices(count: int | None = None) -> How:
    """How to share candidates over devices: cores of the CPU, each a device, unless JAX has a GPU.

    Call it before anything is computed: JAX makes its devices then.  Afterwards it is too late for
    more, and those that are there are used.  It changes no result.

    Args:
      count: at most so many; None is as many as this process has cores, at most `MOST`.
    """
    if count is None:
        count = min(_cores(), MOST)
    try:
        jax.config.update("jax_num_cpu_devices", count)
    except RuntimeError:  # too late
        pass
    devices = jax.devices()[:count]
    return How(mesh=Mesh(np.array(devices), ("places",))) if len(devices) > 1 else ONE_BY_ONE


def _cores() -> int:
    """Cores that this process may use; a container may have fewer than the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
