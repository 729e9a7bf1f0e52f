"""The tree of commands: where each is, and what it takes; their files are imported when needed."""

import inspect
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from cyclopts import App, Argument, Parameter

from jshape import __version__
from jshape.cli import COMMANDS
from jshape.cli.options import Common

EACH_TIME = ("yes", "overwrite", "resume", "restart", "host")
"""What moves an arm unasked, replaces work or lets others in is said each time, at the command
line: a file that happens to lie in a folder must not say it."""
NO_SETTINGS = ("json", "config")
"""Options that say something of one run."""
OWN_TABLE = ("dataset", "train", "evaluate")
"""Commands about data and measurements, which a camera and a bank for molding must not change: keys
outside of their own table do not reach them."""
OF_A_CAMERA, FROM_FILES = ("window", "depth-range"), ("plan", "limit", "goal", "heightmap")
"""Options that say how to look through a camera, and commands that take frames which may be cut
already: they read these only from tables of their own."""


class Leaf(NamedTuple):
    """A command that does something."""

    words: tuple[str, ...]
    run: Any
    kind: type[Common]
    """Of its options."""
    arguments: dict[str, Argument]
    """What it takes, by long name without dashes."""

    @property
    def table(self) -> str:
        """The name of its own table: "plan", "dataset-simulate"."""
        return "-".join(self.words)

    @property
    def settable(self) -> dict[str, Argument]:
        """What a file may set, by key; of what has no option's name, only the camera."""
        if not self.kind.computes:
            return {}
        left_out = (*NO_SETTINGS, *EACH_TIME)
        named = {key: one for key, one in self.arguments.items() if one.name.startswith("-")}
        found = {key: one for key, one in named.items() if key not in left_out}
        if "CAMERA" not in self.arguments:
            return found
        found.pop("depth-unit", None)  # that of a file is of images
        return {"camera": self.arguments["CAMERA"]} | found

    @property
    def shared(self) -> dict[str, Argument]:
        """Those of `settable` that keys outside of tables reach."""
        if self.words[0] in OWN_TABLE:
            return {}
        left_out = OF_A_CAMERA if self.table in FROM_FILES else ()
        return {key: one for key, one in self.settable.items() if key not in left_out}


def build_app() -> App:
    """All commands; the file of each is imported when it is asked for."""
    app = App(
        name="jshape",
        help="Mold soft material by shaping depth images.",
        version=__version__,
        help_format="markdown",
        default_parameter=Parameter(negative="", allow_repeating=True, show_default=_shown),
    )
    for name, what in COMMANDS.items():
        app.command(f"jshape.cli.{name}:{name}", name=name, help=what)
    return app


def _shown(default: Any) -> str | None:
    """A default as the help shows it; None: it says nothing."""
    if isinstance(default, list | tuple):
        return ", ".join(map(str, default))
    return None if default is None or default is False or default == "" else str(default)


def leaf_of(app: App, words: Sequence[str]) -> Leaf | None:
    """The command that the words name; None: it does nothing by itself."""
    chain, apps, _ = app.parse_commands(list(words))
    run = apps[-1].default_command
    if run is None:
        return None
    taken = inspect.signature(run).parameters["options"]
    kind = taken.annotation
    arguments = [one for one in apps[-1].assemble_argument_collection() if one.parse]
    return Leaf(chain, run, kind, {one.name.lstrip("-"): one for one in arguments})


def leaves(app: App, chain: tuple[str, ...] = ()) -> Iterator[Leaf]:
    """All commands that do something."""
    here = app.parse_commands(list(chain))[1][-1]
    for name in here:
        if name.startswith("-"):
            continue
        leaf = leaf_of(app, (*chain, name))
        if leaf is None:
            yield from leaves(app, (*chain, name))
        else:
            yield leaf
