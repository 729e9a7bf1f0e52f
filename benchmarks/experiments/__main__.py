"""`python -m benchmarks.experiments NAME --out DIR`: measure again what the documentation says."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import console
from benchmarks.experiments import EXPERIMENTS, pages, report
from jshape.cli.tables import print_table, progress
from jshape.errors import JShapeError
from jshape.planning.devices import over_devices, remember_compiled

count = console.positive_count

OPTIONS: dict[str, dict[str, Any]] = {
    "kinds": {"nargs": "+", "metavar": "KIND", "help": "of banks: D P C CR DC DCR"},
    "sizes": {"nargs": "+", "type": count, "metavar": "N", "help": "pairs per action to fit to"},
    "actions": {"nargs": "+", "metavar": "ACTION", "help": "names (all of the data, or a few)"},
    "pairs": {"type": count, "help": "simulated per action and agent"},
    "partitions": {"type": count, "help": "of the pairs (4; quick: fewer)"},
    "width": {"type": count, "help": "of the networks (8; quick: 4)"},
    "epochs": {"type": count, "help": "of the networks (40; quick: 12)"},
}
"""Options that some experiments have, by the keyword of their `run`."""


def planning(options: argparse.Namespace) -> dict[str, Any]:
    """Planners against problems that nobody can game."""
    execution = over_devices(options.devices)  # first of all: what loads a bank starts JAX
    from benchmarks.experiments import planning as benchmark
    from benchmarks.experiments.planning_report import SETTINGS
    from benchmarks.experiments.planning_tables import tables

    kinds = options.kinds
    if kinds is None:
        recorded = options.data is not None and (options.data / "mpm").is_dir()
        kinds = benchmark.KINDS if recorded else benchmark.KINDS[:2]
    named = {"methods": options.methods, "kinds": kinds, "loops": options.loops}
    given: dict[str, Any] = {name: tuple(dict.fromkeys(n)) for name, n in named.items() if n}
    for name in ("problems", "max_steps", "seconds", "seed"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    usual = SETTINGS[True] if options.quick else benchmark.Settings()
    result = benchmark.run_planning(
        options.out,
        replace(usual, **given),
        data=options.data,
        overwrite=options.overwrite,
        execution=execution,
        say=_say(options),
        progress=progress,
    )
    if not options.json:
        for title, head, rows in tables(result["rows"]):
            print(f"\n{title}:")
            print_table(head, rows)
        for note in result["notes"]:
            print(f"\n{note}")
        print(f"\ntables, pictures and page: {options.out}")
    return result


def robot(options: argparse.Namespace) -> dict[str, Any]:
    """The paper's six goals, molded by a robot that looks."""
    from benchmarks.experiments.robot import run_robot

    say = _say(options)
    result = run_robot(
        options.out,
        arm=options.arm or ("sim" if options.quick else "mujoco"),
        bank_name=options.bank,
        seed=options.seed,
        quick=options.quick,
        overwrite=options.overwrite,
        say=say,
    )
    say(f"tables, pictures and page: {options.out}")
    return result


def twin(options: argparse.Namespace) -> dict[str, Any]:
    """Every action at every place in the physics twin."""
    from benchmarks.experiments.twin import QUICK, check_twin

    say, places = _say(options), QUICK if options.quick else {}
    result = check_twin(
        options.out, key=options.seed, overwrite=options.overwrite, say=say, **places
    )
    say((options.out / "report.md").read_text("utf-8"))
    return result


def one(options: argparse.Namespace) -> dict[str, Any]:
    """One of those that end in a page."""
    row, say = EXPERIMENTS[options.experiment], _say(options)
    given = {key: getattr(options, key) for key in row.options}
    given = {key: value for key, value in given.items() if value is not None}
    data = options.data if row.data else None
    if data is not None and "pairs" in given:
        raise JShapeError("--pairs: of the simulator; with --data nothing is simulated")
    result = report.run_one(
        options.experiment,
        options.out,
        data=data,
        quick=options.quick,
        seed=options.seed,
        overwrite=options.overwrite,
        say=say,
        progress=progress,
        **given,
    )
    for text in (*result["paragraphs"], *result["notes"]):
        say(f"\n{text}")
    say(f"\npage, tables and pictures: {options.out / pages.PAGE}")
    return result


def every(options: argparse.Namespace) -> dict[str, Any]:
    """Those that end in a page, and a page in front of them."""
    say = _say(options)
    result = report.run_all(
        options.out,
        names=options.only,
        data=options.data,
        quick=options.quick,
        seed=options.seed,
        overwrite=options.overwrite,
        say=say,
        progress=progress,
    )
    say(f"report: {options.out / report.PAGE}")
    return result


def _say(options: argparse.Namespace) -> Callable[[str], Any]:
    return (lambda line: None) if options.json else lambda line: print(line, flush=True)


def build_parser() -> argparse.ArgumentParser:
    """The experiments and their options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.experiments", description=__doc__)
    experiments = parser.add_subparsers(dest="experiment", metavar="NAME", required=True)

    def command(name: str, run: Callable, what: str, data: bool = False) -> Callable:
        added = experiments.add_parser(name, help=what, description=what)
        added.set_defaults(compute=run, run=_run)
        added.add_argument("--out", type=Path, required=True, help="folder for what is found")
        added.add_argument("--quick", action="store_true", help="few and small of everything")
        added.add_argument("--seed", type=console.seed, default=0, help="of everything random (0)")
        added.add_argument("--overwrite", action="store_true", help="replace an earlier result")
        added.add_argument("--json", action="store_true", help="print the result as JSON")
        if data:
            added.add_argument("--data", type=Path, help="a data set (default: simulated pairs)")
        return added.add_argument

    for name, row in EXPERIMENTS.items():
        if not row.own_command:
            add = command(name, one, row.what, row.data)
            for key in row.options:
                add(f"--{key}", **OPTIONS[key])

    add = command("planning", planning, EXPERIMENTS["planning"].what)
    add("--problems", type=count, help="of each kind (20; quick: 1)")
    add("--methods", nargs="+", metavar="METHOD", help="who takes part (all; quick: two)")
    add("--kinds", nargs="+", metavar="KIND", help="applied, shape, mpm (those that data has)")
    add("--loops", nargs="+", metavar="LOOP", help="open, closed (both; quick: closed)")
    add("--data", type=Path, help="folder that may hold real/ and mpm/")
    add("--max-steps", type=count, help="most actions (16; quick: 4)")
    add("--seconds", type=console.positive, help="for each plan (no limit)")
    add("--devices", type=count, help="CPU devices that share the work (one per core, at most 8)")

    add = command("robot", robot, EXPERIMENTS["robot"].what)
    add("--arm", choices=("mujoco", "sim"), help="(mujoco; quick: sim)")
    add("--bank", help="name or folder (default: the bundled one)")

    command("twin", twin, EXPERIMENTS["twin"].what)

    add = command("all", every, f"a report: {', '.join(EXPERIMENTS)}", True)
    add("--only", nargs="+", metavar="NAME", choices=EXPERIMENTS, help="these experiments only")
    return parser


def _run(options: argparse.Namespace) -> None:
    remember_compiled()
    result = options.compute(options)
    if options.json:
        print(json.dumps(result))


def main(words: Sequence[str] | None = None) -> int:
    """Run an experiment; returns the exit code."""
    words = sys.argv[1:] if words is None else words
    with pages.made_by([*report.PROGRAM, *words]):
        return console.run("experiments", build_parser(), words)


if __name__ == "__main__":
    sys.exit(main())
