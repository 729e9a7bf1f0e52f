"""Data-parallel training: the devices of a mesh share every batch.

Parameters are replicated, a slice of each batch is on each device, and gradients are summed.  The
sum over a batch is then made in another order, so losses and parameters differ from one device's by
float32's rounding, about 1e-7 of their size a step, and by what training makes of that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec


@dataclass(frozen=True)
class DataParallel:
    """Where the arrays of a training are."""

    mesh: Mesh | None = None
    """Of one axis; None is the one device that JAX takes by itself."""

    @property
    def count(self) -> int:
        """How many devices share a batch."""
        return 1 if self.mesh is None else self.mesh.size

    def replicate(self, tree: Any) -> Any:
        """Arrays, the same on all devices."""
        return self._placed(tree, PartitionSpec())

    def split(self, tree: Any) -> Any:
        """Arrays whose first axis is split over the devices; `count` divides its length."""
        return self._placed(tree, PartitionSpec(self.mesh and self.mesh.axis_names[0]))

    def summed(self, function: Callable) -> Callable:
        """The same function of (parameters, slice, slice), its results summed over the devices.

        Left to itself, XLA would sum each step of a loop inside, or bring the batch together.
        """
        if self.mesh is None:
            return function
        (axis,) = self.mesh.axis_names
        return jax.shard_map(
            lambda *args: jax.lax.psum(function(*args), axis),
            mesh=self.mesh,
            in_specs=(PartitionSpec(), PartitionSpec(axis), PartitionSpec(axis)),
            out_specs=PartitionSpec(),
            check_vma=False,  # otherwise gradients inside are summed, and then once more here
        )

    def gather(self, tree: Any) -> Any:
        """Replicated arrays, on the one device that JAX takes by itself."""
        if self.mesh is None:
            return tree
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)

    def _placed(self, tree: Any, spec: PartitionSpec) -> Any:
        if self.mesh is None:
            return jax.tree.map(jnp.asarray, tree)
        return jax.device_put(tree, NamedSharding(self.mesh, spec))


ALONE = DataParallel()
"""On one device."""
