"""Every error that jshape raises on purpose.  It says what came, what is allowed, and where."""

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
        super().__init__(f"unknown {what} {name!r}; allowed: {', '.join(allowed) or '(none)'}")


class BadBank(JShapeError):
    """A bank that cannot be read or trusted."""


class BadDataset(JShapeError):
    """A data set that is empty, incomplete or inconsistent."""


class BadFile(JShapeError):
    """A file or folder that cannot be read or written."""
