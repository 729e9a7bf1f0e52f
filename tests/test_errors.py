"""What errors quote from outside: short, printable, looked at only so far."""

import pytest

from jshape.errors import UnknownName, one_line, quoted


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("two\nlines\tand  more", "two lines and more"),
        ("bell\a and \x1b[2J", "bell\\x07 and \\x1b[2J"),
        ("to the left \u202eabc", "to the left \\u202eabc"),
        ("Gräben", "Gräben"),
        ("x" * 300, "x" * 197 + "..."),
    ],
)
def test_a_text_from_outside_is_one_line(text, said):
    assert one_line(text) == said


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("poke", "'poke'"),
        (1.5, "1.5"),
        (None, "None"),
        ([1, 2], "[1, 2]"),
        ({"a": [1]}, "{'a': [1]}"),
        ("\x1b[2J", r"'\x1b[2J'"),
        (list(range(99)), "[0, 1, 2, 3, ...]"),
    ],
)
def test_a_value_from_outside_is_quoted(value, said):
    assert quoted(value) == said


def test_a_long_value_is_cut():
    assert quoted(10**5000) == "a number too long to show"
    assert len(quoted("x" * 10_000)) <= 80
    assert len(str(UnknownName("action", "x" * 10_000, ["poke"]))) < 150


def test_nested_aliases_are_not_expanded():
    nested = [1]
    for _ in range(60):  # 10^60 numbers if anybody writes them out
        nested = [nested] * 10
    assert len(quoted(nested)) <= 80
