"""What an experiment leaves: a folder with its numbers, its figures, and a page that explains them.

`results.csv` and `results.json` hold the same rows; `page.html` stands alone beside its figures,
without scripts or links that leave the folder.
"""

import csv
import html
import io
import math
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jshape
from jshape.io import files, folders
from jshape.viz.style import Drawing, drawn

JSON, CSV, PAGE = "results.json", "results.csv", "page.html"
DPI = 110
"""Of figures, dots per inch."""
STYLE = """
body{font:16px/1.55 system-ui,sans-serif;color:#222;background:#fff;max-width:62rem;
margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem;line-height:1.2}h2{font-size:1.2rem;margin-top:2.2rem}
table{border-collapse:collapse;font-size:.88rem;font-variant-numeric:tabular-nums}
.wide{overflow-x:auto}
th,td{padding:.3rem .7rem;text-align:right;border-bottom:1px solid #ddd}
th:first-child,td:first-child{text-align:left}thead th{border-bottom:2px solid #999}
figure{margin:1.6rem 0}img{max-width:100%;height:auto}
figcaption,.small{color:#555;font-size:.9rem}
"""


_COMMAND: ContextVar[Sequence[str] | None] = ContextVar("command", default=None)
"""The words of the command that pages are made by, if it is known."""


class Table(NamedTuple):
    """A table of a page."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Picture(NamedTuple):
    """A figure of a page."""

    name: str
    """File name, such as "times.png"."""
    draw: Drawing
    caption: str


@dataclass(frozen=True)
class Result:
    """What an experiment found."""

    title: str
    paragraphs: Sequence[str]
    """What is seen, in words."""
    rows: Sequence[Mapping[str, Any]]
    """Every number: flat, of text, numbers, truths and None."""
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    """What the experiment was run with."""
    notes: Sequence[str] = ()
    """What was left out, and what to be careful with."""


@contextmanager
def made_by(command: Sequence[str]) -> Iterator[None]:
    """Pages that are written meanwhile say that this command made them.

    Args:
      command: its words, the program first.
    """
    token = _COMMAND.set(command)
    try:
        yield
    finally:
        _COMMAND.reset(token)


def made() -> dict[str, Any]:
    """How and when a page is made.

    Returns:
      `command`, "" if it is not known, `quick`, None then, `jshape`, its version, and `date`, UTC.
    """
    words = _COMMAND.get()
    return {
        "command": shlex.join(words or ()),
        "quick": None if words is None else "--quick" in words,
        "jshape": jshape.__version__,
        "date": datetime.now(UTC).date().isoformat(),
    }


def made_line(found: Mapping[str, Any]) -> str:
    """What `made` gives, HTML."""
    how = f"<code>{html.escape(found['command'])}</code>" if found["command"] else "a program"
    quick = {
        True: "Quick (<code>--quick</code>): small and few, numbers to look at, not to quote. ",
        False: "Not <code>--quick</code>. ",
        None: "",
    }[found["quick"]]
    return (
        f'<p class="small">{quick}Made by {how} with jshape {html.escape(found["jshape"])} on '
        f"{found['date']}.</p>"
    )


def contents(pictures: Iterable[str]) -> tuple[str, ...]:
    """The files of a result with these figures, as `folders.check_target` wants them."""
    return (JSON, CSV, PAGE, *pictures)


def check(out: Path, overwrite: bool, pictures: Iterable[str]) -> None:
    """Refuse a folder that must not be written: call it before long work.

    Raises:
      BadFile: it holds something else, or a result that is not to be replaced.
    """
    folders.check_target(out, overwrite, contents=contents(pictures))


def write(result: Result, out: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Write a result, whole or not at all.

    Args:
      result: what was found.
      out: its folder.
      overwrite: replace an earlier result.

    Returns:
      What `results.json` holds: title, how it was made, paragraphs, figures, settings, notes, rows.

    Raises:
      BadFile: the folder exists, or cannot be written.
    """
    names = [picture.name for picture in result.pictures]
    with folders.atomic_folder(out, overwrite, contents=contents(names)) as folder:
        return add(result, folder)


def add(result: Result, folder: Path) -> dict[str, Any]:
    """The same into a folder that holds more, such as the runs that it is about.

    Raises:
      BadFile: a file cannot be written; each is whole or as it was.
    """
    content = {
        "title": result.title,
        "made": made(),
        "paragraphs": list(result.paragraphs),
        "figures": [{"name": one.name, "caption": one.caption} for one in result.pictures],
        "settings": dict(result.settings),
        "notes": list(result.notes),
        "rows": [{name: _plain(value) for name, value in row.items()} for row in result.rows],
    }
    files.write_json(folder / JSON, content)
    files.write_atomic(folder / CSV, csv_text(content["rows"]))
    ready = drawn({one.name: one.draw for one in result.pictures}, dpi=DPI)
    for name, picture in ready.items():
        files.write_atomic(folder / name, picture)
    if len(ready) < len(result.pictures):
        result = replace(result, pictures=[one for one in result.pictures if one.name in ready])
        content["figures"] = [one for one in content["figures"] if one["name"] in ready]
        files.write_json(folder / JSON, content)
    files.write_atomic(folder / PAGE, page(result, content["made"]))
    return content


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV: all their columns in order of first appearance; what is unknown is empty."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = (row.get(name) for name in columns)
        writer.writerow(["" if value is None else value for value in values])
    return stream.getvalue()


def page(result: Result, how: Mapping[str, Any]) -> str:
    """The page of a result, HTML; `how` it was made, as `made` gives it."""
    parts = [made_line(how), *(paragraph(text) for text in result.paragraphs)]
    parts += [image(picture.name, picture.caption) for picture in result.pictures]
    parts += [_table(table) for table in result.tables]
    if result.notes:
        parts.append("<h2>Notes</h2>" + "".join(paragraph(note) for note in result.notes))
    if result.settings:
        rows = [(name, _said(value)) for name, value in result.settings.items()]
        parts.append(_table(Table("Settings", ("setting", "value"), rows)))
    parts.append(f'<p class="small">All numbers: {link(CSV)}, {link(JSON)}.</p>')
    return document(result.title, "\n".join(parts))


def document(title: str, body: str) -> str:
    """An HTML page around what is HTML already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{html.escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def paragraph(text: str) -> str:
    """A paragraph of plain text, HTML."""
    return f"<p>{html.escape(text)}</p>"


def image(path: str, caption: str) -> str:
    """A figure of the folder with its caption, HTML."""
    said = html.escape(caption)
    return (
        f'<figure><img src="{html.escape(path)}" alt="{said}">'
        f"<figcaption>{said}</figcaption></figure>"
    )


def link(path: str, text: str | None = None) -> str:
    """A link to a file of the folder, HTML; it reads as the path unless a text is given."""
    return f'<a href="{html.escape(path)}">{html.escape(text or path)}</a>'


def _table(table: Table) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        inside = "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in cells)
        return f"<tr>{inside}</tr>"

    body = "".join(line(row, "td") for row in table.rows)
    return (
        f"<h2>{html.escape(table.title)}</h2>\n"
        f'<div class="wide"><table><thead>{line(table.head, "th")}</thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _said(value: Any) -> str:
    """A setting in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_said(one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_said(one) for one in value)
    return "-" if value is None else str(value)


def _plain(value: Any) -> Any:
    """A value as JSON and CSV know it; NaN and infinity are unknown."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
