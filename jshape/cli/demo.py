"""`jshape demo`."""

import argparse
from pathlib import Path
from typing import Any

from jshape.cli import arguments
from jshape.cli.search_options import add_search, search_of
from jshape.io.simulated import agent_of, material_of


def demo(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape demo`: the main job in simulation, closed loop."""
    search = search_of(options)  # before anything is computed: it chooses JAX's devices
    from jshape.demo import run_demo

    return run_demo(
        options.out,
        bank_name=options.bank,
        seed=options.seed or 0,
        actions=options.actions,
        material=material_of(options.material),
        agent=agent_of(options.agent),
        replan=not options.open_loop,
        search=search,
        overwrite=options.overwrite,
        say=(lambda line: None) if options.json else lambda line: print(line, flush=True),
    )


def add(commands: Any) -> None:
    """The parser of `jshape demo`."""
    parser = arguments.command(commands, "demo", demo)
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder for the run")
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument(
        "--actions", type=arguments.count, default=4, help="actions that make the goal"
    )
    arguments.add_material(parser)
    parser.add_argument("--agent", default="robot", help=f"who acts: {arguments.agents_help()}")
    parser.add_argument("--open-loop", action="store_true", help="plan once, then act blindly")
    add_search(parser)
