"""`jshape completion SHELL`: a script that completes commands, options and names.

The script holds everything: a TAB starts no Python.
"""

import re
from dataclasses import dataclass
from typing import Any, Literal

from jshape.cli.commands import build_app
from jshape.cli.options import Common
from jshape.cli.settings import NAMES_OR_FILES

Shell = Literal["bash", "zsh", "fish"]
FILES_TOO = "|".join((*NAMES_OR_FILES, "material", "agent", "agents"))
"""Options whose value may be a name, or a file or folder."""


@dataclass(frozen=True, kw_only=True)
class CompletionOptions(Common):
    """Of `jshape completion`."""

    computes = False


def completion(shell: Shell, /, options: CompletionOptions = CompletionOptions()) -> dict[str, Any]:
    """Print the script; with `--json` it is the value of `script`.

    Args:
      shell: The shell.
    """
    script = script_of(shell)
    print(script)
    return {"shell": shell, "script": script}


def script_of(shell: Shell) -> str:
    """The script for a shell: what is bundled, and known without looking around."""
    script = build_app().generate_completion(prog_name="jshape", shell=shell)
    # Names that stand for files too: where no name fits, files do.
    if shell == "bash":
        return script.replace("complete -F ", "complete -o default -F ")
    if shell == "fish":
        return re.sub(rf"(-l (?:{FILES_TOO}) )-x ", r"\1-r ", script)
    return re.sub(rf"(--(?:{FILES_TOO})\[.*?:)\((.*?)\)\"", r'\1{compadd -- \2; _files}"', script)
