"""Shared fixtures.  Every annotated shape in jshape is checked while the tests run."""

import os
from pathlib import Path

import jax
import numpy as np
import pytest
from jaxtyping import install_import_hook

_hook = install_import_hook("jshape", "beartype.beartype")

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("JSHAPE_SHARED", ROOT.parent / "shared"))

jax.config.update("jax_debug_key_reuse", True)


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
