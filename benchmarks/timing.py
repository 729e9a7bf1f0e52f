"""Time and report: the least of many runs, with goals as ratios where machines differ."""

import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import jax
import numpy as np


def seconds(call: Callable[[], Any], *, least: float = 0.5, repeats: int = 7) -> float:
    """Median over `repeats` rounds of the time per call, after two calls that compile and warm up.

    A round lasts about `least / repeats` seconds.  The median, since other work may run: the
    least of many would hide what waking threads costs every time.
    """
    jax.block_until_ready(call())
    start = time.perf_counter()
    jax.block_until_ready(call())
    once = max(time.perf_counter() - start, 1e-7)
    calls = max(1, round(least / repeats / once))
    rounds = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(calls):
            jax.block_until_ready(call())
        rounds.append((time.perf_counter() - start) / calls)
    return float(np.median(rounds))


@dataclass
class Report:
    """Rows of one benchmark run."""

    rows: list[dict[str, Any]] = field(default_factory=list)

    def add(
        self, name: str, value: float, unit: str, *, goal: float | None = None, more: bool = False
    ) -> float:
        """A measured value; `goal` is the most allowed, or the least if `more` is better."""
        met = None if goal is None else (value >= goal if more else value <= goal)
        self.rows.append({"name": name, "value": value, "unit": unit, "goal": goal, "met": met})
        sign = "" if goal is None else f"goal {'>=' if more else '<='} {goal:g}"
        mark = {None: "", True: "met", False: "MISSED"}[met]
        print(f"{name:58s} {value:10.4g} {unit:8s} {sign:16s} {mark}", flush=True)
        return value

    def text(self) -> str:
        """The rows with the machine and the versions, as JSON."""
        import cv2
        import jaxlib

        import jshape

        versions = {
            "python": platform.python_version(),
            "jax": jax.__version__,
            "jaxlib": jaxlib.__version__,
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "jshape": jshape.__version__,
        }
        machine = {"processor": _processor(), "cores": _cores()}
        content = asdict(self) | {"versions": versions, "machine": machine}
        return json.dumps(content, indent=1) + "\n"


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            lines = [line for line in file if line.startswith("model name")]
        return lines[0].split(":")[1].strip()
    except (OSError, IndexError):
        return platform.processor()


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
