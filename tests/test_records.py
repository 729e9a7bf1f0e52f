"""Typed records from parsed files: one error names the file, the key, what came and what is due."""

import enum
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest

from jshape.errors import BadBank, BadFile
from jshape.io.records import Numbers, OneLine, Range, check_format, read_record, read_value


class Colour(enum.Enum):
    RED = 1


@dataclass(frozen=True)
class Part:
    mm: Annotated[float, Range(0, 50, above=True, metres_below=1)]
    count: Annotated[int, Range(1, 9)] = 1


@dataclass(frozen=True)
class Whole:
    name: Annotated[str, OneLine()]
    parts: list[Part]
    matrix: Annotated[np.ndarray, Numbers((2, 2), -1, 1)]
    at: Annotated[tuple[int, int], Range(0, 99)] = (0, 0)
    kind: Literal["a", "b"] = "a"
    colour: Colour | None = None
    sums: dict[str, str] = None  # pyright: ignore
    rest: Any = None

    def problem(self):
        return "has no parts" if not self.parts else None


@dataclass(frozen=True)
class Open:
    allow_unknown: ClassVar[bool] = True
    name: str


GOOD = {"name": "x", "parts": [{"mm": 2}], "matrix": [[1, 0], [0, 1]]}


def test_a_record_is_built_with_its_types():
    more = {"at": [3, 4], "colour": "RED", "kind": "b", "sums": {"a": "b"}, "rest": [None]}
    found = read_record(Whole, GOOD | more, "f")
    assert found.parts == [Part(2.0)] and type(found.parts[0].mm) is float
    assert found.at == (3, 4) and found.colour is Colour.RED and found.rest == [None]
    assert read_record(Open, {"name": "x", "new": 1}, "f") == Open("x")
    assert read_value(tuple[float, ...], [1, 2.5], "f") == (1.0, 2.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nmae": 1}, "unknown 'nmae'; allowed: name, parts.*; did you mean name[?]"),
        ({"name": "a\nb"}, "name is .*; expected a line of text"),
        ({"parts": []}, "f: has no parts"),
        ({"parts": {}}, "parts is {}; expected a list"),
        ({"parts": [{"mm": 2}, {}]}, "f: part 2: missing mm"),
        ({"parts": [{"mm": 0.01}]}, "part 1: mm is 0.01; less than 1 mm looks like metres"),
        ({"parts": [{"mm": 0}]}, "mm is 0; expected a number above 0 to 50"),
        ({"parts": [{"mm": True}]}, "mm is True"),
        ({"parts": [{"mm": float("nan")}]}, "mm is nan"),
        ({"parts": [{"mm": 2, "count": 1.0}]}, "count is 1.0; expected a whole number from 1 to 9"),
        ({"parts": [{"mm": 10**400}]}, "mm is"),
        ({"at": [3]}, r"at is \[3\]; expected 2 whole numbers, each a whole number from 0 to 99"),
        ({"at": [3, 100]}, "at is"),
        ({"kind": "c"}, "kind is 'c'; allowed: a, b"),
        ({"kind": ["a"]}, "kind is"),
        ({"colour": "RDE"}, "colour is 'RDE'; allowed: RED; did you mean RED"),
        ({"matrix": [[1, 0], [0]]}, "matrix is .*; expected 2 x 2 numbers from -1 to 1"),
        ({"matrix": [[1, 0], [0, "1"]]}, "matrix is"),
        ({"matrix": [[1, 0], [0, 2]]}, "matrix is"),
        ({"sums": {"a": 1}}, "sums: a is 1; expected text"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_in_one_line(change, said):
    with pytest.raises(BadFile, match=said) as info:
        read_record(Whole, GOOD | change, "f")
    assert str(info.value).startswith("f: ") and "\n" not in str(info.value)
    with pytest.raises(BadBank):
        read_record(Whole, GOOD | change, "f", error=BadBank)


def test_a_file_of_another_format_or_of_later_is_refused():
    check_format({"format": "a", "version": 2}, "a", 2, "f")
    for content, said in (
        ({"format": "b", "version": 1}, "format is 'b'; expected 'a'"),
        ({"format": "a", "version": 3}, "version 3 is newer than this program reads .2."),
        ({"format": "a", "version": True}, "version is True"),
        ({"format": "a"}, "version is None"),
    ):
        with pytest.raises(BadFile, match=said):
            check_format(content, "a", 2, "f")
