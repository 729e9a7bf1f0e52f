"""Where compiled code is kept, and that people hear of compiling."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from jshape import compiling
from jshape.planning.devices import remember_compiled

PROGRAM = """
import sys, jax, jax.numpy as jnp
from jshape.planning.devices import remember_compiled
assert str(remember_compiled(sys.argv[1])).startswith(sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
hits = []
jax.monitoring.register_event_listener(lambda name, **more: hits.append(name))
print(float(jax.jit(lambda x: jnp.sin(x).sum())(jnp.arange(3.0))))
print(sum(name.endswith("/cache_hits") for name in hits))
"""


def _run(folder):
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    command = [sys.executable, "-c", PROGRAM, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    value, hits = done.stdout.split()
    return value, int(hits)


@pytest.mark.full
def test_a_second_process_compiles_nothing_again_and_finds_the_same(tmp_path):
    first, second = _run(tmp_path), _run(tmp_path)
    assert first[0] == second[0] and first[1] == 0 < second[1]
    for used in tmp_path.rglob("*-atime"):
        used.unlink()  # as of a process that was killed while it wrote
    assert _run(tmp_path) == first


def test_nothing_is_kept_where_it_is_not_wanted_or_possible(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    assert remember_compiled("off") is None
    (tmp_path / "file").write_text("")
    assert remember_compiled(tmp_path / "file") is None
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    assert remember_compiled(tmp_path) is None
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("JSHAPE_CACHE", "off")
    assert remember_compiled() is None


def test_compiling_is_noticed(monkeypatch):
    now, told = [10.0], []
    wait = compiling._Wait()
    wait.callbacks.append(lambda: told.append(now[0]))
    monkeypatch.setattr(compiling, "_wait", wait)
    monkeypatch.setattr(compiling.time, "monotonic", lambda: now[0])

    def at(time, event, seconds):
        now[0] = time
        wait.note(f"/jax/{event}", seconds)

    assert compiling.seconds() is None
    at(10.0, "core/compile/jaxpr_trace_duration", 2.0)
    at(11.0, "core/compile/jaxpr_to_mlir_module_duration", 1.0)
    now[0] = 60.0
    assert compiling.seconds() == 52.0 and not told
    at(61.0, "core/compile/backend_compile_duration", 50.0)
    assert compiling.seconds() is None and told == [61.0]
    at(61.5, "core/compile/jaxpr_trace_duration", 0.1)  # soon after: the same wait
    assert compiling.seconds() == 53.5
    now[0] += compiling.MOST  # of a trace that nothing follows
    assert compiling.seconds() is None
    at(99.0, "checkpoint/write_duration", 9.0)
    assert compiling.seconds() is None


def test_what_jax_compiles_is_told():
    told = []
    compiling.listen(lambda: told.append(1))
    jax.jit(lambda x: x * 3.21 + 17)(jnp.arange(5.0)).block_until_ready()
    assert told and compiling.seconds() is None
