"""What starting costs, in new processes: JAX is loaded only when a name needs it."""

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


def run(report: Report, out: Path) -> None:
    """Seconds to import, less what starting Python takes: best of 3."""

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
