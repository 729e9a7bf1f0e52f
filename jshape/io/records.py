"""Records from outside: a parsed mapping (JSON, YAML, TOML, a row of CSV) becomes a dataclass.

Say once, in a frozen dataclass, what a file may hold; `read_record` builds it, or raises one error
that names the file, the key, what came and what is allowed.  A field with a default may be left
out; `None` is a value only of `X | None`; a bool is never a number.

    @dataclass(frozen=True)
    class Finger:
        radius_mm: Annotated[float, Range(2, 60)]
        path_mm: Annotated[np.ndarray, Numbers((3, 2, 3), -140, 140)]
        grip: Literal["fist", "flat"] = "flat"
        posture: Annotated[str, OneLine()] = "open"

        def problem(self) -> str | None:             # optional: what no single field can tell
            return "a fist needs 5 mm" if self.grip == "fist" and self.radius_mm < 5 else None

    finger = read_record(Finger, content, "hand.toml: finger 1")

    hand.toml: finger 1: radius_mm is 0.006; expected a number from 2 to 60
    hand.toml: finger 1: unknown 'radius'; allowed: radius_mm, ...; did you mean radius_mm?

A class with `allow_unknown: ClassVar[bool] = True` leaves other keys alone.

Types of fields: str, bool, int, float, Literal, an Enum (by name), dict, dict[str, X], list[X],
tuple[X, ...], tuple[X, Y], np.ndarray (with `Numbers`), another such dataclass, X | None, Any.
"""

import enum
import re
import types
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from jshape.errors import BadFile, JShapeError, did_you_mean, is_name, quoted

