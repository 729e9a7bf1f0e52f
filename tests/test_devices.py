"""Where compiled code is kept."""

import os
import subprocess
import sys

from jshape.devices import remember_compiled

PROGRAM = """
import sys, jax, jax.numpy as jnp
from jshape.devices import remember_compiled
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


def test_a_second_process_compiles_nothing_again_and_finds_the_same(tmp_path):
    first, second = _run(tmp_path), _run(tmp_path)
    assert first[0] == second[0] and first[1] == 0 < second[1]


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
