"""The pages of the documentation, and what is in them."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from tests.conftest import ROOT

DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *DOCS]

_FENCE = re.compile(r"^(`{3,})(\w*)[^\n]*\n(.*?)^\1`*[ \t]*$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"(`+)(?!`).*?(?<!`)\1(?!`)", re.DOTALL)
_LINK = re.compile(r"\]\(\s*<?([^)>\s]+)>?[^)]*\)")
_HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)


class Block(NamedTuple):
    """A fenced block."""

    language: str
    text: str


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page."""
    return [Block(found[2], found[3]) for found in _FENCE.finditer(text)]


def links(text: str) -> list[str]:
    """Where the links and pictures of a page lead to, without those in code."""
    return _LINK.findall(_CODE.sub("`", _FENCE.sub("", text)))


def anchors(text: str) -> set[str]:
    """What `#...` may name in a page, as code hosts and the site make it of headings."""
    found: dict[str, int] = {}
    for heading in _HEADING.findall(_FENCE.sub("", text)):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
        found[name] = found.get(name, -1) + 1
    return {f"{name}-{k}" if k else name for name, most in found.items() for k in range(most + 1)}


def commands(text: str) -> Iterator[str]:
    """The commands of the `console` blocks: lines after `$ ` where there are such, else all.

    Comments go; a backslash at the end joins lines.
    """
    for block in blocks(text):
        if block.language != "console":
            continue
        lines = block.text.replace("\\\n", " ").splitlines()
        prompted = [line[2:] for line in lines if line.startswith("$ ")]
        for line in prompted or lines:
            command = re.sub(r"(^|\s)#.*", "", line).strip()
            if command:
                yield " ".join(command.split())


def spoken(text: str) -> Iterator[str]:
    """The commands of jshape that stand within sentences and tables."""
    for found in _CODE.finditer(_FENCE.sub("", text)):
        command = found[0].strip("` ")
        if command.startswith("jshape "):
            yield " ".join(command.split())
