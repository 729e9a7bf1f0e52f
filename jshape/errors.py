"""Every error that jshape raises on purpose.  It says what came, what is allowed, and where."""

import difflib
import html
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

LENS_WAY = "jshape heightmap makes a height map of its frames, which plans need no camera for"
"""What to do with frames of a lens that distorts: banks of images take straight rays."""


class JShapeError(Exception):
    """Root of all jshape errors; `except jshape.JShapeError` catches any of them."""


class BadImage(JShapeError):
    """An array or a file that is not the depth image it should be."""


class MissingDepth(BadImage):
    """More pixels without a depth reading than can be filled honestly."""


class BadCamera(JShapeError):
    """Camera fields that are missing, negative or contradictory, or the wrong camera."""


class BadPosition(JShapeError):
    """Positions whose ROI leaves the image."""


class UnknownName(JShapeError):
    """A name that is not in a list of names: an action, a planner, a bank, a material."""

    def __init__(self, what: str, name: object, allowed: Iterable[str]):
        names = tuple(allowed)
        super().__init__(
            f"unknown {what} {quoted(name)}; allowed: {', '.join(names) or '(none)'}"
            f"{did_you_mean(name, names)}"
        )


class BadOption(JShapeError, TypeError):
    """A keyword that a function or a record of options does not have."""


@contextmanager
def needs(extra: str, what: str) -> Iterator[None]:
    """Around an import that an extra brings.

    Raises:
      JShapeError: it is not installed; says how to.
    """
    try:
        yield
    except ImportError as problem:
        raise JShapeError(f"{what} needs {problem.name}: pip install 'jshape[{extra}]'") from None


def did_you_mean(name: object, allowed: Iterable[str]) -> str:
    """The end of an error about a name: "; did you mean poke?", or nothing if none is near."""
    by_lower = {one.lower(): one for one in allowed}
    near = difflib.get_close_matches(str(name).lower(), by_lower, n=1, cutoff=0.6)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""


def one_line(text: object, limit: int = 200) -> str:
    """A text from outside as one line of at most `limit` characters, safe to print.

    Control characters (a file's name may clear a terminal) are shown as Python escapes them.
    """
    words = " ".join(str(text).split())
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)
    return line if len(line) <= limit else line[: limit - 3] + "..."


def told(problem: Exception, limit: int) -> str:
    """What went wrong, as one line of at most `limit` characters; with its type unless ours."""
    kind = "" if isinstance(problem, JShapeError) else f"{type(problem).__name__}: "
    return one_line(f"{kind}{problem}", limit)


def quoted(value: object, limit: int = 80) -> str:
    """A value from outside as an error quotes it: its repr, in at most `limit` characters.

    Only so much of it is looked at: a YAML list of nested aliases would fill the memory.
    """
    short = reprlib.Repr()
    short.maxlevel, short.maxstring, short.maxother = 2, limit, limit
    short.maxlist = short.maxtuple = short.maxdict = short.maxset = short.maxarray = 4
    try:
        return one_line(short.repr(value), limit)
    except ValueError:  # Python does not print whole numbers of over 4,300 digits
        return "a number too long to show"


def is_name(value: object) -> bool:
    """Whether a value from outside can name something: one printable line, not too long."""
    return isinstance(value, str) and 0 < len(value.strip()) <= 200 and value.isprintable()


def escaped(text: object) -> str:
    """A text from outside as HTML, or as Markdown, that shows it and does nothing else.

    Whatever comes from a file, a person or a device goes through this where it becomes markup.
    """
    return html.escape(one_line(text, 1000)).translate(_MARKDOWN)


_MARKDOWN = {ord(c): f"&#{ord(c)};" for c in "[]`*|\\"}
"""What Markdown takes for links, pictures, code, stress and cells, beyond what HTML takes."""


class BadBank(JShapeError):
    """A bank that cannot be read or trusted."""


class BadDataset(JShapeError):
    """A data set that is empty, incomplete or inconsistent."""


class BadFile(JShapeError):
    """A file or folder that cannot be read or written."""


class BadSetting(JShapeError):
    """A line of a configuration file that no command takes, or takes otherwise."""
