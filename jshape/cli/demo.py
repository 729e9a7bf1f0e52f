"""`jshape demo`."""

import argparse
from pathlib import Path
from typing import Any

from jshape.cli import arguments
from jshape.io.simulated import agent_of, material_of
from jshape.planning.devices import over_devices


def demo(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape demo`: the main job in simulation, closed loop."""
    how = over_devices(options.devices)  # before anything is computed
    from jshape.demo import run_demo

    return run_demo(
        options.out,
        bank_name=options.bank,
        seed=options.seed,
        actions=options.actions,
        max_steps=options.max_steps,
        material=material_of(options.material),
        agent=agent_of(options.agent),
        replan=not options.open_loop,
        planner=options.planner,
        how=how,
        overwrite=options.overwrite,
        say=(lambda line: None) if options.json else lambda line: print(line, flush=True),
    )


def add(commands: Any) -> None:
    """The parser of `jshape demo`."""
    parser = arguments.command(commands, "demo", demo)
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder for the run")
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument("--seed", type=arguments.seed, default=0, help="another bed and goal")
    parser.add_argument(
        "--actions", type=arguments.count, default=4, help="actions that make the goal"
    )
    parser.add_argument(
        "--max-steps", type=arguments.count, default=8, help="most actions to apply"
    )
    arguments.add_material(parser)
    parser.add_argument("--agent", default="robot", help=f"who acts: {arguments.agents_help()}")
    parser.add_argument("--open-loop", action="store_true", help="plan once, then act blindly")
    arguments.add_search(parser)
