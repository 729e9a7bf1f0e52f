"""What the command line reads: kinds of values, and the options that all commands have.

A command is a function; its options are the fields of a frozen dataclass, whose docstrings are the
help.  A field's type says how it is read.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

from cyclopts import CoercionError, Parameter

from jshape.errors import BadFile, JShapeError, quoted


def checked(
    read: Callable[[str], Any], allowed: str, ok: Callable[[Any], Any] = lambda x: True
) -> Callable[[str], Any]:
    """What reads a text, and raises one ValueError, which says what is allowed, if it is not ok."""

    def reader(text: str) -> Any:
        with suppress(ValueError):
            if ok(value := read(text)):
                return value
        raise ValueError(f"{quoted(text)} is not {allowed}")

    return reader


def reads(
    read: Callable[[str], Any],
    metavar: str,
    allowed: str = "",
    ok: Callable[[Any], Any] = lambda x: True,
) -> Parameter:
    """An option's value as a function reads it; `allowed` and `ok` are as of `checked`."""
    reader = checked(read, allowed, ok) if allowed else read

    def convert(hint: Any, tokens: Any) -> Any:
        text = tokens[-1].value
        try:
            if any(c.isnumeric() and not c.isascii() for c in text):  # people cannot compare them
                raise ValueError(f"{quoted(text)}: numbers are written with the digits 0 to 9")
            return reader(text)
        except ValueError as problem:
            raise CoercionError(msg=str(problem), token=tokens[-1]) from None

    return Parameter(converter=convert, metavar=metavar, n_tokens=1)


def _duration(text: str) -> float:
    for unit, seconds in (("ms", 1e-3), ("min", 60.0), ("s", 1.0)):
        if text.endswith(unit):
            return seconds * positive(text.removesuffix(unit))
    return positive(text)


def _window(text: str) -> tuple[int, int, int, int]:
    left, top, size = text.split(",")
    width, height = size.split("x")
    return int(left), int(top), int(width), int(height)


def _depth_range(text: str) -> tuple[float, float]:
    low, high = (positive(part) for part in text.split(","))
    return low, high


def _use(text: str) -> tuple[str, int]:
    name, _, count = text.rpartition("=")
    return name, int(count) if count.isdecimal() else -1


positive = checked(float, "a positive number", lambda x: 0 < x < float("inf"))
duration = checked(_duration, "a time above 0, such as 5s, 500ms or 2min")
"""Seconds."""
_WINDOW = "LEFT,TOP,WIDTHxHEIGHT"

Count = Annotated[int, reads(int, "N", "a whole number from 0", lambda x: x >= 0)]
PositiveCount = Annotated[int, reads(int, "N", "a whole number from 1", lambda x: x > 0)]
Port = Annotated[int, reads(int, "N", "a port from 0 to 65535", lambda x: 0 <= x <= 65535)]
Seed = Annotated[int, reads(int, "N", "a seed from 0 to 4294967295", lambda x: 0 <= x < 2**32)]
Devices = Annotated[int, reads(int, "N", "a number of devices from 1 to 64", lambda x: 0 < x <= 64)]
Positive = Annotated[float, reads(positive, "X")]
Nonnegative = Annotated[
    float, reads(float, "X", "a number from 0", lambda x: 0 <= x < float("inf"))
]
Share = Annotated[float, reads(float, "X", "a share from 0 to 1", lambda x: 0 <= x <= 1)]
Positives = Annotated[
    list[float], reads(lambda text: [positive(part) for part in text.split(",")], "X,X,...")
]
Duration = Annotated[float, reads(duration, "TIME")]
Use = Annotated[
    Any,
    reads(_use, "ACTION=N", "an action and a number, like knock=2", lambda u: u[0] and u[1] >= 0),
]
CarryOf = Annotated[
    Any,
    reads(lambda x: x.partition("=")[::2], "ACTION=ACTION", "two actions, like scoop=pour", all),
]
Window = Annotated[
    tuple[int, int, int, int],
    reads(_window, _WINDOW, f"{_WINDOW} in pixels, such as 181,46,480x395"),
]
DepthRange = Annotated[
    tuple[float, float], reads(_depth_range, "NEAR,FAR", "two depths in metres, such as 0.42,0.47")
]

File = Parameter(metavar="FILE")
Several = Parameter(consume_multiple=True)
CameraFile = Parameter(name=("--camera-file", "--camera"), metavar="FILE")


def spelled(*fields: str) -> str:
    """Fields as the command line spells them: "--depth-unit, --out"."""
    return ", ".join(f"--{name.replace('_', '-')}" for name in fields)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Common:
    """The options of all commands."""

    computes: ClassVar[bool] = True
    """The command uses JAX, which keeps what it compiles; jshape.toml reaches it."""
    at_once: ClassVar[bool] = False
    """It may end at any time while JAX compiles."""

    json: bool = False
    """Print the result as JSON."""
    config: Annotated[str | None, File] = None
    """Settings file, or off for none (default: $JSHAPE_CONFIG, else jshape.toml here)."""
    given: Annotated[Mapping[str, str], Parameter(parse=False)] = field(default_factory=dict)
    """Fields that were given, each with where: `cli`, or the file."""

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Refuse options that say nothing here."""
        given = [name for name in names if name in self.given and getattr(self, name) is not False]
        if given:
            raise JShapeError(f"{spelled(*given)}{why}")

    def exit_code(self, result: Mapping[str, Any]) -> int:
        """The command's, of its result."""
        return 0


@dataclass(frozen=True, kw_only=True)
class Writes(Common):
    """The options of commands that make a folder or file."""

    overwrite: bool = False
    """Replace an earlier result."""

    def check_new(self, path: Path) -> None:
        """Refuse to replace a file unless asked to."""
        if path.exists() and not self.overwrite:
            raise BadFile(f"{path}: exists; choose another name, or --overwrite")

    def picture_beside(self, out: Path, read: Iterable[Path], suffix: str = ".png") -> Path:
        """The picture beside a file that is to be written: of its name, but for the suffix."""
        picture = out.with_suffix(suffix)
        if any(path.exists() and picture.exists() and path.samefile(picture) for path in read):
            raise BadFile(
                f"{out}: its picture would replace {picture}, a frame; choose another name"
            )
        self.check_new(out)
        self.check_new(picture)
        return picture


@dataclass(frozen=True, kw_only=True)
class Serves(Common):
    """The options of commands that serve a page."""

    host: str = "127.0.0.1"
    """Address to listen at; 127.0.0.1 is this computer only."""
    port: Port = 8080
    """Port to listen at; 0: any free one."""
    no_open: bool = False
    """Open no browser."""


@dataclass(frozen=True, kw_only=True)
class Part(Common):
    """Which part of the frames is the bed."""

    depth_range: DepthRange | None = None
    """Depths between which the bed lies, metres (default: camera.json's, or 0.42,0.47)."""
    window: Window | None = None
    """Part of the (first camera's) frames that holds the box, pixels (default: all)."""


def plan_file(path: Path) -> Path:
    """The plan.json that a folder of `jshape plan --out` holds; a file stays."""
    return path / "plan.json" if path.is_dir() else path
