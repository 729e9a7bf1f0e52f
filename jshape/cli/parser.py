"""The parser of all commands; each adds itself."""

from collections.abc import Sequence
from importlib import import_module

from jshape.cli import COMMANDS, arguments, examples


def build_parser(words: Sequence[str] | None = None) -> arguments.Parser:
    """All commands and their options.

    Args:
      words: the command line, if only the options of the command that it names are wanted; the
        others then have none, and their files are not imported.
    """
    parser = arguments.Parser(
        prog="jshape", description="Mold soft material by shaping depth images."
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    arguments.add_config(parser)
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", parser_class=arguments.Parser
    )
    wanted = COMMANDS if words is None else [next((w for w in words if w in COMMANDS), None)]
    for name, what in COMMANDS.items():
        if name in wanted:
            import_module(f"jshape.cli.{name}").add(commands)
        else:
            commands.add_parser(name, help=what, add_help=False)
    examples.add(parser)
    return parser
