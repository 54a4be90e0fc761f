"""Numbers on a bench's command line, refused there if nothing can be measured with them."""

from __future__ import annotations

import argparse
import math
from typing import Final

_MOST: Final = 1_000_000  # beyond it a number is a slip, not a wish: it would run for years


def count(text: str) -> int:
    """A whole number of 1 or more, a million at most. Raises ArgumentTypeError."""
    if not text.isdecimal() or len(text) > 9 or not 1 <= int(text) <= _MOST:
        raise argparse.ArgumentTypeError(f"'{text}' is no whole number of 1 or more, {_MOST} at most")
    return int(text)


def duration_min(text: str) -> float:
    """Minutes above 0, a day at most. Raises ArgumentTypeError."""
    try:
        minutes = float(text)
    except ValueError:
        minutes = math.nan
    if not 0.0 < minutes <= 1440.0:
        raise argparse.ArgumentTypeError(f"'{text}' is no number of minutes above 0, 1440 at most")
    return minutes
