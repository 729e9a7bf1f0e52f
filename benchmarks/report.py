"""What a run measured: rows with unit, direction and goal, against the committed baseline."""

import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

BASELINE = Path(__file__).parent / "baseline.json"
"""What does not depend on the machine (counts, ratios, memory), as it was last accepted."""
PACKAGES = (
    *("jax", "jaxlib", "numpy", "scipy", "opencv-python-headless", "pykdtree", "pot"),
    *("torch", "onnxruntime", "jshape"),
)


@dataclass(frozen=True)
class Row:
    """One number."""

    part: str
    name: str
    value: float
    unit: str
    more: bool = False
    """More is better; else less."""
    goal: float | None = None
    """The most allowed, or the least if `more`."""
    tolerance: float | None = None
    """How many times worse than the baseline it may be; None: it depends on the machine."""

    @property
    def met(self) -> bool | None:
        """Whether it meets its goal; None without one."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.more else self.value <= self.goal


@dataclass(frozen=True)
class Table:
    """Rows for people, kept for the page."""

    part: str
    name: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass
class Report:
    """Rows and tables of one run, printed as they come."""

    part: str = ""
    """Where the next rows belong; `run` sets it."""
    rows: list[Row] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def add(
        self,
        name: str,
        value: float,
        unit: str,
        *,
        goal: float | None = None,
        more: bool = False,
        tolerance: float | None = None,
    ) -> float:
        """A measured value; with a `tolerance` (at least 1) it is held against the baseline."""
        row = Row(self.part, name, float(value), unit, more, goal, tolerance)
        if any((r.part, r.name) == (row.part, row.name) for r in self.rows):
            raise ValueError(f"{self.part}: {name!r} is measured twice")
        self.rows.append(row)
        sign = "" if goal is None else f"goal {'>=' if more else '<='} {goal:g}"
        mark = {None: "", True: "met", False: "MISSED"}[row.met]
        print(f"{name:66s} {value:10.4g} {unit:8s} {sign:16s} {mark}", flush=True)
        return row.value

    def table(self, name: str, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """A table of the page, printed too; numbers come formatted."""
        lines = tuple(tuple(str(cell) for cell in row) for row in rows)
        self.tables.append(Table(self.part, name, tuple(head), lines))
        print("\n" + markdown(head, lines), flush=True)

    def worse(self, baseline: Mapping[str, Any]) -> list[str]:
        """What is worse than the baseline by more than its tolerance, or missing in it, in words.

        Only parts that were run are looked at.
        """
        found, here = [], {r.part for r in self.rows}
        rows = {f"{r.part}: {r.name}": r for r in self.rows if r.tolerance is not None}
        for name, row in rows.items():
            if name not in baseline:
                found.append(f"{name}: not in the baseline (--accept adds it)")
                continue
            before = baseline[name]["value"]
            # Of counts that may be zero any growth is worse.
            worst = before / row.tolerance if row.more else before * row.tolerance
            if (row.value < worst) if row.more else (row.value > worst):
                found.append(
                    f"{name}: {row.value:.4g} {row.unit}, was {before:.4g}, "
                    f"allowed {'>=' if row.more else '<='} {worst:.4g}"
                )
        gone = (n for n in baseline if n.split(": ")[0] in here and n not in rows)
        return [*found, *(f"{name}: in the baseline, and no more measured" for name in gone)]

    def accepted(self, baseline: Mapping[str, Any]) -> dict[str, Any]:
        """A new baseline: this run's rows in place of those of the same parts."""
        here = {r.part for r in self.rows}
        kept = {n: row for n, row in baseline.items() if n.split(": ")[0] not in here}
        for r in self.rows:
            if r.tolerance is not None:
                kept[f"{r.part}: {r.name}"] = {
                    "value": r.value if r.value.is_integer() else float(f"{r.value:.4g}"),
                    "unit": r.unit,
                    "better": "more" if r.more else "less",
                    "tolerance": r.tolerance,
                }
        return dict(sorted(kept.items()))

    def text(self) -> str:
        """The rows and tables with the machine, the versions and the date, as JSON."""
        content = asdict(self) | {
            "versions": {"python": platform.python_version()} | versions(),
            "machine": {"processor": processor(), "cores": cores()},
            "date": time.strftime("%Y-%m-%d"),
        }
        content["rows"] = [asdict(row) | {"met": row.met} for row in self.rows]
        return json.dumps(content, indent=1) + "\n"


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def versions() -> dict[str, str]:
    """Versions of the packages that a comparison depends on, where they are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """The processor's name."""
    try:
        with open("/proc/cpuinfo") as file:
            lines = [line for line in file if line.startswith("model name")]
        return lines[0].split(":")[1].strip()
    except (OSError, IndexError):
        return platform.processor()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
