"""`jshape demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from jshape.cli.names import Agent, Simulates, Uses
from jshape.cli.options import Count, Seed, Writes
from jshape.cli.search_options import Searches, search_of
from jshape.cli.tables import say
from jshape.io.simulated import agent_of, material_of


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Uses, Searches, Simulates, Writes):
    """Of `jshape demo`."""

    out: Path = Path("runs/demo")
    """Folder for the run."""
    actions: Count = 4
    """Number of actions that make the goal."""
    agent: Agent = "robot"
    """Hand that acts: a name or FILE.toml."""
    seed: Seed = 0
    """Of the bed, the goal and the noise."""
    open_loop: bool = False
    """Plan once, then act blindly."""
    reproject: Annotated[bool, Parameter(parse=False)] = False  # the camera is the bank's


def demo(*, options: DemoOptions = DemoOptions()) -> dict[str, Any]:
    """`jshape demo`: the main job in simulation, closed loop."""
    search = search_of(options)  # before anything is computed: it chooses JAX's devices
    from jshape.demo import run_demo

    return run_demo(
        options.out,
        bank_name=options.bank,
        seed=options.seed,
        actions=options.actions,
        material=material_of(options.material),
        agent=agent_of(options.agent),
        replan=not options.open_loop,
        search=search,
        overwrite=options.overwrite,
        say=say,
    )
