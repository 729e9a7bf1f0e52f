"""Devices that share the batches of a training (data parallel).

Parameters are on all of them, a slice of each batch is on each, and their slopes are added up.  The
sum over a batch is then made in another order, so losses and parameters differ from one device's by
float32's rounding, about 1e-7 of their size a step, and by what training makes of that.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jshape.errors import JShapeError


@dataclass(frozen=True)
class Devices:
    """Where the arrays of a training are."""

    mesh: Mesh | None = None
    """Of one axis; None is the one device that JAX takes by itself."""

    @property
    def count(self) -> int:
        """How many devices share a batch."""
        return 1 if self.mesh is None else self.mesh.size

    def everywhere(self, tree: Any) -> Any:
        """Arrays, the same on all devices."""
        return self._placed(tree, PartitionSpec())

    def divided(self, tree: Any) -> Any:
        """Arrays whose first axis is split over the devices; `count` divides its length."""
        return self._placed(tree, PartitionSpec(self.mesh and self.mesh.axis_names[0]))

    def added_up(self, function: Callable) -> Callable:
        """The same function of (parameters, slice, slice), its results added up over the devices.

        Left to itself, XLA would add up each step of a loop inside, or bring the batch together.
        """
        if self.mesh is None:
            return function
        (axis,) = self.mesh.axis_names
        return jax.shard_map(
            lambda *args: jax.lax.psum(function(*args), axis),
            mesh=self.mesh,
            in_specs=(PartitionSpec(), PartitionSpec(axis), PartitionSpec(axis)),
            out_specs=PartitionSpec(),
            check_vma=False,  # otherwise slopes inside are added up, and then once more here
        )

    def back(self, tree: Any) -> Any:
        """Arrays that are the same on all devices, on the one that JAX takes by itself."""
        if self.mesh is None:
            return tree
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)

    def agree(self, what: str) -> None:
        """Refuse processes that are about to train something else: they would wait for each other.

        Args:
          what: it is that they train, in as many characters in all of them.

        Raises:
          JShapeError: it is not the same in all of them, or one of them has stopped.
        """
        if self.mesh is None or not self.mesh.is_multi_process:
            return
        from jax.experimental import multihost_utils

        text = np.frombuffer(what.encode(), np.uint8)
        try:
            theirs = np.asarray(multihost_utils.process_allgather(text))
        except jax.errors.JaxRuntimeError:
            raise JShapeError("another process has stopped; see what it says") from None
        other = np.flatnonzero((theirs != theirs[0]).any(1))
        if len(other):
            raise JShapeError(
                f"process {other[0]} has other pairs, settings or checkpoints than process 0; all "
                "need the same files"
            )

    def _placed(self, tree: Any, spec: PartitionSpec) -> Any:
        if self.mesh is None:
            return jax.tree.map(jnp.asarray, tree)
        sharding = NamedSharding(self.mesh, spec)

        def place(leaf: Any) -> jax.Array:
            whole = np.asarray(leaf)  # every process has it, and gives its own devices their part
            return jax.make_array_from_callback(whole.shape, sharding, lambda part: whole[part])

        return jax.tree.map(place, tree)


_mesh: ContextVar[Mesh | None] = ContextVar("mesh", default=None)


@contextmanager
def shared_over(mesh: Mesh | None) -> Iterator[None]:
    """Let the trainings inside share every batch over a mesh, as `devices.mesh_of` makes it.

    Args:
      mesh: of one axis; None is no sharing.
    """
    token = _mesh.set(mesh)
    try:
        yield
    finally:
        _mesh.reset(token)


def current() -> Devices:
    """What `shared_over` says here."""
    return Devices(_mesh.get())
