"""Tables on disk: CSV as people and their spreadsheets write it.

Columns are separated by commas, semicolons or tabs, whichever gives the expected names.
"""

import codecs
import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jshape.errors import BadDataset, one_line, quoted
from jshape.io.files import as_error, read_bytes

FILE_LIMIT = 64 * 2**20
"""Largest table that is read, bytes."""
ROW_LIMIT = 200_000
"""Most rows that are read."""
SEPARATORS = (",", ";", "\t")


@dataclass(frozen=True)
class Table:
    """A header, and rows of as many cells."""

    header: list[str]
    rows: list[dict[str, str]]
    """Cells by column, as they stand in the file."""
    lines: list[int]
    """Where each row ends in the file, from 1."""
    separator: str = ","

    def text(self) -> str:
        """The table as a file holds it."""
        stream = io.StringIO()
        writer = csv.DictWriter(
            stream, self.header, restval="", delimiter=self.separator, lineterminator="\n"
        )
        writer.writeheader()
        writer.writerows(self.rows)
        return stream.getvalue()


def read_table(path: str | os.PathLike, needed: Sequence[str]) -> Table:
    """The table of a CSV file (UTF-8, or UTF-16 with a byte order mark); empty lines are left out.

    Raises BadDataset: it cannot be read, one of the names that are `needed` is missing, a name is
    there twice, a row has more or fewer cells.
    """
    with as_error(BadDataset):
        data = read_bytes(path, limit=FILE_LIMIT)
    try:
        utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # "Unicode text"
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
        separator = _separator(text, needed)
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
        header = [name.strip() for name in next(lines, [])]
        while header and not header[-1]:  # spreadsheets end lines with separators
            header.pop()
        missing = [name for name in needed if name not in header]
        if missing:
            raise BadDataset(
                f"{path}: the header lacks {', '.join(missing)}; the header is "
                f"{quoted(','.join(header))}; expected {','.join(needed)}"
            )
        twice = sorted({name for name in header if header.count(name) > 1})
        if twice:
            raise BadDataset(f"{path}: the header names {one_line(', '.join(twice), 80)} twice")
        table, empty = Table(header, [], [], separator), 0
        for cells in lines:
            if not any(cell.strip() for cell in cells):
                empty = empty or lines.line_num
                continue
            where = f"{path}: line {lines.line_num}"
            if empty and len(header) == 1:
                raise BadDataset(f"{path}: line {empty} is empty, but rows follow it")
            if len(table.rows) == ROW_LIMIT:
                raise BadDataset(f"{where}: at most {ROW_LIMIT:,} rows are read")
            if len(cells) < len(header) or any(cell.strip() for cell in cells[len(header) :]):
                raise BadDataset(
                    f"{where}: has {len(cells)} columns; the header has {len(header)}, separated "
                    f"by {separator!r} (a decimal comma takes ';' or tabs)"
                )
            table.rows.append(dict(zip(header, cells, strict=False)))
            table.lines.append(lines.line_num)
        return table
    except UnicodeDecodeError:
        raise BadDataset(f"{path}: is not UTF-8 text; save it as CSV UTF-8") from None
    except csv.Error as problem:
        raise BadDataset(f"{path}: not CSV that can be read: {one_line(problem)}") from None


def check_action(name: str, where: str) -> str:
    """The name, if it can be an action's: a dash is what people write where nothing was done.

    Raises BadDataset: it has no letter and no digit.
    """
    if not any(c.isalnum() for c in name):
        raise BadDataset(f"{where}: action is {quoted(name)}; a name has a letter or a digit")
    return name


def _separator(text: str, needed: Iterable[str]) -> str:
    """What separates the names of a header: of which the most are found so."""
    head = text[: text.find("\n") if "\n" in text else len(text)]

    def found(separator: str) -> int:
        names = {name.strip().strip('"') for name in head.split(separator)}
        return len(names & set(needed))

    return max(SEPARATORS, key=found)
