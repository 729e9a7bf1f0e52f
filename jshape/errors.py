"""Every error that jshape raises on purpose.  It says what came, what is allowed, and where."""

import difflib
from collections.abc import Iterable


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
            f"unknown {what} {name!r}; allowed: {', '.join(names) or '(none)'}"
            f"{did_you_mean(name, names)}"
        )


def did_you_mean(name: object, allowed: Iterable[str]) -> str:
    """The end of an error about a name: "; did you mean poke?", or nothing if none is near."""
    by_lower = {one.lower(): one for one in allowed}
    near = difflib.get_close_matches(str(name).lower(), by_lower, n=1, cutoff=0.6)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""


class BadBank(JShapeError):
    """A bank that cannot be read or trusted."""


class BadDataset(JShapeError):
    """A data set that is empty, incomplete or inconsistent."""


class BadFile(JShapeError):
    """A file or folder that cannot be read or written."""


class BadSetting(JShapeError):
    """A line of a configuration file that no command takes, or takes otherwise."""
