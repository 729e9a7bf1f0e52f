"""Renew the tables, figures and the machine's line of docs/benchmarks.md from a run.

The page is prose with places for what is measured: `<!-- bench: PART -->` ... `<!-- end -->`
takes the part's tables and numbers, `<!-- bench: machine -->` the machine, versions and date.
Figures that a part wrote into its folder are copied to `images/bench_NAME.png` beside the page.
"""

import re
import shutil
import time
from pathlib import Path

from benchmarks.report import Report, cores, markdown, processor, versions

PLACE = re.compile(r"(<!-- bench: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def renew(path: Path, report: Report, out: Path) -> None:
    """Write this run's numbers into the page; parts that were not run stay as they are.

    Raises:
      ValueError: the page has no place for a part that was run.
    """
    text = path.read_text()
    places = {name for _, name, _ in PLACE.findall(text)}
    measured = list(dict.fromkeys(row.part for row in report.rows))
    missing = [part for part in measured if part not in places]
    if missing:
        raise ValueError(f"{path}: no place for {', '.join(missing)}: <!-- bench: {missing[0]} -->")

    def fill(match: re.Match) -> str:
        first, name, last = match.groups()
        if name == "machine":  # of a run of all parts: one part's minutes would mislead
            return first + _machine(report) + last if places - {name} <= set(measured) else match[0]
        return first + _part(report, name) + last if name in measured else match.group(0)

    path.write_text(PLACE.sub(fill, text))
    for figure in sorted(out.glob("*.png")):
        shutil.copy(figure, path.parent / "images" / f"bench_{figure.name}")


def _machine(report: Report) -> str:
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    minutes = sum(report.seconds.values()) / 60
    return (
        f"{time.strftime('%d %B %Y')}, {cores()} cores of {processor()}, in {minutes:.0f} minutes; "
        f"{packages}.\n"
    )


def _part(report: Report, part: str) -> str:
    """Its tables, then its single numbers."""
    tables = [f"{t.name}\n\n{markdown(t.head, t.rows)}\n" for t in report.tables if t.part == part]
    rows = [
        (row.name, f"{row.value:.4g} {row.unit}", _goal(row.goal, row.more, row.met))
        for row in report.rows
        if row.part == part
    ]
    return "\n" + "".join(tables) + markdown(("measured", "value", "goal"), rows) + "\n"


def _goal(goal: float | None, more: bool, met: bool | None) -> str:
    if goal is None:
        return ""
    return f"{'≥' if more else '≤'} {goal:g}: {'met' if met else 'missed'}"
