"""Time of a call: medians, and two calls in turns where one is divided by the other."""

import time
from collections.abc import Callable
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


def in_turns(
    calls: dict[str, Callable[[], Any]],
    *,
    least: float = 0.5,
    rounds: int = 5,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median seconds of each call, measured in rounds that take turns.

    What is divided by each other must be measured beside each other: other work on the machine
    then slows all of them.  `least` is seconds for each call over all rounds, on the wall; `clock`
    may be `time.process_time`: of all cores, and other work then counts only by what it evicts.
    """
    counts = {}
    for name, call in calls.items():
        jax.block_until_ready(call())
        start = time.perf_counter()
        jax.block_until_ready(call())
        once = max(time.perf_counter() - start, 1e-7)
        counts[name] = max(1, round(least / rounds / once))
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            for _ in range(counts[name]):
                jax.block_until_ready(call())
            times[name].append((clock() - start) / counts[name])
    return {name: float(np.median(taken)) for name, taken in times.items()}
