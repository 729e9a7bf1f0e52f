"""What starting costs: `import jshape` in a new process."""

import subprocess
import sys
import time
from pathlib import Path

from benchmarks.report import Report


def run(report: Report, out: Path) -> None:
    """Seconds to import, less what starting Python takes: best of 3."""

    def started(code: str) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    report.add("import jshape", started("import jshape") - started("pass"), "s", goal=2)
