"""Peak memory of one comparison, above what its inputs take: each in a process of its own.

The kernel counts a process's most resident pages and starts anew when 5 is written to
`clear_refs` (Linux only): so the C++ of the trees and the network simplex is seen too.  What fits
into memory that the process has already is not; of that NumPy's share is asked of `tracemalloc`.
"""

import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks import clouds
from jshape import metric

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
CALLS = {
    "d": metric.distance,
    "Chamfer (pykdtree)": lambda p, q: clouds.chamfer(p, q, "pykdtree"),
    "ICP (pykdtree)": lambda p, q: clouds.icp(p, q, "pykdtree"),
    "EMD (pot)": lambda p, q: clouds.emd(p, q, "pot"),
}


def available() -> bool:
    """Whether this system tells."""
    return CLEAR.exists()


def peak_bytes(method: str, first: np.ndarray, second: np.ndarray) -> int:
    """Most bytes that a call took beside its inputs, two images or two clouds."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_peak, method, first, second).result()


def _peak(method: str, first: np.ndarray, second: np.ndarray) -> int:
    call = CALLS[method]
    call(first[:8, :8].copy(), second[:8, :8].copy())  # loads its modules
    CLEAR.write_text("5")
    before = _status("VmRSS")
    call(first, second)
    resident = _status("VmHWM") - before
    tracemalloc.start()
    call(first, second)
    return max(resident, tracemalloc.get_traced_memory()[1])


def _status(name: str) -> int:
    line = next(x for x in STATUS.read_text().splitlines() if x.startswith(name))
    return 1024 * int(line.split()[1])
