"""The command line: which command its words name, with which options, or why they are refused."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

from cyclopts import UNSET, App, Argument, ArgumentCollection, CycloptsError, Token
from cyclopts.exceptions import (
    CoercionError,
    MissingArgumentError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from jshape.cli import examples, settings
from jshape.cli.commands import build_app, leaf_of
from jshape.cli.options import Common
from jshape.cli.tables import shows_colours
from jshape.errors import BadSetting, JShapeError, UnknownName, did_you_mean, one_line, quoted


class Refused(JShapeError):
    """Words that are no command, or that its options do not take."""


class Parsed(NamedTuple):
    """A command with what it was given."""

    run: Any
    values: tuple[Any, ...]
    """What has no name of an option."""
    options: Common | None
    """None: of `--help` and `--version`."""
    file: Path | None = None
    """That settings are from."""
    keys: tuple[str, ...] = ()
    """Of these settings."""

    def __call__(self) -> Any:
        """Do it."""
        return self.run(*self.values, **({"options": self.options} if self.options else {}))


def parse(words: Sequence[str]) -> Parsed | None:
    """The command that the words name, with its options; None: they name none."""
    named, words = settings.named(words)
    app = build_app()
    head = list(takewhile(lambda word: not word.startswith("-"), words))
    chain, apps, _ = app.parse_commands(head)
    rest = words[len(chain) :]
    help_of = {"-h", "--help"} & {*rest} or "--version" in rest[:1]
    leaf = leaf_of(app, chain)
    if leaf is None and not help_of:
        if not rest:
            app.help_print(list(chain), console=app.error_console)
            return None
        if not rest[0].startswith("-"):
            known = [name for name in apps[-1] if not name.startswith("-")]
            raise _refused(str(UnknownName("command", rest[0], known)), chain)
    if not help_of:
        known = [name for one in leaf.arguments.values() for name in one.names] if leaf else []
        for word in rest[: rest.index("--")] if "--" in rest else rest:
            name = word.partition("=")[0]
            if word.startswith("--") and name not in known:
                raise _refused(f"unknown option {name}{did_you_mean(name, known)}", chain)
    file = settings.file_of(named) if leaf and leaf.kind.computes and not help_of else None
    given: dict[str, str] = {}
    applied: list[str] = []

    def fill(app: App, commands: Any, arguments: ArgumentCollection) -> None:
        for argument in arguments:
            if any(t.implicit_value is UNSET and not t.value.strip() for t in argument.tokens):
                what = "is empty; leave the option out, or give a value"
                raise _refused(f"{argument.name}: {what}", chain)
        if leaf is not None and file is not None:
            applied.extend(settings.apply(leaf, file, arguments))
        given.update({a.field_info.name: a.tokens[0].source for a in arguments if a.tokens})

    app.config = (fill,)
    if help_of:
        from rich.console import Console

        app.console = Console(force_terminal=shows_colours(sys.stdout))
    try:
        run, bound, _ = app.parse_args(list(words), print_error=False, exit_on_error=False)
    except CycloptsError as problem:
        raise _said(problem, chain) from None
    if leaf is None or run is not leaf.run:
        text = "" if run == app.version_print else examples.text(" ".join(chain))

        def tell() -> None:
            run(*bound.args, **bound.kwargs)
            print(text, end="")

        return Parsed(tell, (), None)
    for group in settings.EXCLUDE:
        both = [f"--{key}" for key in group if given.get(key.replace("-", "_")) == "cli"]
        if len(both) > 1:
            raise _refused(f"{both[0]} excludes {both[1]}; give one of them", chain)
    bound.apply_defaults()
    values = dict(bound.arguments)
    options = replace(values.pop("options"), given=given, config=named)
    flat = (one if isinstance(one, tuple) else (one,) for one in values.values())
    return Parsed(run, tuple(x for part in flat for x in part), options, file, tuple(applied))


def value_of(argument: Argument, tokens: Sequence[Token]) -> Any:
    """A setting's value as the option reads it."""
    for token in tokens:
        argument.append(token)
    try:
        return argument.convert_and_validate()
    except CycloptsError as problem:
        raise _said(problem, ()) from None


def _refused(what: str, chain: Sequence[str]) -> Refused:
    return Refused(f"{what} (see {' '.join(['jshape', *chain])} --help)")


def _said(problem: CycloptsError, chain: Sequence[str]) -> JShapeError:
    """What is wrong with the words, or with the value of a setting, in one line."""
    argument = problem.argument
    name = argument.name if argument else ""
    if isinstance(problem, CoercionError) and argument is not None and problem.token is not None:
        token, choices = problem.token, argument.get_choices(force=True)
        by_person = token.source == "cli"
        what = f"{name}: " if by_person else f"{token.source}{name.lstrip('-')}: "
        if problem.msg is not None:
            what += str(problem.msg)
        elif choices:
            of, what = (f" of {name}", "") if by_person else ("", what)
            what += str(UnknownName(f"value{of}", token.value, choices))
        else:
            what += f"{quoted(token.value)} is not what it takes"
        return _refused(what, chain) if by_person else BadSetting(what)
    if isinstance(problem, MissingArgumentError):
        lacks = f"{problem.keyword}: needs a value" if problem.keyword else f"{name} is required"
        return _refused(lacks, chain)
    if isinstance(problem, UnknownOptionError):
        return _refused(f"unknown option {problem.token.keyword or problem.token.value}", chain)
    if isinstance(problem, UnusedCliTokensError):
        return _refused(f"unexpected {quoted((problem.unused_tokens or [''])[0])}", chain)
    return _refused(one_line(problem), chain)
