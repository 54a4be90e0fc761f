"""Make text from devices, logs and file names safe to show.

What could move a cursor, forge a line or reorder text is written out.

Such a character becomes its escape, for example `\\x1b`, so that a person sees that it was there.
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import types
from typing import Final, TypeAlias

# C0, DEL and C1 controls; marks and overrides that reorder text (Unicode Standard Annex 9, "Trojan Source"
# CVE-2021-42574); line and paragraph separators; invisible operators, the byte order mark and tags; halves of surrogate
# pairs, which file names that are no UTF-8 have in Python and which no encoding takes; and the noncharacters that XML
# 1.0 forbids.
_UNSAFE: Final = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff\ufffe\uffff\U000e0000-\U000e007f]"
)
_COLOURS: Final = {"bold": 1, "green": 32, "yellow": 33, "red": 31}  # of ANSI terminals (ECMA-48)
_Exception: TypeAlias = (
    "tuple[type[BaseException], BaseException, types.TracebackType | None] | tuple[None, None, None]"
)


def is_clean(text: str) -> bool:
    """Check that a text holds no character that `clean` writes out."""
    return _UNSAFE.search(text) is None


def clean(text: str) -> str:
    """Write out control characters, line ends among them; a clean text stays as it is."""
    return _UNSAFE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def clean_lines(text: str) -> str:
    """Write out control characters but keep the lines.

    Lines after the first are indented, so that none passes for a line of its own.
    """
    first, *others = text.split("\n")
    return "\n".join([clean(first), *(line if line.startswith("  ") else f"  {line}" for line in map(clean, others))])


def clean_json(text: str) -> str:
    """Escape, in JSON text, what `clean` writes out; its values stay the same."""
    return _UNSAFE.sub(lambda found: found[0] if found[0] == "\n" else json.dumps(found[0])[1:-1], text)


def tinted(text: str, colour: str) -> str:
    """Colour text for a terminal, and nowhere else; NO_COLOR switches it off (https://no-color.org).

    Parameters
    ----------
    text
        What is printed to standard output.
    colour
        "green", "yellow", "red" or "bold".
    """
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    return f"\x1b[{_COLOURS[colour]}m{text}\x1b[0m"


class CleanFormatter(logging.Formatter):
    """Format log records on one clean line each, with the lines of a traceback indented below it."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 (the standard library's name)
        """Format a record's message, on one line of printable characters."""
        return clean(super().formatMessage(record))

    def formatException(self, ei: _Exception) -> str:  # noqa: N802 (the standard library's name)
        """Format an exception, indented, without control characters."""
        return "  " + clean_lines(super().formatException(ei))
