"""`make bench`: everything that has a number for its goal, in one run, on this machine."""

import argparse
import importlib
import json
import sys
import time
from pathlib import Path

from benchmarks import page
from benchmarks.report import BASELINE, Report

PARTS = {
    "start": "importing and starting",
    "distances": "d beside cv2.norm, NumPy, Chamfer, EMD, entropic transport and ICP",
    "ranking": "how well each distance ranks, and greedy on each of them",
    "planning": "sweeps, steps and plans",
    "authors": "plans beside the reference twin and the authors' way of computing them",
    "unet": "the U-Net beside PyTorch and ONNX Runtime",
    "simulator": "beds per second",
    "views": "height maps of beds seen from anywhere",
}
"""Modules of this folder with `run(report, out)`, in the order of the page: `out` takes figures."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench"), help="folder for the results")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--accept", action="store_true", help="make this run the baseline")
    parser.add_argument("--page", type=Path, help="also renew the tables of this Markdown page")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    report = Report()
    for name in options.only:
        report.part = name
        print(f"\n{name}: {PARTS[name]}", flush=True)
        start = time.perf_counter()
        importlib.import_module(f"benchmarks.{name}").run(report, options.out)
        report.seconds[name] = round(time.perf_counter() - start, 1)
    (options.out / "bench.json").write_text(report.text())
    print(f"\nwritten: {options.out / 'bench.json'} after {sum(report.seconds.values()):.0f} s")
    if options.page is not None:
        page.renew(options.page, report, options.out)
    baseline = json.loads(BASELINE.read_text()) if BASELINE.is_file() else {}
    if options.accept:
        BASELINE.write_text(json.dumps(report.accepted(baseline), indent=1) + "\n")
        return 0
    worse = report.worse(baseline)
    print("\n".join(["", "worse than the baseline:", *worse] if worse else ["as the baseline"]))
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
