"""Parse a bench's command line; reject numbers with which nothing can be measured, and files that cannot be made."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

_MOST: Final = 1_000_000  # beyond it a number is a slip, not a wish: it would run for years


def count(text: str) -> int:
    """Parse a whole number from 1 to a million. Raises ArgumentTypeError."""
    if not text.isdecimal() or len(text) > 9 or not 1 <= int(text) <= _MOST:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1 to {_MOST}")
    return int(text)


def new_file(text: str) -> Path:
    """Parse the name of a file to write; its folder has to be there before anything is measured.

    Raises ArgumentTypeError.
    """
    path = Path(text)
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: there is no folder {path.parent}. Make it first")
    return path
