"""Shared fixtures.  Every annotated shape in jshape is checked while the tests run."""

import gc
import os
import tempfile
from pathlib import Path

# All processes of the tests compile once what many of them run, and leave the user's folders alone.
# Workers have the variables from the process that starts them; CI sets the folder for all sets.
_compiled = tempfile.TemporaryDirectory(prefix="jshape-tests-", ignore_cleanup_errors=True)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _compiled.name)
os.environ["JAX_COMPILATION_CACHE_MAX_SIZE"] = str(2**30)  # with a bound JAX locks the folder
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
os.environ["JSHAPE_CACHE"] = os.environ["JAX_COMPILATION_CACHE_DIR"]
os.environ.setdefault("JSHAPE_CONFIG", "off")

import jax  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

_hook = install_import_hook("jshape", "beartype.beartype")

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("JSHAPE_SHARED", ROOT.parent / "shared"))

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

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
