"""`make bench`: everything that has a number for its goal, in one run, on this machine."""

import argparse
import subprocess
import sys
import time
from pathlib import Path

from benchmarks import distances, planning, simulator, unet
from benchmarks.timing import Report


def import_time() -> float:
    """Seconds to `import jshape` in a new process, less what starting Python takes: best of 3."""

    def run(code: str) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    return run("import jshape") - run("pass")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench"))
    out = parser.parse_args().out
    report = Report()
    report.add("import jshape", import_time(), "s", goal=2)
    for part in (distances, planning, simulator, unet):
        part.run(report)
    out.mkdir(parents=True, exist_ok=True)
    (out / "bench.json").write_text(report.text())
    print(f"written: {out / 'bench.json'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