FLOAT32 = float(np.finfo(np.float32).max)
"""The largest number that a float32 array holds."""
NAME_LIMIT = 200
"""Most characters of a name."""
_UNSAFE = re.compile(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Control characters, and those that turn the order of others: a terminal obeys them."""
_T = TypeVar("_T")
_WORDS = {str: "text", bool: "true or false", dict: "an object", list: "a list"}


@dataclass(frozen=True)
class Range:
    """The least and the greatest number that a field takes."""

    low: float | int
    high: float | int = FLOAT32
    above: bool = False
    """`low` itself is too little."""
    metres_below: float | int = 0.0
    """A length in mm that is smaller and not 0 was meant in metres."""

    def words(self, whole: bool = False) -> str:
        """What is expected."""
        if self.low <= -FLOAT32:
            return f"a {'whole ' * whole}number"
        low = f"{'above' if self.above else 'from'} {self.low:g}"
        high = "" if self.high >= FLOAT32 else f" to {self.high:{',' if whole else 'g'}}"
        return f"a {'whole ' * whole}number {low}{high}"

    def holds(self, value: Any) -> Any:
        """Whether a number, or each of an array, is in the range."""
        return (value > self.low if self.above else value >= self.low) & (value <= self.high)


@dataclass(frozen=True)
class Numbers:
    """An array of numbers: its shape, and the least and greatest of them."""

    shape: tuple[int, ...]
    low: float | int = -FLOAT32
    high: float | int = FLOAT32


@dataclass(frozen=True)
class OneLine:
    """One line of text that can name something, in at most `NAME_LIMIT` characters."""

    strict: bool = True
    """Only what Python calls printable; else signs that other scripts write with, too."""

    def holds(self, text: Any) -> bool:
        """Whether a text is one."""
        if self.strict or not isinstance(text, str):
            return is_name(text)
        return 0 < len(text.strip()) <= len(text) <= NAME_LIMIT and not _UNSAFE.search(text)


class Wrong(JShapeError):
    """A value that is not what it should be."""


def read_record(
    kind: type[_T], content: Any, where: str, *, error: type[JShapeError] = BadFile
) -> _T:
    """The record that a parsed mapping holds.

    Args:
      kind: the dataclass.
      content: what came.
      where: the file, and the place in it, for errors.
      error: to raise.

    Raises:
      JShapeError: as `error`; something is missing, unknown, of another type or out of its range.
    """
    try:
        return _record(kind, content, where)
    except Wrong as problem:
        raise error(str(problem)) from None


def read_value(hint: Any, value: Any, where: str, *, error: type[JShapeError] = BadFile) -> Any:
    """A single value of a type that a field could have; raises as `read_record`."""
    try:
        return _value(hint, value, where)
    except Wrong as problem:
        raise error(str(problem)) from None


def check_format(
    content: Mapping[str, Any], name: str, version: int, where: str, error: Any = BadFile
) -> None:
    """Refuse a file of another `format`, or of a later `version` than this program reads."""
    if content.get("format") != name:
        raise error(f"{where}: format is {quoted(content.get('format'))}; expected {name!r}")
    found = content.get("version")
    if type(found) is not int or found < 1:
        raise error(f"{where}: version is {quoted(found)}; expected a whole number from 1")
    if found > version:
        raise error(
            f"{where}: version {quoted(found)} is newer than this program reads ({version}); "
            "update it"
        )


@lru_cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _record(kind: Any, content: Any, where: str) -> Any:
    known = {field.name: field for field in fields(kind)}
    if not isinstance(content, Mapping):
        raise Wrong(f"{where}: is {quoted(content)}; expected an object with {', '.join(known)}")
    unknown = [name for name in content if name not in known]
    if unknown and not getattr(kind, "allow_unknown", False):
        raise Wrong(
            f"{where}: unknown {', '.join(map(quoted, unknown[:5]))}; allowed: {', '.join(known)}"
            f"{did_you_mean(unknown[0], known)}"
        )
    needed = [
        name
        for name, field in known.items()
        if field.default is MISSING and field.default_factory is MISSING
    ]
    if missing := [name for name in needed if name not in content]:
        raise Wrong(f"{where}: missing {', '.join(missing)}")
    hints = _hints(kind)
    made = kind(
        **{
            name: _value(hints[name], content[name], f"{where}: {name}")
            for name in known
            if name in content
        }
    )
    if problem := getattr(made, "problem", lambda: None)():
        raise Wrong(f"{where}: {problem}")
    return made


def _value(hint: Any, value: Any, where: str, rules: tuple[Any, ...] = ()) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _value(inner[0], value, where, inner[1:])
    if hint is Any:
        return value
    if origin in (Union, types.UnionType):  # only X | None
        (hint,) = (one for one in inner if one is not types.NoneType)
        return None if value is None else _value(hint, value, where, rules)
    if is_dataclass(hint):
        return _record(hint, value, where)
    if hint in (int, float):
        return _number(hint, value, where, rules[0] if rules else Range(-FLOAT32))
    if hint is np.ndarray:
        return _numbers(value, where, rules[0])
    if origin is Literal or isinstance(hint, type) and issubclass(hint, enum.Enum):
        allowed = {name: name for name in inner} or dict(hint.__members__)
        if not isinstance(value, str) or value not in allowed:
            raise Wrong(
                f"{where} is {quoted(value)}; allowed: {', '.join(map(str, allowed))}"
                f"{did_you_mean(value, map(str, allowed))}"
            )
        return allowed[value]
    if origin is tuple and inner[-1] is not ...:
        try:
            if not isinstance(value, list) or len(value) != len(inner):
                raise Wrong
            return tuple(_value(h, v, where, rules) for h, v in zip(inner, value, strict=True))
        except Wrong:
            expected = _several(inner, rules)
            raise Wrong(f"{where} is {quoted(value)}; expected {expected}") from None
    plain = origin or hint
    expected = list if plain is tuple else plain
    if not isinstance(value, expected) or rules and not rules[0].holds(value):
        line = f"a line of text, at most {NAME_LIMIT} characters"
        word = line if rules else _WORDS[expected]
        raise Wrong(f"{where} is {quoted(value)}; expected {word}")
    if expected is list and inner:
        one = where.removesuffix("s")
        return plain(_value(inner[0], v, f"{one} {k}", rules) for k, v in enumerate(value, 1))
    if plain is dict and inner:
        for name in value:
            _value(str, name, f"{where}: a name", (OneLine(),))
        return {name: _value(inner[1], one, f"{where}: {name}") for name, one in value.items()}
    return value


def _several(inner: tuple[Any, ...], rules: tuple[Any, ...]) -> str:
    if inner[0] not in (int, float):
        return f"{len(inner)} values"
    span = f", each {rules[0].words(inner[0] is int)}" if rules else ""
    return f"{len(inner)} {'whole ' * (inner[0] is int)}numbers{span}"


def _number(kind: type, value: Any, where: str, span: Range) -> Any:
    good = type(value) is int or (kind is float and isinstance(value, float))
    if not good or not span.holds(value):
        raise Wrong(f"{where} is {quoted(value)}; expected {span.words(kind is int)}")
    if 0 < abs(value) < span.metres_below:
        raise Wrong(
            f"{where} is {quoted(value)}; less than {span.metres_below:g} mm looks like metres: "
            "times 1000"
        )
    return kind(value)


def _numbers(value: Any, where: str, rule: Numbers) -> np.ndarray:
    try:
        found = np.array(value, np.float64)
        plain = all(type(one) in (int, float) for one in np.array(value, object).flat)
    except (TypeError, ValueError, OverflowError):
        found, plain = np.empty(0), False
    if not plain or found.shape != rule.shape or not Range(rule.low, rule.high).holds(found).all():
        shape = " x ".join(map(str, rule.shape))
        span = "" if rule.high >= FLOAT32 else f" from {rule.low:g} to {rule.high:g}"
        raise Wrong(f"{where} is {quoted(value)}; expected {shape} numbers{span}")
    return found
