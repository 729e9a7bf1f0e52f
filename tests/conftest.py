"""Shared fixtures.  Every annotated shape in jshape is checked while the tests run."""

import gc
import os
import tempfile
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

_hook = install_import_hook("jshape", "beartype.beartype")

# Workers and commands compile once what many of them run, and leave the user's folders alone.
# Workers have the variable from the process that starts them; CI sets it, for both sets of tests.
if "JSHAPE_CACHE" not in os.environ:
    _compiled = tempfile.TemporaryDirectory(prefix="jshape-tests-", ignore_cleanup_errors=True)
    os.environ["JSHAPE_CACHE"] = _compiled.name
os.environ.setdefault("JSHAPE_CONFIG", "off")

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("JSHAPE_SHARED", ROOT.parent / "shared"))

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

from jshape.planning.devices import remember_compiled  # noqa: E402

remember_compiled()

settings.register_profile("shared", deadline=None)  # other programs may hold the processor
settings.load_profile("shared")


@pytest.fixture(autouse=True, scope="module")
def room_for_compiled_code():
    """Let go of compiled code in time: Linux gives a process 65,530 memory maps, each compiled
    function takes several, and a process that ran all tests crashed in LLVM at the end."""
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > 30_000:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def rng():
    """A NumPy generator with a fixed seed."""
    return np.random.default_rng(7)


@pytest.fixture
def shared_data():
    """The folder of measured and independently simulated material, or skip."""
    if not (SHARED / "data").is_dir():
        pytest.skip("shared data are not here (set JSHAPE_SHARED to the folder that holds data/)")
    return SHARED / "data"


@pytest.fixture(scope="session")
def bank():
    """A bank for the paper's box with two smooth craters: quick, and easy to reason about."""
    from jshape import PAPER_BOX
    from jshape.models.bank import Bank
    from jshape.models.difference import Difference

    def crater(w, h, depth):
        x, y = (np.linspace(-2, 2, n) for n in (w, h))
        return Difference(jax.numpy.asarray(-depth * np.exp(-(x**2) - y[:, None] ** 2), "float32"))

    return Bank(PAPER_BOX, (crater(100, 80, 0.2), crater(40, 45, 0.3)), ("knock", "poke"))


@pytest.fixture
def molded(bank):
    """(I0, I*, actions): a flat image, and the same after three actions of the bank."""
    now = np.full(bank.camera.shape, 0.5, np.float32)
    goal, applied = now.copy(), [("knock", 91, 92), ("poke", 239, 197), ("knock", 387, 302)]
    for name, u, v in applied:
        w, h = bank.roi(name)
        window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
        goal[window] = bank.predict(name, goal[window])
    return now, goal, applied


def paper(**fields):
    """Keywords of `plan`: the paper's search but for some fields, with whichever bank."""
    from jshape import PAPER, options

    return {name: one for name, one in options(PAPER, **fields).items() if name != "bank"}


def mm(d):
    """A distance d of the paper's box in mm."""
    from jshape import PAPER_BOX, to_mm

    return float(to_mm(d, PAPER_BOX))
