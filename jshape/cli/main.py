"""`jshape ...`: reads arguments, calls the library, prints.  Exit code 0, or 2 with one line."""

import io
import json
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stdout, suppress
from importlib import import_module
from pathlib import Path

from jshape.cli.tables import coloured, waiting
from jshape.errors import JShapeError, one_line, quoted

NEEDED = ("cyclopts", "matplotlib", "PIL", "rich")
"""What the extra `cli` brings."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    if words is None:
        _prepare()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if words is None else list(words)
    if sys.stdout is None:
        return _refused("stdout is closed: there is nowhere to print; >/dev/null prints nothing")
    try:
        return _run(words)
    except JShapeError as problem:
        return _refused(problem)
    except KeyboardInterrupt as where:
        print(one_line(f"jshape: interrupted {where}", 2000), file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has left: nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as problem:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _refused(f"output cannot be printed: {problem.strerror}")
    except Exception as problem:
        said = _surroundings(problem)
        if said is None:
            raise
        return _refused(said)


def _surroundings(problem: Exception) -> str | None:
    """What of the environment is missing or cannot be worked with, if that is the problem."""
    if isinstance(problem, ModuleNotFoundError) and str(problem.name).split(".")[0] in NEEDED:
        return f"the command line needs {problem.name}: pip install 'jshape[cli]'"
    if str(problem).startswith("invalid truth value"):  # when it is imported
        return f"a variable JAX_... of the environment: {one_line(problem, 120)}"
    named = os.environ.get("JAX_PLATFORMS")
    if named:
        try:
            import_module("jax").devices()
        except Exception:  # of many types, an AssertionError among them
            return (
                f"JAX cannot use JAX_PLATFORMS={quoted(named)} of the environment here; "
                "unset it, or set it to cpu"
            )
    return None


def _refused(problem: object) -> int:
    said = one_line(problem, 2000)
    print(f"jshape: {coloured('error:', 'error', sys.stderr)} {said}", file=sys.stderr)
    return 2


def _prepare() -> None:
    """Make this process one that a command can rely on: its streams, libraries and settings."""
    for handle in (0, 1, 2):  # else the next file that is opened takes the place of a closed one
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdin = sys.stdin or open(os.devnull)
    sys.stderr = sys.stderr or open(os.devnull, "w")
    # Errors are one line: what libraries say beside it is shown to those who ask for it.
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    for library in ("absl", "jax", "matplotlib"):
        logging.getLogger(library).setLevel(logging.ERROR)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    # Pictures are drawn off screen with our own settings; one's own may even fail to be read.
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}
    if os.path.exists("matplotlibrc"):  # that of this folder is read before the one that is named
        here = os.getcwd()
        os.chdir(os.path.dirname(__file__))
        with suppress(ImportError):  # said where it is needed
            import_module("matplotlib")
        os.chdir(here)


def _run(words: list[str]) -> int:
    from jshape.cli.parser import parse  # not above: the extra may be missing

    asked = parse(words)
    if asked is None:
        return 2
    options = asked.options
    if options is None:  # --help, --version
        asked()
        return 0
    if asked.keys:
        said = f"settings of {asked.file}: {', '.join(asked.keys)}"
        print(coloured(said, "quiet", sys.stderr), file=sys.stderr)
    if options.computes:
        from jshape.planning.devices import remember_compiled

        remember_compiled()
    if isinstance(out := getattr(options, "out", None), Path):
        from jshape.io.folders import left_behind

        for line in left_behind(out):
            print(coloured(one_line(line, 2000), "warning", sys.stderr), file=sys.stderr)
    for_people = nullcontext() if not options.json else redirect_stdout(io.StringIO())
    with waiting(at_once=options.at_once) if options.computes else nullcontext(), for_people:
        result = asked()
    if options.json:
        print(json.dumps(result))
    sys.stdout.flush()
    return options.exit_code(result)


if __name__ == "__main__":
    sys.exit(main())
