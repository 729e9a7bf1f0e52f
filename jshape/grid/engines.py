"""What runs many independent tasks: this process, one after the other, or Ray on many cores.

An engine takes a function of a module, what all tasks share, and the tasks; it gives (number of
the task, result) as they are finished.  What a task computes depends on neither the engine nor the
order.  Results come back to the process that asked for them, which alone writes files: machines
need no common disk.
"""

import os
import platform
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax

import jshape
from jshape.errors import JShapeError
from jshape.planning.devices import cores, remember_compiled

Work = Callable[[Any, Any], Any]
"""(what all tasks share, one task) -> its result."""
Engine = Callable[[Work, Any, Sequence[Any]], Iterator[tuple[int, Any]]]


def here(work: Work, shared: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """One task after the other, in this process."""
    for number, task in enumerate(tasks):
        yield number, work(shared, task)


@dataclass(frozen=True)
class OnRay:
    """Tasks on Ray's workers, each with its own cores: on this machine, or on a cluster.

    What all tasks share goes through Ray's object store, once to each machine.  A task whose
    worker is lost is run again on another.

    Raises:
      JShapeError: when run: Ray is not installed, the cluster does not answer or is lost, its
        machines have other versions, or this machine has fewer cores than a task needs.
    """

    address: str | None = None
    """Of a cluster: "auto" (this machine is part of it), "HOST:6379" or "ray://HOST:10001".  None:
    $RAY_ADDRESS, which Ray sets for its jobs; without it, cores of this machine."""
    cpus: int = 1
    """Cores of each task."""

    def __call__(self, work: Work, shared: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Run the tasks; those that are not finished when the caller stops are given up."""
        ray = _ray()
        if not tasks:
            return
        running: dict[Any, int] = {}
        started = self._connect(ray)
        try:
            remote = ray.remote(_task).options(
                num_cpus=self.cpus,
                # Each worker would otherwise start a thread per core of its machine.
                runtime_env={"env_vars": {"NPROC": str(self.cpus)}},
            )
            stored, waiting = ray.put(shared), list(enumerate(tasks))[::-1]
            while waiting or running:
                # Few in flight: results wait in the object store until they are taken.
                while waiting and len(running) < 2 * self._places(ray):
                    number, task = waiting.pop()
                    running[remote.remote(work, _versions(), stored, task)] = number
                (done,), _ = ray.wait(list(running))
                yield running.pop(done), ray.get(done)
        except ray.exceptions.RayTaskError as problem:
            if "failed to import on the worker" in str(problem):
                raise JShapeError("Ray's workers cannot import jshape: install it there") from None
            raise problem.cause or problem from None
        except ray.exceptions.RayError as problem:
            raise JShapeError(f"Ray gave up: {_first_line(problem)}") from None
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if started:
                ray.shutdown()

    def _connect(self, ray: Any) -> bool:
        """Whether Ray was started or joined here, and is to be left in the end."""
        if ray.is_initialized():
            return False
        address = self.address or os.environ.get("RAY_ADDRESS") or "local"
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if address == "local":
            if self.cpus > cores():
                raise JShapeError(f"{self.cpus} cores a task; this machine has {cores()}")
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nobody is told
            with forking():
                ray.init(address, num_cpus=cores(), include_dashboard=False, **quiet)
            return True
        try:
            with forking():
                ray.init(address, **quiet)
        except (OSError, RuntimeError, ValueError) as problem:
            raise JShapeError(f"no Ray cluster at {address}: {_first_line(problem)}") from None
        return True

    def _places(self, ray: Any) -> int:
        """Tasks that can run at once, on the machines that are there now."""
        return max(1, int(ray.cluster_resources().get("CPU", 1) // self.cpus))


@contextmanager
def forking() -> Iterator[None]:
    """Without JAX's warning of forks: Ray's processes are other programs at once."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
        yield


def _task(work: Work, versions: dict[str, str], shared: Any, task: Any) -> Any:
    """What a worker does."""
    for name, version in _versions().items():
        if version != versions[name]:
            raise JShapeError(
                f"the machine {platform.node()} has {name} {version}, this one {versions[name]}; "
                "results would differ: install the same everywhere"
            )
    remember_compiled()
    return work(shared, task)


def _versions() -> dict[str, str]:
    return {"jshape": jshape.__version__, "jax": jax.__version__}


def _ray() -> Any:
    try:
        import ray
        import ray.exceptions
    except ImportError:
        raise JShapeError("the engine ray needs Ray: pip install 'jshape[grid]'") from None
    return ray


def _first_line(problem: Exception) -> str:
    return (str(problem).strip().splitlines() or [type(problem).__name__])[0]
