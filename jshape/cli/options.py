"""What the command line reads: kinds of values, and the options that all commands have.

A command is a function; its options are the fields of a frozen dataclass, whose docstrings are the
help.  A field's type says how it is read.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

from cyclopts import CoercionError, Parameter

from jshape.errors import BadFile, JShapeError, quoted


def reads(read: Callable[[str], Any], metavar: str, **more: Any) -> Parameter:
    """An option's value as a function reads it, which raises a ValueError that says why not."""

    def convert(hint: Any, tokens: Any) -> Any:
        text = tokens[-1].value
        try:
            if any(c.isnumeric() and not c.isascii() for c in text):  # people cannot compare them
                raise ValueError(f"{quoted(text)}: numbers are written with the digits 0 to 9")
            return read(text)
        except ValueError as problem:
            raise CoercionError(msg=str(problem), token=tokens[-1]) from None

    return Parameter(converter=convert, metavar=metavar, n_tokens=1, **more)


def number(kind: Callable[[str], Any], ok: Callable[[Any], bool], allowed: str) -> Any:
    """What reads a number; `allowed` says which."""

    def read(text: str) -> Any:
        try:
            value = kind(text)
            if ok(value):
                return value
        except ValueError:
            pass
        raise ValueError(f"{quoted(text)} is not {allowed}")

    return read


positive = number(float, lambda x: 0 < x < float("inf"), "a positive number")


def duration(text: str) -> float:
    """A time above 0 in seconds: "5", "5s", "500ms" or "2min"."""
    value, size = text, 1.0
    for unit, seconds in (("ms", 1e-3), ("min", 60.0), ("s", 1.0)):
        if text.endswith(unit):
            value, size = text.removesuffix(unit), seconds
            break
    try:
        return size * positive(value)
    except ValueError:
        allowed = "a time above 0, such as 5s, 500ms or 2min"
        raise ValueError(f"{quoted(text)} is not {allowed}") from None


def window(text: str) -> tuple[int, int, int, int]:
    """A window: "181,46,480x395" is left, top, width and height in pixels."""
    try:
        left, top, size = text.split(",")
        width, height = size.split("x")
        return int(left), int(top), int(width), int(height)
    except ValueError:
        raise ValueError(
            f"{quoted(text)} is not LEFT,TOP,WIDTHxHEIGHT in pixels, such as 181,46,480x395"
        ) from None


def depth_range(text: str) -> tuple[float, float]:
    """Two depths: "0.42,0.47"."""
    try:
        low, high = (positive(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{quoted(text)} is not two depths in metres, such as 0.42,0.47") from None
    return low, high


def use(text: str) -> tuple[str, int]:
    """An action and how often: "knock=2"."""
    name, _, count = text.rpartition("=")
    if not name or not count.isdecimal():
        raise ValueError(f"{quoted(text)} is not an action and a number, like knock=2")
    return name, int(count)


def carry(text: str) -> tuple[str, str]:
    """Two actions, of which the second brings what the first takes out: "scoop=pour"."""
    take, _, bring = text.partition("=")
    if not take or not bring:
        raise ValueError(f"{quoted(text)} is not two actions, like scoop=pour")
    return take, bring


Count = Annotated[int, reads(number(int, lambda x: x >= 0, "a whole number from 0"), "N")]
PositiveCount = Annotated[int, reads(number(int, lambda x: x > 0, "a whole number from 1"), "N")]
Port = Annotated[int, reads(number(int, lambda x: 0 <= x <= 65535, "a port from 0 to 65535"), "N")]
Seed = Annotated[
    int, reads(number(int, lambda x: 0 <= x < 2**32, "a seed from 0 to 4294967295"), "N")
]
Devices = Annotated[
    int, reads(number(int, lambda x: 0 < x <= 64, "a number of devices from 1 to 64"), "N")
]
Positive = Annotated[float, reads(positive, "X")]
Nonnegative = Annotated[
    float, reads(number(float, lambda x: 0 <= x < float("inf"), "a number from 0"), "X")
]
Share = Annotated[float, reads(number(float, lambda x: 0 <= x <= 1, "a share from 0 to 1"), "X")]
Positives = Annotated[
    list[float], reads(lambda text: [positive(part) for part in text.split(",")], "X,X,...")
]
Duration = Annotated[float, reads(duration, "TIME")]
Use = Annotated[Any, reads(use, "ACTION=N")]
CarryOf = Annotated[Any, reads(carry, "ACTION=ACTION")]
Window = Annotated[tuple[int, int, int, int], reads(window, "LEFT,TOP,WIDTHxHEIGHT")]
DepthRange = Annotated[tuple[float, float], reads(depth_range, "NEAR,FAR")]

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
        """Refuse options that say nothing here.

        Raises:
          JShapeError: one of them is given.
        """
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
        """Refuse to replace a file unless asked to.

        Raises:
          BadFile: it exists.
        """
        if path.exists() and not self.overwrite:
            raise BadFile(f"{path}: exists; choose another name, or --overwrite")

    def picture_beside(self, out: Path, read: Iterable[Path], suffix: str = ".png") -> Path:
        """The picture beside a file that is to be written: of its name, but for the suffix.

        Raises:
          BadFile: one of the two exists, or the picture is among the files that are read.
        """
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
