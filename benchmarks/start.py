"""What starting costs, in new processes: importing, and the first plans without caches."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.report import Report

HELP = """
import contextlib, io
from jshape.cli.main import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(["--help"])
"""
PLANS = """
import json, time
import numpy as np
import jshape
from jshape import compiling

camera, compiled, found = jshape.PAPER_BOX, [], {}
compiling.listen(lambda: compiled.append(1))
v, u = np.mgrid[: camera.height, : camera.width]
now = np.full(camera.shape, 0.45)
goal = now + 0.012 * np.exp(-(((u - 240) / 60) ** 2) - ((v - 200) / 25) ** 2)
for name, options in {
    "first": {},
    "mask": {"reachable": u < 260},
    "grid": {"stride": 14},
    "strengths": {"strengths": (0.3, 0.8, 1.5)},
}.items():
    compiled.clear()
    start = time.perf_counter()
    jshape.plan_depth(now, goal, camera=camera, **jshape.options(**options))
    found[name] = time.perf_counter() - start, len(compiled)
print(json.dumps(found))
"""
"""A trench, planned with the defaults, then with another mask, grid and list of strengths."""


def run(report: Report, out: Path) -> None:
    """Seconds to import, less what starting Python takes: best of 3; and the first plans'."""

    def started(code: str) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    nothing = started("pass")
    report.add("import jshape", started("import jshape") - nothing, "s")
    report.add("from jshape import plan", started("from jshape import plan") - nothing, "s", goal=2)
    report.add("jshape --help", started(HELP) - nothing, "s")
    _plans(report)


def _plans(report: Report) -> None:
    """The first plan with the defaults, and others that compile nothing: best of 2."""
    alone = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    alone["JSHAPE_CACHE"] = "off"
    runs = [
        json.loads(
            subprocess.run(
                [sys.executable, "-c", PLANS], env=alone, check=True, stdout=subprocess.PIPE
            ).stdout
        )
        for _ in range(2)
    ]
    took = {name: min(one[name][0] for one in runs) for name in runs[0]}
    report.add("jshape.plan_depth, the first, after import", took.pop("first"), "s", goal=8)
    for name, value in took.items():
        report.add(f"the next, with another {name}", value, "s", goal=1)
    again = sum(one[name][1] for one in runs for name in took)
    assert again == 0, f"{again} functions were compiled for another mask, grid or strengths"
