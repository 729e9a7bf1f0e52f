"""What errors quote from outside: short, printable, looked at only so far."""

import pytest

from jshape.errors import UnknownName, escaped, is_name, one_line, quoted


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


@pytest.mark.parametrize(
    ("text", "markup"),
    [
        ("<img src=x onerror='f()'>", "&lt;img src=x onerror=&#x27;f()&#x27;&gt;"),
        ("[x](javascript:f())", "&#91;x&#93;(javascript:f())"),
        ("![x](http://a.example/x.png)", "!&#91;x&#93;(http://a.example/x.png)"),
        ("a | `b` \\ *c*", "a &#124; &#96;b&#96; &#92; &#42;c&#42;"),
        ("f_P of 0.5 mm", "f_P of 0.5 mm"),
        ("\x1b[2J", "&#92;x1b&#91;2J"),
    ],
)
def test_a_text_from_outside_becomes_markup_that_only_shows_it(text, markup):
    assert escaped(text) == markup


def test_names_are_printable_lines():
    assert is_name("Grasp, \u00e0 la main <3")
    for value in ("", "  ", "two\nlines", "\x1b[2J", "\x9b2J", "\u202eabc", "x" * 201, 7, None):
        assert not is_name(value)
