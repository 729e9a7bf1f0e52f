"""Types of options that take a name, which completes, or a file or folder of one's own."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from jshape.cli.options import Common

if TYPE_CHECKING:
    Bank = str
    Action = str
    Material = str
    Agent = str
    Preset = str
else:
    from jshape import PAPER_ACTIONS, list_banks
    from jshape.camera import PRESETS
    from jshape.sim import AGENTS, MATERIALS

    Bank = Literal[list_banks()] | str
    Action = Literal[PAPER_ACTIONS.names] | str
    Material = Literal[tuple(MATERIALS)] | str
    Agent = Literal[tuple(AGENTS)] | str
    Preset = Literal[tuple(PRESETS)] | str


@dataclass(frozen=True, kw_only=True)
class Uses(Common):
    """The option of commands that plan with a bank."""

    bank: Bank | None = None
    """Bank to predict with: a bundled name, a folder, or that of a run, whose bank is corrected by
    what the run's actions did (default: pressed-flour-robot)."""


@dataclass(frozen=True, kw_only=True)
class Simulates(Common):
    """The option of commands with a simulated bed."""

    material: Annotated[Material, Parameter(metavar="NAME|FILE.toml")] = "flour"
    """Material of a simulated bed."""
