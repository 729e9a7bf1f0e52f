"""`jshape grid train` and `jshape grid simulate`: work in independent pieces, here or on Ray."""

import argparse
import sys
from pathlib import Path
from typing import Any

from jshape.cli import COMMANDS, arguments
from jshape.cli.tables import print_table, progress
from jshape.errors import JShapeError
from jshape.io import datasets

LEARNING = ("width", "epochs", "batch", "learning_rate", "patience", "validation")
"""Options of training that make sense here; a cell that is not finished is begun again."""


def train(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape grid train DATASET --out DIR`."""
    engine = _engine(options)
    from jshape.grid import grid as grids
    from jshape.learn import scores as drawn

    given = {name: getattr(options, name) for name in (*LEARNING, "morphology")}
    grid = grids.Grid(
        datasets.load_pairs(options.dataset),
        tuple(options.kinds),
        tuple(options.agents or ()),
        tuple(options.actions or ()),
        options.partitions,
        seed=options.seed,
        options={k: v for k, v in given.items() if v is not None} | {"seed": options.seed},
    )
    before = len(grids.finished(grid, options.out, options.overwrite))
    left = len(grid.cells) - before
    if not options.json:
        print(f"{len(grid.cells)} cells, {before} of them finished before", flush=True)
    problems: dict[Any, str] = {}
    made = grids.run(grid, options.out, engine, overwrite=options.overwrite)
    try:
        for done in progress(made, left, "cells"):
            if done.problem:
                problems[done.cell] = done.problem
    except KeyboardInterrupt:
        options.exit_code = 130
    finally:
        made.close()
    scores, summary = grids.conclude(grid, options.out, problems)
    if not options.json:
        if scores:
            print_table(*drawn.scores_table(scores))
        for why in dict.fromkeys(problems.values()):
            mine = [cell.name for cell, problem in problems.items() if problem == why]
            print(f"failed: {', '.join(mine)}: {why}")
        if summary["others"]:
            print(f"of the table, finished before and not asked for now: {summary['others']} cells")
        if scores:
            print(f"banks, table and figure: {options.out}")
        else:
            print(f"no cell is finished, so there is no table: {options.out / grids.SUMMARY}")
    if getattr(options, "exit_code", 0):
        print(
            f"interrupted with {summary['finished']} of {summary['cells']} cells finished; the "
            "same command goes on", file=sys.stderr,
        )  # fmt: skip
    elif not summary["finished"]:
        raise JShapeError(f"no cell could be computed: {next(iter(problems.values()))}")
    return summary


def simulate(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape grid simulate OUT`."""
    engine = _engine(options)
    from jshape.data.simulate import ROIS
    from jshape.grid import shards

    simulation = shards.Simulation(
        pairs=options.pairs,
        actions=tuple(options.actions or ROIS),
        agents=tuple(options.agents),
        material=options.material,
        beds=tuple(options.beds),
        frames=options.frames,
        strengths=tuple(options.strengths),
        seed=options.seed,
        size=options.size,
    )
    made = shards.simulate(
        simulation, options.out, engine, overwrite=options.overwrite,
        say=lambda line: print(line, file=sys.stderr),
    )  # fmt: skip
    count = len(simulation.shards)
    try:
        for _ in progress(made, count, "shards"):
            pass
    except KeyboardInterrupt:
        there = shards.finished(options.out)
        kept = f"; they are kept in {shards.kept_beside(options.out)}" if there else ""
        print(f"{there} of {count} shards are finished{kept}; the same command goes on",
              file=sys.stderr)  # fmt: skip
        raise  # there is no data set yet that a result could name
    finally:
        made.close()
    if not options.json:
        print(f"{len(simulation)} pairs: {options.out}")
    return {"out": str(options.out), "pairs": len(simulation)}


def _engine(options: argparse.Namespace) -> Any:
    from jshape.grid import engines

    if options.engine == "ray":
        return engines.OnRay(options.address, options.cpus or 1)
    given = [name for name in ("address", "cpus") if getattr(options, name) is not None]
    if given:
        raise JShapeError(f"--{given[0]} is for --engine ray")
    return engines.here


def add(commands: Any) -> None:
    """The parser of `jshape grid`."""
    parser = commands.add_parser("grid", help=COMMANDS["grid"])
    parser.set_defaults(help_of=parser)
    grids = parser.add_subparsers(dest="subcommand", metavar="WHAT", parser_class=arguments.Parser)
    _add_train(grids)
    _add_simulate(grids)


def _add_train(grids: Any) -> None:
    count = arguments.positive_count
    parser = arguments.command(
        grids, "train", train,
        "banks of agents x actions x kinds x partitions with their errors; finished ones are kept",
    )  # fmt: skip
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the grid")
    parser.add_argument(
        "--kinds", nargs="+", default=["P"], metavar="KIND", help="D P C CR DC DCR (default: P)"
    )
    parser.add_argument("--agents", nargs="+", metavar="AGENT", help="(all)")
    parser.add_argument("--actions", nargs="+", metavar="ACTION", help="(all)")
    parser.add_argument("--partitions", type=count, default=4, help="how many (4)")
    parser.add_argument("--seed", type=arguments.seed, default=0, help="of everything random (0)")
    for name in LEARNING:
        read, what = arguments.TRAINING[name]
        parser.add_argument(f"--{name.replace('_', '-')}", type=read, default=None, help=what)
    parser.add_argument("--morphology", choices=("erode", "dilate"), default=None,
                        help="what B goes through, as for train")  # fmt: skip
    _add_engine(parser)


def _add_simulate(grids: Any) -> None:
    count = arguments.positive_count
    parser = arguments.command(
        grids, "simulate", simulate, "the data set of `dataset simulate`, made in shards"
    )
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument("--pairs", type=count, default=25, help="per action and agent (25)")
    parser.add_argument("--actions", nargs="+", default=None, help="default: all five")
    parser.add_argument("--agents", nargs="+", default=["robot"], help="robot, human")
    parser.add_argument("--material", default="flour", help="flour, sand or dough")
    parser.add_argument("--beds", nargs="+", default=["flat"], help="flat, irregular, curved")
    parser.add_argument("--frames", type=count, default=5, help="averaged per look (5)")
    parser.add_argument(
        "--strengths", nargs=2, type=arguments.positive, default=[1.0, 1.0],
        metavar=("LOW", "HIGH"), help="how many times as deep as the agent's own (1 1)",
    )  # fmt: skip
    parser.add_argument("--seed", type=arguments.seed, default=0)
    parser.add_argument("--size", type=count, default=16, help="most pairs of a shard (16)")
    _add_engine(parser)


def _add_engine(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--engine", choices=("here", "ray"), default="here",
        help="one piece after the other, or Ray's workers (default: here)",
    )  # fmt: skip
    parser.add_argument(
        "--address", metavar="ADDRESS",
        help="of a Ray cluster: auto, HOST:6379, ray://HOST:10001 (default: this machine's cores)",
    )  # fmt: skip
    parser.add_argument(
        "--cpus", type=arguments.positive_count, metavar="N", help="cores of each piece (1)"
    )
