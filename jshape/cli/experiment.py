"""`jshape experiment NAME`: what was measured for the documentation, to be measured again."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.experiments import EXPERIMENTS
from jshape.cli import arguments
from jshape.cli.tables import print_table, progress
from jshape.errors import JShapeError
from jshape.planning.devices import over_devices


def planning(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape experiment planning`: planners against problems that nobody can game."""
    how = over_devices(options.devices)  # first of all: what loads a bank starts JAX
    from benchmarks.experiments import planning as benchmark
    from benchmarks.experiments.planning_report import SETTINGS
    from jshape.viz.planning import tables

    kinds = options.kinds
    if kinds is None:
        recorded = options.data is not None and (options.data / "mpm").is_dir()
        kinds = benchmark.KINDS if recorded else benchmark.KINDS[:2]
    named = {"entries": options.entries, "kinds": kinds, "loops": options.loops}
    given: dict[str, Any] = {name: tuple(dict.fromkeys(n)) for name, n in named.items() if n}
    for name in ("problems", "max_steps", "seconds", "seed"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    usual = SETTINGS[True] if options.quick else benchmark.Settings()
    settings = replace(usual, **given)
    result = benchmark.run_planning(
        options.out,
        settings,
        data=options.data,
        overwrite=options.overwrite,
        how=how,
        say=(lambda line: None) if options.json else lambda line: print(line, flush=True),
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
    """`jshape experiment robot`: the paper's six goals, molded by a robot that looks."""
    from benchmarks.experiments.robot import run_robot

    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    arm = options.arm or ("sim" if options.quick else "mujoco")
    result = run_robot(
        options.out, arm=arm, bank_name=options.bank, seed=options.seed,
        quick=options.quick, overwrite=options.overwrite, say=say,
    )  # fmt: skip
    say(f"tables, pictures and page: {options.out}")
    return result


def twin(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape experiment twin`: every action at every place in the physics twin."""
    from benchmarks.experiments.twin import QUICK, check_twin

    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    places = QUICK if options.quick else {}
    result = check_twin(
        options.out, key=options.seed, overwrite=options.overwrite, say=say, **places
    )
    say((options.out / "report.md").read_text("utf-8"))
    return result


# Options that some experiments have, by the keyword of their `run`.
OPTIONS: dict[str, dict[str, Any]] = {
    "kinds": {"nargs": "+", "metavar": "KIND", "help": "of banks: D P C CR DC DCR"},
    "sizes": {
        "nargs": "+", "type": arguments.positive_count, "metavar": "N",
        "help": "pairs per action to fit to (5 10 25 50 75)",
    },
    "actions": {"nargs": "+", "metavar": "ACTION", "help": "names (all of the data, or a few)"},
    "pairs": {"type": arguments.positive_count, "help": "simulated per action and agent"},
    "partitions": {"type": arguments.positive_count, "help": "of the pairs (4; quick: fewer)"},
    "width": {"type": arguments.positive_count, "help": "of the networks (8; quick: 4)"},
    "epochs": {"type": arguments.positive_count, "help": "of the networks (40; quick: 12)"},
}  # fmt: skip


def with_page(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape experiment NAME`: one of those that end in a page."""
    from benchmarks.experiments.pages import PAGE
    from benchmarks.experiments.report import run_one

    name = options.subcommand
    given = {key: getattr(options, key) for key in EXPERIMENTS[name].options}
    given = {key: value for key, value in given.items() if value is not None}
    data = options.data if EXPERIMENTS[name].data else None
    if data is not None and "pairs" in given:
        raise JShapeError("--pairs: of the simulator; with --data nothing is simulated")
    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    result = run_one(
        name, options.out, data=data, quick=options.quick, seed=options.seed,
        overwrite=options.overwrite, say=say, progress=progress, **given,
    )  # fmt: skip
    for text in (*result["paragraphs"], *result["notes"]):
        say(f"\n{text}")
    say(f"\npage, tables and pictures: {options.out / PAGE}")
    return result


def every(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape experiment all`: those that end in a page, and a page in front of them."""
    from benchmarks.experiments.report import PAGE, run_all

    say = (lambda line: None) if options.json else lambda line: print(line, flush=True)
    result = run_all(
        options.out, names=options.only, data=options.data, quick=options.quick,
        seed=options.seed, overwrite=options.overwrite, say=say, progress=progress,
    )  # fmt: skip
    say(f"report: {options.out / PAGE}")
    return result


def _add_pages(experiments: Any) -> None:
    """The parsers of the experiments that end in a page, and of all of them."""
    for name, entry in EXPERIMENTS.items():
        if entry.own_command:
            continue
        parser = arguments.command(experiments, name, with_page, entry.what)
        _add_common(parser, entry.data)
        for key in entry.options:
            parser.add_argument(f"--{key}", default=None, **OPTIONS[key])
    parser = arguments.command(experiments, "all", every, f"a report: {', '.join(EXPERIMENTS)}")
    _add_common(parser, True)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these experiments only")


def _add_common(parser: argparse.ArgumentParser, data: bool) -> None:
    parser.add_argument("--out", type=Path, required=True, help="folder for the page")
    _add_quick(parser)
    parser.add_argument("--seed", type=arguments.seed, default=0, help="of everything random")
    if data:
        parser.add_argument("--data", type=Path, help="a data set (default: simulated pairs)")


def _add_quick(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="few and small of everything")


def add(commands: Any) -> None:
    """The parser of `jshape experiment`."""
    experiment = commands.add_parser(
        "experiment", help="measure the metric, predictors, planners and the robot's twin"
    )
    experiment.set_defaults(help_of=experiment)
    experiments = experiment.add_subparsers(
        dest="subcommand", metavar="WHAT", parser_class=arguments.Parser
    )
    parser = arguments.command(
        experiments,
        "planning",
        planning,
        "planners on goals that another hand or no action made; goes on where it was stopped",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for runs and tables")
    _add_quick(parser)
    parser.add_argument(
        "--problems", type=arguments.positive_count, help="of each kind (default: 20; quick: 1)"
    )
    parser.add_argument(
        "--entries", nargs="+", metavar="ENTRY", help="who takes part (all; quick: two)"
    )
    parser.add_argument(
        "--kinds", nargs="+", metavar="KIND",
        help="applied, shape, mpm (default: the first two, and mpm where --data has it)",
    )  # fmt: skip
    parser.add_argument(
        "--loops", nargs="+", metavar="LOOP", help="open, closed (both; quick: closed)"
    )
    parser.add_argument("--data", type=Path, help="folder that may hold real/ and mpm/")
    parser.add_argument("--seed", type=arguments.seed, default=0, help="other problems")
    parser.add_argument(
        "--max-steps", type=arguments.positive_count, help="most actions (default: 16; quick: 4)"
    )
    arguments.add_devices(parser)
    parser.add_argument("--seconds", type=arguments.positive, help="for each plan (no limit)")

    parser = arguments.command(
        experiments, "robot", robot, "the paper's six robot problems, in the physics twin"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for runs and tables")
    _add_quick(parser)
    parser.add_argument("--arm", choices=("mujoco", "sim"), help="(mujoco; quick: sim)")
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument("--seed", type=arguments.seed, default=0, help="other problems")

    parser = arguments.command(
        experiments, "twin", twin, "grasp, knock and poke at 15 places: collisions, place errors"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the tables")
    _add_quick(parser)
    parser.add_argument("--seed", type=arguments.seed, default=0, help="another bed")
    _add_pages(experiments)
