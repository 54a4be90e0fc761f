"""Print tables: by rich where standard output is a terminal and rich is installed, in plain columns elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from auv_mcm.clean_text import clean

Row = Sequence[str]


def show_table(title: str, header: Row, rows: Sequence[Row], colours: Mapping[str, str] | None = None) -> None:
    """Print a table; rich fits it to the terminal, and leaves colours out where NO_COLOR is set.

    Parameters
    ----------
    title
        Above the table; "" for none.
    header
        Names of the columns; empty for a list of names and what they are.
    rows
        Cells of text, the same number in each.
    colours
        Colour of a row, by its first cell.
    """
    shown = [[clean(cell) for cell in row] for row in rows]
    if sys.stdout.isatty() and _by_rich(clean(title), header, shown, colours or {}):
        return
    lines = [list(header), *shown] if header else shown
    widths = [max((len(line[column]) for line in lines), default=0) for column in range(len(lines[0]) if lines else 0)]
    indent = "  " if title else ""
    if title:
        print(clean(title))
    for line in lines:
        print((indent + "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))).rstrip())


def _by_rich(title: str, header: Row, rows: Sequence[Row], colours: Mapping[str, str]) -> bool:
    """Print by rich; return False where it is not installed."""
    try:
        from rich.box import SIMPLE_HEAD
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text
    except ImportError:  # on a vehicle
        return False
    table = Table(title=Text(title) if title else None, title_justify="left", show_header=bool(header), box=SIMPLE_HEAD)
    for number in range(max([len(header), *map(len, rows)])):
        name = Text(header[number]) if header else ""
        table.add_column(name, style="bold" if number == 0 else "", no_wrap=number == 0, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row), style=colours.get(row[0], ""))
    Console().print(table)
    return True
